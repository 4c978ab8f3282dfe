"""What is measured in rooms: times, flows, densities and speeds of trajectories."""

import numpy as np
from jaxtyping import Float

from crowdbench.data.table import Trajectories
from crowdbench.exam.rooms import Box, Line


def left_s(crowd: Trajectories) -> Float[np.ndarray, " P"]:
    """When each person reached its goal or walked out, in seconds; infinite if it is still there.

    Who is present in the last frame is still there.
    """
    gone = crowd.last < crowd.frames - 1
    return np.where(gone, crowd.last * crowd.dt_s, np.inf)


def last_left_s(crowd: Trajectories) -> float:
    """When the last person had left, in seconds; infinite if somebody is still there."""
    return float(left_s(crowd).max(initial=0.0))


def crossed_s(crowd: Trajectories, line: Line) -> Float[np.ndarray, " P"]:
    """When each person first crossed a line, in seconds, between frames; infinite if it did not."""
    a, b = np.array(line[:2]), np.array(line[2:])
    along = (b - a) / np.linalg.norm(b - a)
    across = np.array([-along[1], along[0]])
    # In the frame of the line: distance along it, and to its side.
    rows = (crowd.xy.astype(np.float64) - a) @ np.stack([along, across], axis=1)
    times = np.full(len(crowd), np.inf)
    side, person, frame = rows[:, 1], crowd.row_person(), crowd.row_frame()
    change = (np.diff(person) == 0) & ((side[:-1] < 0) != (side[1:] < 0))
    for row in np.flatnonzero(change)[::-1]:  # backwards, so that the first crossing stays
        share = side[row] / (side[row] - side[row + 1])
        at = rows[row, 0] + share * (rows[row + 1, 0] - rows[row, 0])
        if 0 <= at <= np.linalg.norm(b - a):
            times[person[row]] = (frame[row] + share) * crowd.dt_s
    return times


def flow_per_s(times_s: Float[np.ndarray, " n"]) -> float:
    """Mean flow between the first and the last tenth of those who pass, persons per second.

    The first and the last are left out, because the queue has not formed yet or is over. NaN if
    fewer than ten pass.
    """
    passed = np.sort(times_s[np.isfinite(times_s)])
    if len(passed) < 10:
        return float("nan")
    first, last = int(0.1 * len(passed)), int(0.9 * len(passed)) - 1
    return float((last - first) / (passed[last] - passed[first]))


def inside(crowd: Trajectories, box: Box) -> np.ndarray:
    """Whether each row lies in a rectangle, (R,)."""
    x, y = crowd.xy.T
    within: np.ndarray = (x >= box[0]) & (x <= box[2]) & (y >= box[1]) & (y <= box[3])
    return within


def densities(crowd: Trajectories, box: Box) -> Float[np.ndarray, " frames"]:
    """Persons per square metre in a rectangle, in each frame."""
    area = (box[2] - box[0]) * (box[3] - box[1])
    frames = crowd.row_frame()[inside(crowd, box)]
    return np.bincount(frames, minlength=crowd.frames) / area


def speed_within(crowd: Trajectories, box: Box, from_s: float, to_s: float) -> float:
    """Mean speed of those who are in a rectangle during a time, in m/s; NaN if nobody is.

    The speed of a step is its length over its duration, and belongs to the row where it begins.
    """
    steps = np.linalg.norm(np.diff(crowd.xy.astype(np.float64), axis=0), axis=1) / crowd.dt_s
    same = np.diff(crowd.row_person()) == 0
    time_s = crowd.row_frame()[:-1] * crowd.dt_s
    chosen = same & inside(crowd, box)[:-1] & (time_s >= from_s) & (time_s <= to_s)
    return float(steps[chosen].mean()) if chosen.any() else float("nan")


def started_s(crowd: Trajectories, away_m: float) -> Float[np.ndarray, " P"]:
    """When each person was first `away_m` from its start, in seconds; infinite if never."""
    times = np.full(len(crowd), np.inf)
    for p in range(len(crowd)):
        path = crowd.path(p).astype(np.float64)
        away = np.linalg.norm(path - path[0], axis=1) >= away_m
        if away.any():
            times[p] = (crowd.first[p] + away.argmax()) * crowd.dt_s
    return times


def nearest_m(crowd: Trajectories) -> float:
    """Smallest distance between two people in any frame, in metres; infinite if nobody meets."""
    from scipy.spatial import KDTree

    frames = crowd.row_frame()
    order = np.argsort(frames, kind="stable")
    least = np.inf
    for rows in np.split(order, np.flatnonzero(np.diff(frames[order])) + 1):
        if len(rows) > 1:
            distances, _ = KDTree(crowd.xy[rows]).query(crowd.xy[rows], k=2)
            least = min(least, float(distances[:, 1].min()))
    return least
