"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

Every rollout is a job of its own, written as Parquet: an evaluation that was killed goes on where
it stopped. The scorecard is computed from the rollouts in a fixed order. It holds nothing that
depends on the machine, the time or the number of workers: the same seeds give the same bytes.
"""

import functools
import importlib.util
import os
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from crowdbench import __version__
from crowdbench.blocks import FOLDS, PARTS
from crowdbench.cards import (
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
from crowdbench.errors import OutputError, RecordingError, SettingError
from crowdbench.figures import FIGURES, Sight, draw_figures
from crowdbench.files import sha256, unwritable, write_json
from crowdbench.metrics import WALK, Metric, Statistics, metrics_for
from crowdbench.power import Power, power
from crowdbench.recordings.catalogue import cached
from crowdbench.reference import Reference, read_reference, summarise
from crowdbench.registry import RECORDINGS, spawn_model
from crowdbench.registry import policy as find_policy
from crowdbench.report import write_report
from crowdbench.rollouts import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring import RESAMPLES, Draws, FloorDraws, energy, floor, mean_of
from crowdbench.tables import read_own, write_parquet
from crowdbench.trajectories import OUTCOMES

DEFAULT_SPAWN = ("poisson-gmm", "renewal-gmm", "ntpp-gmm")
DEFAULT_POLICY = ("straight", "social-force")
SHOWN = 6
"""Rollouts of each pair that figures and the report show."""

_LARGE = 2**26  # bytes of a file beyond which its age is looked at, not what is in it

Pair = tuple[str, str]
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Job:
    """One rollout to make."""

    scene: str
    spawn: str
    policy: str
    part: str
    fit: int
    seed: int
    path: Path
    fingerprint: str
    """Hash of all that the rollout depends on."""


@dataclass(frozen=True, eq=False)
class Rolled:
    """What is kept of a rollout."""

    statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]]
    """By metric and name: the columns that are not zero, their values, and how many there are."""
    outcomes: np.ndarray

    def of(self, metric: Metric) -> Statistics:
        """The statistics of a metric."""
        dense = {}
        for name, (columns, values, size) in self.statistics[metric.name].items():
            dense[name] = np.zeros((len(values), size), dtype=np.int64)
            dense[name][:, columns] = values
        return dense


def evaluate(
    scene: str | Path,
    *,
    spawn: Sequence[str] = DEFAULT_SPAWN,
    policy: Sequence[str] = DEFAULT_POLICY,
    protocol: Protocol = "full",
    seeds: int | None = None,
    workers: int | None = None,
    out: Path,
    progress: Progress = lambda done, total: None,
) -> Scorecard:
    """Evaluate each spawn model with each policy on a scene.

    `full` fits and compares on the whole recording, `heldout` fits on two thirds of its time
    blocks and scores the third, three times. `seeds` rollouts are made of each pair (in each
    fold), by default as many as the scene's protocol says; rollout k is of fit k modulo the
    number of fits. With fewer than two rollouts per fit there are distances but no scores.

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
    place = load_scene(scene)
    reference = read_reference(place)
    scale = read_anchors(place).protocols[_known_protocol(protocol)]
    pairs = _pairs(place, spawn, policy)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit if seeds is None else seeds
    workers = _checked_workers(workers)
    if protocol == "heldout" and len(reference.blocks) < FOLDS:
        raise SettingError(
            "protocol", got=f"{len(reference.blocks)} time blocks", expected=f"{FOLDS} at least"
        )
    jobs = plan(str(scene), place, pairs, protocol, seeds, out / "rollouts")
    with _alone_in(out):
        _prepare(out)
        entries = roll_out(place, reference, jobs, protocol, seeds, workers, progress)
        return _finish(place, reference, jobs, entries, protocol, seeds, workers, scale, out, began)


def _finish(
    place: Scene,
    reference: Reference,
    jobs: list[Job],
    entries: list[Entry],
    protocol: Protocol,
    seeds: int,
    workers: int,
    scale: Scale,
    out: Path,
    began: float,
) -> Scorecard:
    """Write scorecard, pictures and report."""
    card = Scorecard(
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
        entries=entries,
    )
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
        entries = roll_out(
            place,
            reference,
            jobs,
            protocol,
            seeds,
            _checked_workers(workers),
            lambda done, _, before=before: progress(before + done, total),  # type: ignore[misc]
        )
        before += len(jobs)
        protocols[protocol] = Scale(floor=floors(place, reference, protocol), anchors=entries)
    return Anchors(schema=SCHEMA, scene=place.id, made_from=files_of(place), protocols=protocols)


