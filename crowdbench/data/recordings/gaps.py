"""Finds pauses of the annotation, as opposed to times when a scene was empty.

If people vanish or appear in the middle of the scene at the edges of a run of empty frames, the
annotation paused there. Such a gap is *unobserved*: the crowd is unknown, and the people at its
edges have neither left nor entered.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import Trajectories

NEIGHBOURHOOD_M = 1.0
USUAL_SHARE = 0.1


def observed_intervals(crowd: Trajectories) -> Int[np.ndarray, "I 2"]:
    """Find the observed intervals [start, stop), in frames, of a recording.

    A run of empty frames is unobserved if a track ends mid-scene in the frame before it, or starts
    mid-scene in the frame after it. A place is *mid-scene* if people pass there but rarely start
    (end) there: of the persons who come within 1 m of it, fewer than 10 % start (end) there.
    Starts (ends) at the edges of a pause are not counted.
    """
    present = crowd.present() > 0
    edges = np.flatnonzero(np.diff(present.astype(np.int8)))
    before, after = edges[::2], edges[1::2] + 1  # last frame before and first after each pause
    starts_at_edge = np.isin(crowd.first, np.r_[0, after])
    ends_at_edge = np.isin(crowd.last, np.r_[before, crowd.frames - 1])
    born_mid = starts_at_edge & _unusual(crowd.start, ~starts_at_edge, crowd)
    died_mid = ends_at_edge & _unusual(crowd.end, ~ends_at_edge, crowd)

    intervals, start = [], 0
    for last_before, first_after in zip(before, after, strict=True):
        unobserved = died_mid[crowd.last == last_before].any() or (
            born_mid[crowd.first == first_after].any()
        )
        if unobserved:
            intervals.append((start, last_before + 1))
            start = first_after
    intervals.append((start, crowd.frames))
    return np.array(intervals, dtype=np.int64)


def _unusual(
    points: Float[np.ndarray, "P 2"], usual: Bool[np.ndarray, " P"], crowd: Trajectories
) -> Bool[np.ndarray, " P"]:
    """Whether each person's start (end) is a place where people pass but rarely start (end)."""
    person = crowd.row_person()
    result = np.zeros(len(points), dtype=bool)
    for p in np.flatnonzero(~usual):
        close = np.linalg.norm(crowd.xy - points[p], axis=1) <= NEIGHBOURHOOD_M
        passing = len(np.unique(person[close]))
        starting = (np.linalg.norm(points[usual] - points[p], axis=1) <= NEIGHBOURHOOD_M).sum()
        result[p] = starting / passing < USUAL_SHARE
    return result
