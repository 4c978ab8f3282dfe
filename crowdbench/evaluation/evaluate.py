"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

The scorecard is computed from the rollouts in a fixed order. It holds nothing that depends on the
machine, the time or the number of workers: the same seeds give the same bytes.
"""

import platform
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from crowdbench import __version__
from crowdbench.errors import SettingError
from crowdbench.evaluation.parallel import checked_workers
from crowdbench.evaluation.rollout_jobs import (
    Job,
    Pair,
    Progress,
    Rolled,
    alone_in,
    parts_of,
    plan,
    roll_out,
)
from crowdbench.files import unwritable, write_json
from crowdbench.leftovers import swept
from crowdbench.metrics import WALK, Metric, Statistics, metrics_for
from crowdbench.registry import COMPARED, has_recording
from crowdbench.report.html import write_report
from crowdbench.report.plots import FIGURES, Sight, draw_figures
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.energy import RESAMPLES, Draws, FloorDraws, energy, floor, mean_of
from crowdbench.scoring.power import Power, power
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.scoring.scorecard import (
    ANCHOR,
    ANCHORS,
    SCHEMA,
    WALK_ANCHOR,
    Anchors,
    EnergyCard,
    Entry,
    MetricCard,
    Protocol,
    Scale,
    Scorecard,
    files_of,
    read_anchors,
)
from crowdbench.trajectories.blocks import FOLDS, PARTS, TimeBlocks
from crowdbench.trajectories.storage import read_own
from crowdbench.trajectories.table import OUTCOMES

DEFAULT_POLICY = ("straight", "social-force")
SHOWN = 6
"""Rollouts of each pair that figures and the report show."""


def evaluate(
    scene: str | Path | Scene,
    *,
    spawn: str | Sequence[str] = COMPARED,
    policy: str | Sequence[str] = DEFAULT_POLICY,
    protocol: Protocol = "full",
    seeds: int | None = None,
    workers: int | None = None,
    out: str | Path,
    progress: Progress = lambda done, total: None,
) -> Scorecard:
    """Evaluate each spawn model with each policy on a scene, all given by name.

    Workers read the scene anew: a scene that was loaded stands for the folder it came from.

    `full` fits and compares on the whole recording, `heldout` fits on two thirds of its time
    blocks and scores the third, three times. `seeds` rollouts are made of each pair (in each
    fold), by default as many as the scene's protocol says; rollout k is of fit k modulo the
    number of fits. With fewer than two rollouts per fit there are distances but no scores. The
    spawn model `MODEL+FILE.toml` is MODEL under the scenario of that file; it is not ranked.

    Policies are scored under the recorded arrivals too, where the recording is imported. Where
    they leave nothing to chance, one rollout does. The policy `replay` walks recorded arrivals
    only and is left out elsewhere.

    Writes `scorecard.json`, `run.json`, `report.html`, `rollouts/*.parquet` and the figures into
    `out`. Rollouts that lie there already are kept if all they depend on is as it was.
    `progress(done, total)` is called before the first and after each rollout. `workers`
    processes (by default one per core) share the work.

    Raises:
        SceneError, WeightsError, RecordingError, SettingError: what was asked for does not
            exist or does not fit; checked before the first rollout.
        OutputError: `out` cannot be written.
    """
    began = time.time()
    place, out = load_scene(scene), Path(out)
    reference = read_reference(place)
    scale = read_anchors(place).protocols[_known_protocol(protocol)]
    pairs = _pairs(place, _listed(spawn), _listed(policy))
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit if seeds is None else seeds
    workers = checked_workers(workers)
    if protocol == "heldout" and len(reference.blocks) < FOLDS:
        raise SettingError(
            "protocol", got=f"{len(reference.blocks)} time blocks", expected=f"{FOLDS} at least"
        )
    jobs = plan(place.asked, place, pairs, protocol, seeds, out / "rollouts")
    with swept(), alone_in(out):
        _prepare(out)
        rolled = roll_out(jobs, reference, workers, progress)
        card = judge(place, reference, rolled, protocol, seeds, scale)
        return _finish(place, reference, jobs, card, workers, out, began)


def judge(
    place: Scene,
    reference: Reference,
    rolled: dict[Job, Rolled],
    protocol: Protocol,
    seeds: int,
    scale: Scale,
) -> Scorecard:
    """The scorecard of rollouts, `seeds` of each pair (in each fold)."""
    return Scorecard(
        schema=SCHEMA,
        crowdbench=__version__,
        scene=place.id,
        made_from=files_of(place),
        protocol=protocol,
        horizon_s=place.horizon_s,
        blocks=len(reference.blocks),
        fits=place.protocol.fits,
        rollouts=seeds,
        resamples=RESAMPLES,
        scored=list(place.protocol.scored),
        scale=scale,
        entries=_entries(place, reference, rolled, protocol, seeds),
    )


def _finish(
    place: Scene,
    reference: Reference,
    jobs: list[Job],
    card: Scorecard,
    workers: int,
    out: Path,
    began: float,
) -> Scorecard:
    """Write scorecard, pictures and report."""
    protocol = card.protocol
    write_json(out / "scorecard.json", card)
    crowds = {
        (job.spawn, job.policy, job.seed): read_own(job.path)
        for job in jobs
        # What is walked under the recorded arrivals is the same in every part.
        if job.part in (parts_of(protocol)[0], PARTS[0]) and job.seed < SHOWN
    }
    draw_figures(Sight.of(place, reference, crowds, protocol), out)
    write_report(card, place, reference, crowds, out)
    write_json(
        out / "run.json",
        {
            "began": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(began)),
            "took_s": round(time.time() - began, 1),
            "workers": workers,
            "python": platform.python_version(),
            "numpy": np.__version__,
            "machine": platform.platform(),
        },
    )
    return card


def make_anchors(
    scene: str | Path, folder: Path, *, workers: int | None = None, progress: Progress
) -> Anchors:
    """Roll out the anchors of a scene in both protocols; rollouts are left in `folder`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    reference = read_reference(place)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit
    todo = {
        protocol: plan(str(scene), place, ANCHORS, protocol, seeds, folder)
        for protocol in ("full", "heldout")
    }
    total, before = sum(map(len, todo.values())), 0
    protocols = {}
    for protocol, jobs in todo.items():
        rolled = roll_out(
            jobs,
            reference,
            workers,
            lambda done, _, before=before: progress(before + done, total),  # type: ignore[misc]
        )
        before += len(jobs)
        entries = _entries(place, reference, rolled, protocol, seeds)
        protocols[protocol] = Scale(floor=floors(place, reference, protocol), anchors=entries)
    return Anchors(schema=SCHEMA, scene=place.id, made_from=files_of(place), protocols=protocols)