def power_study(
    scene: str | Path, folder: Path, *, workers: int | None = None, progress: Progress
) -> list[Power]:
    """How well each metric tells the anchors from the recording; see `crowdbench.power`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    reference = read_reference(place)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit
    jobs = plan(str(scene), place, [ANCHOR, WALK_ANCHOR], "full", seeds, folder)
    rolled: list[tuple[Job, Rolled]] = []
    progress(0, len(jobs))
    for done in _run(jobs, reference, min(_checked_workers(workers), len(jobs))):
        rolled.append(done)
        progress(len(rolled), len(jobs))
    rolled.sort(key=lambda done: done[0].seed)
    draws = draws_of(place, reference, "full")
    found = []
    for metric in metrics_for(reference.blocks):
        pair = WALK_ANCHOR if metric.family in WALK else ANCHOR
        crowds = [what.of(metric) for job, what in rolled if (job.spawn, job.policy) == pair]
        recorded = reference.statistics[metric.name]
        study = power(metric, recorded, crowds, reference.blocks, draws)
        if study is not None:
            found.append(study)
    return found


def parts_of(protocol: str) -> tuple[str, ...]:
    """The parts that a protocol averages over."""
    return PARTS[:1] if protocol == "full" else PARTS[1:]


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


def has_recording(scene: Scene) -> bool:
    """Whether the scene's recording is imported, or is one that is generated."""
    name = scene.recording.name
    return name in RECORDINGS and (name == "plaza" or cached(name).exists())


def plan(
    scene: str,
    place: Scene,
    pairs: Sequence[Pair],
    protocol: str,
    seeds: int,
    folder: Path,
) -> list[Job]:
    """All rollouts to make.

    Raises:
        SettingError: a name stands for nothing, or `seeds` is no number of rollouts.
    """
    fits = place.protocol.fits
    if seeds < 1 or (seeds >= 2 * fits and seeds % fits):
        raise SettingError(
            "seeds",
            got=str(seeds),
            expected=f"a multiple of {fits}, so that each fit has as many rollouts, or 1 to "
            f"{2 * fits - 1} for plain distances only",
        )
    jobs = []
    for s, p in pairs:
        walker = find_policy(p, place)
        recorded = s == "replay"
        certain = recorded and getattr(walker, "deterministic", False)
        for part in ("full",) if recorded else parts_of(protocol):
            spawn_model(s, place, part=part)
            fingerprint = _fingerprint(place, s, p)
            for seed in range(1 if certain else seeds):
                name = f"{_plain(s)}_{_plain(p)}_{part}_{seed}.parquet"
                jobs.append(Job(scene, s, p, part, seed % fits, seed, folder / name, fingerprint))
    return jobs


def _fingerprint(scene: Scene, spawn: str, policy: str) -> str:
    """Hash of what a rollout depends on: our code, the scene's files, the recording, own classes.

    Of an own class these are all files in the folder of its module: weights lie beside the code.
    """
    files = sorted(Path(__file__).parent.rglob("*.py"))
    files += _plain_files(scene.folder, without="anchors.json")
    if spawn in ("replay", "block-replay") and cached(scene.recording.name).exists():
        files.append(cached(scene.recording.name))
    for name in (spawn, policy):
        module, colon, _ = name.partition(":")
        found = importlib.util.find_spec(module) if colon else None
        if found is not None and found.origin is not None:
            files += _plain_files(Path(found.origin).parent)
    parts = [f"{__version__} {scene.id} {spawn} {policy}".encode()]
    return sha256(b"".join([*parts, *(_hash_of(f) for f in files)]))[:16]


def _plain_files(folder: Path, without: str = "") -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.is_file() and p.name != without)


def _hash_of(file: Path) -> bytes:
    stat = file.stat()
    if stat.st_size > _LARGE:
        return f"{file.name} {stat.st_size} {stat.st_mtime_ns}".encode()
    return sha256(file.read_bytes()).encode()


@contextmanager
def _alone_in(out: Path) -> Iterator[None]:
    """Refuse to work in a folder in which another evaluation is at work."""
    lock = out / ".lock"
    try:
        out.mkdir(parents=True, exist_ok=True)
        holder = int(lock.read_text() or 0) if lock.exists() else 0
    except OSError as error:
        raise unwritable(out, error) from error
    except ValueError:
        holder = 0
    if holder not in (0, os.getpid()) and _lives(holder):
        raise OutputError(
            out,
            got=f"a folder in which process {holder} evaluates",
            expected="a folder of one's own",
            mend=f"Wait for it, or name another folder; if there is none, remove {lock}.",
        )
    try:
        lock.write_text(str(os.getpid()))
        yield
    except PermissionError as error:
        raise unwritable(out, error) from error
    finally:
        with suppress(OSError):
            lock.unlink()


