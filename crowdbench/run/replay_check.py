"""Checks whether replaying a recording reproduces it, and explains deviations."""

from collections import Counter

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.scene import Scene

TOLERANCE_M = 1e-3


def compare_replay(recording: Trajectories, walked: Trajectories, scene: Scene) -> dict[str, str]:
    """Count the replayed paths that equal the recorded ones to 1 mm, and why others differ.

    Returns the results as text for a table, by name.
    """
    common = range(min(len(recording), len(walked)))
    reasons = Counter(_difference(recording, walked, p, scene) for p in common)
    same = reasons.pop("", 0)
    if len(recording) != len(walked):
        reasons["missing"] = abs(len(recording) - len(walked))
    differing = ", ".join(f"{count} {reason}" for reason, count in reasons.items())
    return {
        "persons": f"{len(recording)} recorded, {len(walked)} replayed",
        "identical": f"{same} paths, to {TOLERANCE_M * 1000:g} mm and frame for frame",
        "differing": differing or "none",
    }


def _difference(recording: Trajectories, walked: Trajectories, p: int, scene: Scene) -> str:
    """Why a replayed path differs from the recorded one; empty if it does not."""
    there, here = recording.path(p), walked.path(p)
    if recording.first[p] != walked.first[p]:
        return "enter in another frame"
    if len(there) != len(here):
        return "leave in another frame (a trip has at least two frames)"
    if np.abs(there - here).max() <= TOLERANCE_M:
        return ""
    steps = np.linalg.norm(np.diff(there.astype(np.float64), axis=0), axis=1)
    if (steps > scene.motion.max_speed_mps * scene.dt_s).any():
        return "exceed the speed limit"
    return "meet a wall"
