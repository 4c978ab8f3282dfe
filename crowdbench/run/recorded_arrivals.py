"""Rollouts of other simulators under the recorded arrivals: who is who, and who arrived."""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import RecordingError
from crowdbench.scene import Scene

LATE_S, FAR_M = 1.0, 1.0
"""People are recognised by where and when they enter, to within this time and distance."""
KNOWN = 0.95
"""Share of the people who have to be recognised."""
_PLAN = ("spawn_area", "goal_area", "goal_x", "goal_y", "group")
_UNKNOWN, _GOAL, _EXIT = (OUTCOMES.index(name) for name in ("unknown", "goal", "exit"))


def recognised(crowd: Trajectories, recording: Trajectories, scene: Scene) -> Trajectories:
    """The crowd with the goals, areas and companions of the recorded people it consists of.

    People who left and whose outcome is unknown get the outcome `goal` if they ended within 1 m of
    the recorded goal (or within the scene's goal radius, if that is larger), otherwise `exit`.

    Raises:
        RecordingError: fewer than 95 % of the people, recorded or simulated, are recognised.
    """
    person = matched(crowd, recording)
    known = person >= 0
    most = max(len(crowd), len(recording), 1)
    if known.sum() < KNOWN * most:
        raise RecordingError(
            f"crowd scored on {scene.id}",
            got=f"{len(crowd)} people, of whom {int(known.sum())} enter like one of the "
            f"{len(recording)} recorded people",
            expected=f"at least {KNOWN:.0%}, within {LATE_S:g} s and {FAR_M:g} m",
            hint=f"`crowdbench spawn sample {scene.asked} --model replay --out arrivals.csv` "
            "writes the recorded arrivals. Without --recorded-arrivals, arrivals are scored too.",
        )
    whose = person[known]
    columns = {name: getattr(crowd, name).copy() for name in (*_PLAN, "left", "outcome")}
    for name in _PLAN:
        columns[name][known] = getattr(recording, name)[whose]
    columns["left"][known] &= recording.left[whose]  # who was not seen to leave stays censored
    goal = np.stack([columns["goal_x"], columns["goal_y"]], axis=1)
    near_m = max(FAR_M, scene.motion.goal_radius_m)
    near = np.linalg.norm(crowd.end - goal, axis=1) <= near_m
    untold = known & columns["left"] & (crowd.outcome == _UNKNOWN)
    columns["outcome"][untold] = np.where(near[untold], _GOAL, _EXIT)
    return replace(crowd, **columns)


def matched(crowd: Trajectories, recording: Trajectories) -> Int[np.ndarray, " P"]:
    """Index in the recording of each of the `P` people of a crowd; −1 for nobody.

    In order of entry, each recorded person is the nearest person who enters within `LATE_S` and
    `FAR_M` and is not yet taken.
    """
    found = np.full(len(crowd), -1)
    order = np.argsort(crowd.requested_s, kind="stable")
    times = crowd.requested_s[order]
    free: Bool[np.ndarray, " P"] = np.ones(len(crowd), dtype=bool)
    starts: Float[np.ndarray, "P 2"] = crowd.start[order].astype(np.float64)
    first = np.searchsorted(times, recording.requested_s - LATE_S - 1e-9)
    stop = np.searchsorted(times, recording.requested_s + LATE_S + 1e-9)
    for p in np.argsort(recording.requested_s, kind="stable").tolist():
        window = slice(first[p], stop[p])
        distance = np.linalg.norm(starts[window] - recording.start[p], axis=1)
        distance[~free[window]] = np.inf
        if len(distance) and distance.min() <= FAR_M:
            at = first[p] + int(distance.argmin())
            found[order[at]], free[at] = p, False
    return found