def _lives(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


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
        for half in (out / "rollouts").glob(".*-*.parquet"):
            half.unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


def _plain(name: str) -> str:
    plain = "".join(c if c.isalnum() or c in "-." else "-" for c in name)
    return plain if plain == name else f"{plain}-{sha256(name.encode())[:6]}"


def _known_protocol(protocol: str) -> str:
    if protocol not in ("full", "heldout"):
        raise SettingError("protocol", got=repr(protocol), expected="full or heldout")
    return protocol


def _checked_workers(asked: int | None) -> int:
    if asked is not None and asked < 1:
        raise SettingError("workers", got=str(asked), expected="1 or more")
    return asked or os.cpu_count() or 1


def roll_out(
    scene: Scene,
    reference: Reference,
    jobs: list[Job],
    protocol: str,
    seeds: int,
    workers: int,
    progress: Progress,
) -> list[Entry]:
    """Make all rollouts that are missing, and an entry of each pair."""
    rolled: dict[Job, Rolled] = {}
    progress(0, len(jobs))
    for job, what in _run(jobs, reference, min(workers, len(jobs))):
        rolled[job] = what
        progress(len(rolled), len(jobs))
    pairs = list(dict.fromkeys((job.spawn, job.policy) for job in jobs))
    return [
        _entry(scene, reference, {j: rolled[j] for j in jobs if (j.spawn, j.policy) == pair},
               protocol, seeds)
        for pair in pairs
    ]  # fmt: skip


def _run(jobs: list[Job], reference: Reference, workers: int) -> Iterator[tuple[Job, Rolled]]:
    if workers == 1:
        for job in jobs:
            yield job, _roll_out(job, reference)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    # joblib's own processes are started afresh, not forked: forking after OpenMP has run hangs.
    parallel = Parallel(n_jobs=workers, return_as="generator_unordered", pre_dispatch=workers)
    try:
        yield from parallel(delayed(_alone)(job, reference) for job in jobs)
    finally:
        # Left alone, the processes would serve the next call too, in this one's surroundings.
        get_reusable_executor().shutdown(kill_workers=True)


def _alone(job: Job, reference: Reference) -> tuple[Job, Rolled]:
    """Roll out on one thread: the processes already fill the machine."""
    import numba

    numba.set_num_threads(1)
    return job, _roll_out(job, reference)


def _roll_out(job: Job, reference: Reference) -> Rolled:
    provenance = {
        "spawn": job.spawn,
        "policy": job.policy,
        "part": job.part,
        "fit": job.fit,
        "seed": job.seed,
        "made_from": job.fingerprint,
    }
    crowd = None
    if job.path.exists():
        try:
            crowd = read_own(job.path)
        except RecordingError:  # another program's file: it is written anew
            crowd = None
    if crowd is None or dict(crowd.provenance) != provenance:
        scene, spawn, policy = _models(job)
        # Rollouts of different parts must not share their random numbers.
        seed = job.seed * len(PARTS) + PARTS.index(job.part)
        crowd = replace(rollout(scene, spawn, policy, seed=seed), provenance=provenance)
        write_parquet(crowd, job.path)
    statistics: dict[str, dict[str, tuple[np.ndarray, np.ndarray, int]]] = {}
    for metric, of_metric in summarise(crowd, reference.blocks, reference.place).items():
        statistics[metric] = {}
        for name, values in of_metric.items():
            columns = np.flatnonzero(values.any(axis=0))
            statistics[metric][name] = (columns, values[:, columns], values.shape[1])
    return Rolled(statistics, np.bincount(crowd.outcome, minlength=len(OUTCOMES)))


def _models(job: Job):  # type: ignore[no-untyped-def]  # what _cached_models returns
    return _cached_models(job.scene, job.spawn, job.policy, job.part, job.fit, job.fingerprint)


@functools.lru_cache(maxsize=8)  # jobs of one pair follow each other; a recording is read once
def _cached_models(  # type: ignore[no-untyped-def]
    scene: str, spawn: str, policy: str, part: str, fit: int, fingerprint: str
):
    place = load_scene(scene)
    return place, spawn_model(spawn, place, part=part, fit=fit), find_policy(policy, place)


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
    for part in parts_of(protocol):
        inside = reference.blocks.in_part(part)
        blocks = reference.blocks.scored(part)
        if not metric.applies(blocks):
            continue
        recorded = _rows(reference.statistics[metric.name], inside)
        crowds = {
            job: _rows(what.of(metric), inside)
            for job, what in rolled.items()
            if recorded_arrivals or job.part == part
        }
        results += [metric.compare(recorded, crowd, blocks) for crowd in crowds.values()]
        fits = sorted({job.fit for job in crowds})
        groups = [[c for job, c in crowds.items() if job.fit == fit] for fit in fits]
        if (metric.family not in WALK or recorded_arrivals) and (
            len(crowds) == 1 < seeds or seeds >= 2 * scene.protocol.fits
        ):
            draws = draws_of(scene, reference, part)
            energies.append(energy(metric, recorded, groups, blocks, draws))
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
