"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

The scorecard is computed from the rollouts in a fixed order. It holds nothing that depends on the
machine, the time or the number of workers: the same seeds give the same bytes.
"""

import platform
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from crowdbench.errors import SettingError
from crowdbench.evaluation.judge import judge
from crowdbench.evaluation.parallel import checked_workers
from crowdbench.evaluation.references import reference_of
from crowdbench.evaluation.rollout_jobs import (
    Job,
    Pair,
    Progress,
    alone_in,
    parts_of,
    plan,
    roll_out,
)
from crowdbench.files import unwritable, write_json
from crowdbench.leftovers import swept
from crowdbench.metrics import METRICS
from crowdbench.registry import COMPARED, add_metric, has_recording
from crowdbench.report.html import write_report
from crowdbench.report.plots import FIGURES, PlotData, draw_figures
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import (
    Protocol,
    Scorecard,
    read_anchors,
)
from crowdbench.trajectories.blocks import FOLDS, PARTS
from crowdbench.trajectories.storage import read_own

DEFAULT_POLICY = ("straight", "social-force")
SHOWN = 6
"""Rollouts of each pair that figures and the report show."""


def evaluate(
    scene: str | Path | Scene,
    *,
    spawn: str | Sequence[str] = COMPARED,
    policy: str | Sequence[str] = DEFAULT_POLICY,
    metric: str | Sequence[str] = (),
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

    `metric` names metrics of your own beside ours, as `pkg.module:Class`; those that are registered
    need no naming. They are computed where the recording is imported, and not scored.

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
    for name in _listed(metric):
        if name not in {known.name for known in METRICS}:  # those are computed anyway
            add_metric(name)
    reference = reference_of(place)
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
    draw_figures(PlotData.of(place, reference, crowds, protocol), out)
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
