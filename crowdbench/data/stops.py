"""Where and for how long people stop, by one rule for recordings and rollouts.

A person stands in a frame if its displacement over 1.6 s around the frame (less at the ends of its
trip) is below 0.3 m/s. A stop is a run of such frames. Runs of one person that are at most 4 s and
2 m apart belong to the same stop: people shift their feet. Only stops of 4 s and longer count.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import Trajectories

HALF_S = 0.8
"""Half of the time over which displacements are measured."""
STANDING_MPS = 0.3
"""Slower people stand; their displacements have no reliable direction."""
APART_S = 4.0
APART_M = 2.0
LEAST_S = 4.0


@dataclass(frozen=True, eq=False)
class Stops:
    """The `S` stops of a crowd, sorted by person, then by time."""

    person: Int[np.ndarray, " S"]
    first: Int[np.ndarray, " S"]
    """Index of the first row of each stop in `Trajectories.xy`."""
    last: Int[np.ndarray, " S"]
    """Index of the last row of each stop."""
    duration_s: Float[np.ndarray, " S"]
    place: Float[np.ndarray, "S 2"]
    """Mean position during each stop, metres."""


def standing(crowd: Trajectories) -> Bool[np.ndarray, " R"]:
    """Whether the person of each row stands in its frame."""
    from crowdbench.data.neighbour_kernels import stands

    half = max(1, round(HALF_S / crowd.dt_s))
    return stands(crowd.xy, crowd.offsets, half, STANDING_MPS, crowd.dt_s)


@lru_cache(maxsize=1)  # metrics and plans use the stops of the same crowd
def stops_of(crowd: Trajectories) -> Stops:
    """All stops of 4 s and longer."""
    person, stands = crowd.row_person(), standing(crowd)
    turns = np.flatnonzero((np.diff(person) != 0) | (np.diff(stands) != 0)) + 1
    begins = np.concatenate([[0], turns])
    lasts = np.concatenate([turns, [len(person)]]) - 1
    runs = stands[begins]
    first, last = begins[runs], lasts[runs]
    # Joining two runs moves the place of a stop, so runs are joined in order of time.
    joined = np.ones(len(first), dtype=bool)
    xy = crowd.xy.astype(np.float64)
    sums = np.concatenate([np.zeros((1, 2)), xy.cumsum(axis=0)])
    near = np.flatnonzero(
        (person[first[1:]] == person[last[:-1]])
        & ((first[1:] - last[:-1]) * crowd.dt_s <= APART_S + 1e-9)
    )
    start = first.copy()  # first row of the stop to which each run belongs
    for k in near.tolist():
        a, b, c, d = start[k], last[k] + 1, first[k + 1], last[k + 1] + 1
        gap = (sums[b] - sums[a]) / (b - a) - (sums[d] - sums[c]) / (d - c)
        if np.hypot(*gap) <= APART_M:
            start[k + 1] = a
            joined[k] = False
    first, last = start[joined], last[joined]
    duration_s = (last - first) * crowd.dt_s
    long = duration_s >= LEAST_S - 1e-9
    first, last = first[long], last[long]
    place = (sums[last + 1] - sums[first]) / (last + 1 - first)[:, None]
    return Stops(person[first], first, last, duration_s[long], place)