def power_study(
    scene: str | Path, folder: Path, *, workers: int | None = None, progress: Progress
) -> list[Power]:
    """How well each metric tells the anchors from the recording; see `crowdbench.scoring.power`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    reference = read_reference(place)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit
    jobs = plan(str(scene), place, [ANCHOR, WALK_ANCHOR], "full", seeds, folder)
    rolled = roll_out(jobs, reference, workers, progress)
    draws = draws_of(place, reference, "full")
    found = []
    for metric in metrics_for(reference.blocks):
        pair = WALK_ANCHOR if metric.family in WALK else ANCHOR
        crowds = [
            what.of(metric) for job, what in rolled.items() if (job.spawn, job.policy) == pair
        ]
        recorded = reference.statistics[metric.name]
        study = power(metric, recorded, crowds, reference.blocks, draws)
        if study is not None:
            found.append(study)
    return found


def draws_of(scene: Scene, reference: Reference, part: str) -> Draws:
    """The resamples of a part: the same for everyone who is scored on it."""
    return Draws.of(
        reference.blocks.scored(part),
        resample_s=scene.protocol.resample_s,
        block_s=scene.protocol.block_s,
        seed=(PARTS.index(part),),
    )


def floors(scene: Scene, reference: Reference, protocol: str) -> dict[str, EnergyCard]:
    """F of each metric."""
    parts = parts_of(protocol)
    draws = {part: draws_of(scene, reference, part) for part in parts}
    everyone = [(np.flatnonzero(reference.blocks.in_part(p)), draws[p]) for p in parts]
    found = {}
    for metric in metrics_for(reference.blocks):
        each = []
        for part in parts:
            blocks = reference.blocks.scored(part)
            if metric.applies(blocks):
                recording = reference.statistics[metric.name]
                recorded = _rows(recording, reference.blocks.in_part(part))
                of_floor = FloorDraws.of(draws[part], everyone)
                each.append(floor(metric, recording, recorded, blocks, of_floor))
        known = [e for e in each if e is not None]
        if len(known) == len(parts):
            found[metric.name] = EnergyCard.of(mean_of(known))
    return found


def _listed(names: str | Sequence[str]) -> Sequence[str]:
    """Names, of which there may be a single one."""
    return [names] if isinstance(names, str) else names


def _pairs(place: Scene, spawn: Sequence[str], policy: Sequence[str]) -> list[Pair]:
    """The pairs asked for, then each policy under the recorded arrivals if they are at hand."""
    walkable = [
        (s, p)
        for s in dict.fromkeys(spawn)
        for p in dict.fromkeys(policy)
        if p != "replay" or s == "replay"
    ]
    if not walkable:
        raise SettingError(
            f"evaluation of {place.id}",
            got=f"spawn {', '.join(spawn)} with policy {', '.join(policy)}",
            expected="a pair that can walk: the policy replay needs the spawn model replay",
        )
    recorded = [("replay", p) for p in dict.fromkeys(policy) if p != "replay"]
    if not has_recording(place):
        recorded = []
    return list(dict.fromkeys([*walkable, *recorded]))


def _prepare(out: Path) -> None:
    """Make the folder, without an earlier run's results, which would stand beside new rollouts."""
    try:
        (out / "rollouts").mkdir(parents=True, exist_ok=True)
        for name in ("scorecard.json", "run.json", "report.html", *FIGURES):
            (out / name).unlink(missing_ok=True)
            # What a run that was killed was about to rename.
            stem, _, suffix = name.partition(".")
            for half in out.glob(f".{stem}-*.{suffix}"):
                half.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


