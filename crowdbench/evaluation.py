"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

The scorecard is computed from the rollouts in a fixed order. It contains nothing that depends on
the machine, the time or the number of workers: the same seeds give the same bytes.
"""

import platform
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from crowdbench.data.blocks import FOLDS, HELD_OUT, SPLITS
from crowdbench.data.storage import read_own
from crowdbench.errors import SettingError, checked
from crowdbench.files import unwritable, write_json
from crowdbench.metrics import METRICS
from crowdbench.plugins import add_metric
from crowdbench.policies import GuidedWalker
from crowdbench.progress import ROLLOUTS
from crowdbench.registry import (
    has_recording,
    list_policies,
    list_spawn_models,
    recording_of,
)
from crowdbench.run.executor import checked_workers
from crowdbench.run.jobs import Job, Pair, plan, splits_of
from crowdbench.run.judge import judge
from crowdbench.run.processes import alone_in
from crowdbench.run.references import reference_of
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.ranking import RECORDED_POLICIES
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import Protocol, Scorecard, read_anchors

SHOWN = 6
"""Number of rollouts per pair of spawn model and policy that a report is given."""
RESULTS = ("scorecard.json", "run.json", "report.html")
"""Files that are removed before the first rollout, because they would not fit it."""
SPAWN = ("poisson-gmm", "ntpp-gmm", "cox-plans")
POLICY = ("straight", "social-force", "anticipate")
"""The spawn models and policies that are evaluated by default: simple ones, and the best that ship.
Where `anticipate` was not trained, `guided-walker` walks."""


@checked()
def evaluate(
    scene: str | Path | Scene,
    *,
    spawn: str | Sequence[str] | None = None,
    policy: str | Sequence[str] | None = None,
    metric: str | Sequence[str] = (),
    protocol: Protocol = "full",
    seeds: int | None = None,
    quick: bool = False,
    workers: int | None = None,
    out: str | Path,
    report: bool = True,
    keep_rollouts: bool = False,
    progress: Callable[[int, int], None] = ROLLOUTS,
) -> Scorecard:
    """Evaluate each spawn model with each policy on a scene, all given by name.

    Without names, the spawn models are those of `SPAWN` that are fitted to the scene, and the
    policies `POLICY`.

    Worker processes read the scene's files again, so a loaded scene is used by its folder.

    The protocol `full` fits and compares on the whole recording. `heldout` fits on two thirds of
    its time blocks and scores the remaining third, three times. `seeds` is the number of rollouts
    per pair of spawn model and policy (in each fold), by default that of the scene's protocol;
    rollout k uses fit k modulo the number of fits. With fewer than two rollouts per fit there are
    distances but no scores. With `quick`, there are as few rollouts as scores need: two per fit.
    Then, if only a policy is named, people enter as recorded in two rollouts, and only walking is
    scored. If only a spawn model is named, people walk straight.

    The spawn model `MODEL+FILE.toml` is MODEL under the scenario in that file; it is not ranked.

    `metric` names your own metrics as `pkg.module:Class`, in addition to crowdbench's; registered
    metrics are included without being named. They are computed if the recording is imported, and
    never scored.

    If the recording is imported, policies are also scored under the recorded arrivals. A
    deterministic policy needs only one rollout there. The policies `replay` and
    `recorded-paths` work only with the spawn model `replay`; other pairs with them are skipped.

    Writes `scorecard.json`, `run.json` and, with `report`, `report.html` into `out`, and the
    trajectories of the first rollouts into `rollouts/*.parquet`: of those in the report, of one for
    each pair without it, or of all with `keep_rollouts`. What scores need of a rollout is kept in
    the store (`crowdbench.run.store`) and is not made again if nothing that it depends on has
    changed.
    `progress(done, total)` is called before the first and after each batch of rollouts; by default
    listeners of `crowdbench.progress` are told.
    `workers` is the number of processes, by default one per core.

    Returns the scorecard.

    Raises:
        SceneError, WeightsError, RecordingError, SettingError: an argument names something that
            does not exist or does not fit; checked before the first rollout.
        OutputError: `out` cannot be written.
    """
    began = time.time()
    place, out = load_scene(scene), Path(out)
    for name in _listed(metric):
        if name not in {known.name for known in METRICS}:  # these are always computed
            add_metric(name)
    reference = reference_of(place)
    if protocol not in ("full", "heldout"):
        raise SettingError("protocol", got=repr(protocol), expected="full or heldout")
    scale = read_anchors(place).protocols[protocol]
    only_policy = quick and policy is not None and spawn is None
    if spawn is None:
        spawn = "replay" if only_policy else default_spawn_models(place)
        policy = default_policies(place) if policy is None else policy
    elif policy is None:
        policy = POLICY[:1] if quick else default_policies(place)
    pairs = _pairs(place, _listed(spawn), _listed(policy))
    if seeds is None:
        per_fit = 2 if quick else place.protocol.rollouts_per_fit
        seeds = 2 if only_policy else place.protocol.fits * per_fit
    workers = checked_workers(workers)
    if protocol == "heldout" and len(reference.blocks) < FOLDS:
        raise SettingError(
            "protocol heldout",
            got=f"{len(reference.blocks)} time blocks",
            expected=f"at least {FOLDS}, one per fold",
        )
    jobs = [
        replace(job, shown=keep_rollouts or _is_first(job, protocol, SHOWN if report else 1))
        for job in plan(place.asked, place, pairs, protocol, seeds, out / "rollouts")
    ]
    with alone_in(out):
        try:
            (out / "rollouts").mkdir(parents=True, exist_ok=True)
            for name in RESULTS:
                (out / name).unlink(missing_ok=True)
        except OSError as error:
            raise unwritable(out, error) from error
        rolled = roll_out(jobs, reference, workers, progress)
        card = judge(place, reference, rolled, protocol, seeds, scale)
        write_json(out / "scorecard.json", card)
        if report:
            publish(card, place, reference, jobs, out)
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


def default_spawn_models(scene: Scene) -> list[str]:
    """The spawn models of `SPAWN` that a scene has; all of them if it has none."""
    return [name for name in SPAWN if name in list_spawn_models(scene)] or [*SPAWN]


def default_policies(scene: Scene) -> list[str]:
    """The policies of `POLICY`, with one for any place instead of those that a scene lacks."""
    known = list_policies(scene)
    return [name if name in known else GuidedWalker.name for name in POLICY]


def publish(
    card: Scorecard, scene: Scene, reference: Reference, jobs: Sequence[Job], out: Path
) -> None:
    """Write the report, which shows the first rollouts of each pair in the first split."""
    from crowdbench.report.html import write_report

    shown = [job for job in jobs if _is_first(job, card.protocol, SHOWN)]
    crowds = {(job.spawn, job.policy, job.seed): read_own(job.path) for job in shown}
    recording = recording_of(scene) if has_recording(scene) else None
    write_report(card, scene, reference, crowds, out, recording=recording)


def _is_first(job: Job, protocol: Protocol, number: int) -> bool:
    """Whether a rollout is one of the first of its pair, in the first split."""
    # Rollouts under the recorded arrivals may serve all folds.
    return job.seed < number and job.split in (splits_of(protocol)[0], SPLITS[0], HELD_OUT)


def _listed(names: str | Sequence[str]) -> Sequence[str]:
    return [names] if isinstance(names, str) else names


def _pairs(place: Scene, spawn: Sequence[str], policy: Sequence[str]) -> list[Pair]:
    """The requested pairs, then each policy under the recorded arrivals if they are imported."""
    walkable = [
        (s, p)
        for s in dict.fromkeys(spawn)
        for p in dict.fromkeys(policy)
        if p not in RECORDED_POLICIES or s == "replay"
    ]
    if not walkable:
        raise SettingError(
            f"evaluation of {place.id}",
            got=f"spawn {', '.join(spawn)} with policy {', '.join(policy)}",
            expected=f"a valid pair: {' and '.join(RECORDED_POLICIES)} need the spawn model replay",
        )
    if has_recording(place):
        walkable += [("replay", p) for p in policy if p != "replay"]
    return list(dict.fromkeys(walkable))
