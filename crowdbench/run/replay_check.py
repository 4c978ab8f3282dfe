"""Checks whether replaying a recording reproduces it, and explains deviations."""

import numpy as np

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.policies import Straight
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene
from crowdbench.spawn import Replay
from crowdbench.spawn.recorded_plans import cut_at_goals

TOLERANCE_M = 1e-3


def compare_replay(recording: Trajectories, walked: Trajectories, scene: Scene) -> dict[str, str]:
    """Count the replayed paths that equal the recorded ones to 1 mm, and why others differ.

    Returns the results as text for a table, by name.
    """
    reasons: dict[str, int] = {}
    same = 0
    common = min(len(recording), len(walked))
    for p in range(common):
        reason = _difference(recording, walked, p, scene)
        if reason is None:
            same += 1
        else:
            reasons[reason] = reasons.get(reason, 0) + 1
    if len(recording) != len(walked):
        reasons["missing"] = abs(len(recording) - len(walked))
    differing = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
    return {
        "persons": f"{len(recording)} recorded, {len(walked)} replayed",
        "identical": f"{same} paths, to {TOLERANCE_M * 1000:g} mm and frame for frame",
        "differing": differing or "none",
    }


def _difference(recording: Trajectories, walked: Trajectories, p: int, scene: Scene) -> str | None:
    there, here = recording.path(p), walked.path(p)
    if recording.first[p] != walked.first[p]:
        return "enter in another frame"
    if len(there) != len(here):
        return "leave in another frame (a trip has at least two frames)"
    if np.abs(there - here).max() <= TOLERANCE_M:
        return None
    steps = np.linalg.norm(np.diff(there.astype(np.float64), axis=0), axis=1)
    if (steps > scene.motion.max_speed_mps * scene.dt_s).any():
        return "exceed the speed limit"
    return "meet a wall"


def arrival_rule_changes(recording: Trajectories, scene: Scene) -> dict[str, str]:
    """Effects of the rule that a trip ends at the goal, on recorded paths and straight walkers.

    Returns the results as text for a table, by name.
    """
    cut = cut_at_goals(recording, scene)
    frames = np.diff(recording.offsets) - np.diff(cut.offsets)
    shortened = frames[recording.left] * scene.dt_s
    straight = rollout(scene, Replay(recording), Straight(), seed=0)
    ended = np.bincount(straight.outcome, minlength=len(OUTCOMES))
    return {
        "recorded paths": f"{int((shortened > 0).sum())} of {len(shortened)} would end earlier, "
        f"by {shortened.sum():.1f} s in total",
        "straight walkers": ", ".join(
            f"{count} {OUTCOMES[k]}" for k, count in enumerate(ended) if count
        ),
    }