def _known_protocol(protocol: str) -> str:
    if protocol not in ("full", "heldout"):
        raise SettingError("protocol", got=repr(protocol), expected="full or heldout")
    return protocol


def _entries(
    scene: Scene, reference: Reference, rolled: dict[Job, Rolled], protocol: str, seeds: int
) -> list[Entry]:
    """An entry of each pair."""
    pairs = list(dict.fromkeys((job.spawn, job.policy) for job in rolled))
    return [
        _entry(
            scene,
            reference,
            {job: what for job, what in rolled.items() if (job.spawn, job.policy) == pair},
            protocol,
            seeds,
        )
        for pair in pairs
    ]


def _rows(statistics: Statistics, inside: np.ndarray) -> Statistics:
    return {name: values[inside] for name, values in statistics.items()}


def _entry(
    scene: Scene,
    reference: Reference,
    rolled: dict[Job, Rolled],
    protocol: str,
    seeds: int,
) -> Entry:
    first = next(iter(rolled))
    metrics = {
        metric.name: _metric_card(scene, reference, metric, rolled, protocol, seeds)
        for metric in metrics_for(reference.blocks)
    }
    ended = np.sum([r.outcomes for r in rolled.values()], axis=0)
    return Entry(
        spawn=first.spawn,
        policy=first.policy,
        seeds=[job.seed for job in rolled],
        persons=int(ended.sum()),
        outcomes={n: int(c) for n, c in zip(OUTCOMES, ended, strict=True) if c},
        metrics=metrics,
    )


@dataclass(frozen=True, eq=False)
class Seen:
    """Rollouts and the recording as one metric sees them in the blocks that a part is scored on."""

    part: str
    blocks: TimeBlocks
    recorded: Statistics
    crowds: list[Statistics]
    """The rollouts', by seed."""
    fits: list[list[Statistics]]
    """The same, of each fit."""


def seen_in(
    reference: Reference, metric: Metric, rolled: dict[Job, Rolled], protocol: str
) -> Iterator[Seen]:
    """What a metric sees of one pair's rollouts in each part of a protocol that it applies to."""
    # Who was not trained on the recording walks all of it once, and is looked at fold by fold.
    whole_recording = all(job.part == "full" for job in rolled)
    for part in parts_of(protocol):
        inside = reference.blocks.in_part(part)
        blocks = reference.blocks.scored(part)
        if not metric.applies(blocks):
            continue
        crowds = {
            job: _rows(what.of(metric), inside)
            for job, what in rolled.items()
            if whole_recording or job.part == part
        }
        fits = sorted({job.fit for job in crowds})
        yield Seen(
            part,
            blocks,
            _rows(reference.statistics[metric.name], inside),
            list(crowds.values()),
            [[c for job, c in crowds.items() if job.fit == fit] for fit in fits],
        )


def _metric_card(
    scene: Scene,
    reference: Reference,
    metric: Metric,
    rolled: dict[Job, Rolled],
    protocol: str,
    seeds: int,
) -> MetricCard:
    results, energies = [], []
    recorded_arrivals = next(iter(rolled)).spawn == "replay"
    for seen in seen_in(reference, metric, rolled, protocol):
        results += [metric.compare(seen.recorded, crowd, seen.blocks) for crowd in seen.crowds]
        if (metric.family not in WALK or recorded_arrivals) and (
            len(seen.crowds) == 1 < seeds or min(map(len, seen.fits)) >= 2
        ):
            draws = draws_of(scene, reference, seen.part)
            energies.append(energy(metric, seen.recorded, seen.fits, seen.blocks, draws))
    known = [e for e in energies if e is not None]
    whole = bool(known) and len(known) == len(parts_of(protocol))
    return MetricCard(
        distance=_mean([r.distance for r in results]),
        distances=[_number(r.distance) for r in results],
        recorded=_mean([r.recorded for r in results]),
        simulated=_mean([r.simulated for r in results]),
        unit=metric.unit,
        n=sum(r.n for r in results),
        energy=EnergyCard.of(mean_of(known)) if whole else None,
    )


def _mean(values: list[float]) -> float | None:
    return _number(np.mean(values)) if values else None


def _number(value: float | np.floating) -> float | None:
    """JSON has neither NaN nor infinity."""
    return float(value) if np.isfinite(value) else None
