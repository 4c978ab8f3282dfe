"""`evaluate`: roll out spawn models and policies on a scene and compare with its recording.

The scorecard is computed from the rollouts in a fixed order. It contains nothing that depends on
the machine, the time or the number of workers: the same seeds give the same bytes.
"""

import platform
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from crowdbench.data.blocks import FOLDS, SPLITS
from crowdbench.data.storage import read_own
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.files import unwritable, write_json
from crowdbench.metrics import METRICS
from crowdbench.plugins import add_metric
from crowdbench.registry import has_recording
from crowdbench.run.executor import checked_workers
from crowdbench.run.judge import judge
from crowdbench.run.lock import alone_in
from crowdbench.run.references import reference_of
from crowdbench.run.rollout_jobs import (
    Job,
    Pair,
    Progress,
    plan,
    roll_out,
    splits_of,
)
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.ranking import RECORDED_POLICIES
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import (
    Protocol,
    Scorecard,
    read_anchors,
)

SHOWN = 6
"""Number of rollouts per pair of spawn model and policy that a report is given."""
Publish = Callable[
    [Scorecard, Scene, Reference, Mapping[tuple[str, str, int], Trajectories], Path], object
]


def evaluate(
    scene: str | Path | Scene,
    *,
    spawn: str | Sequence[str],
    policy: str | Sequence[str],
    metric: str | Sequence[str] = (),
    protocol: Protocol = "full",
    seeds: int | None = None,
    workers: int | None = None,
    out: str | Path,
    progress: Progress = lambda done, total: None,
    publish: Publish | None = None,
    published: Sequence[str] = (),
) -> Scorecard:
    """Evaluate pairs of spawn models and policies; see `crowdbench.evaluate` for the arguments.

    `publish(card, scene, reference, crowds, out)` writes a report while the folder is locked;
    `crowds` are the first rollouts of each pair. `published` are the names of its files, which
    are removed before the first rollout.
    """
    began = time.time()
    place, out = load_scene(scene), Path(out)
    for name in _listed(metric):
        if name not in {known.name for known in METRICS}:  # these are always computed
            add_metric(name)
    reference = reference_of(place)
    scale = read_anchors(place).protocols[_known_protocol(protocol)]
    pairs = _pairs(place, _listed(spawn), _listed(policy))
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit if seeds is None else seeds
    workers = checked_workers(workers)
    if protocol == "heldout" and len(reference.blocks) < FOLDS:
        raise SettingError(
            "protocol heldout",
            got=f"{len(reference.blocks)} time blocks",
            expected=f"at least {FOLDS}, one per fold",
        )
    jobs = plan(place.asked, place, pairs, protocol, seeds, out / "rollouts")
    with alone_in(out):
        _prepare(out, published)
        rolled = roll_out(jobs, reference, workers, progress)
        card = judge(place, reference, rolled, protocol, seeds, scale)
        write_json(out / "scorecard.json", card)
        if publish is not None:
            publish(card, place, reference, _shown(jobs, protocol), out)
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


def _shown(jobs: Sequence[Job], protocol: Protocol) -> dict[tuple[str, str, int], Trajectories]:
    """The first rollouts of each pair in the protocol's first split."""
    return {
        (job.spawn, job.policy, job.seed): read_own(job.path)
        for job in jobs
        # Rollouts under the recorded arrivals may exist for the split `full` only.
        if job.split in (splits_of(protocol)[0], SPLITS[0]) and job.seed < SHOWN
    }


def _listed(names: str | Sequence[str]) -> Sequence[str]:
    """The names as a sequence; a single string becomes a list."""
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
    recorded = [("replay", p) for p in dict.fromkeys(policy) if p != "replay"]
    if not has_recording(place):
        recorded = []
    return list(dict.fromkeys([*walkable, *recorded]))


def _prepare(out: Path, published: Sequence[str]) -> None:
    """Create the folder and remove results of an earlier run, which would not fit new rollouts."""
    try:
        (out / "rollouts").mkdir(parents=True, exist_ok=True)
        for name in ("scorecard.json", "run.json", *published):
            (out / name).unlink(missing_ok=True)
    except OSError as error:
        raise unwritable(out, error) from error


def _known_protocol(protocol: str) -> str:
    if protocol not in ("full", "heldout"):
        raise SettingError("protocol", got=repr(protocol), expected="full or heldout")
    return protocol
