"""Family space, companions: how many people walk in groups, and how they stand to each other.

Companions are found by one rule in recordings and rollouts, see
`crowdbench.data.companions`.
"""

from functools import lru_cache
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.companions import groups_of
from crowdbench.data.stops import STANDING_MPS
from crowdbench.data.table import Trajectories
from crowdbench.metrics.forms import RelativeWasserstein, ShareDifference
from crowdbench.metrics.lattice import counted, histograms
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import Ticks, ticks_of

APART_M = 5.0
"""Distances between companions are clipped at this value."""


class CompanionShare(ShareDifference):
    """Share of people with a companion, among those who enter in the blocks.

    Distance: |difference|.
    """

    name = "companion_share"
    family = "space"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: number of persons who enter in block b with a companion, and of all."""
        persons, block, _ = blocks.of_arrivals(crowd)
        return {"share": counted(groups_of(crowd)[persons] >= 0, block, len(blocks))}


class GroupSize(RelativeWasserstein):
    """Size of the group of each person with a companion who enters in the blocks.

    Distance: Wasserstein-1, divided by the recording's mean. A crowd without companions is treated
    as one of single people.
    """

    name = "group_size"
    family = "space"
    unit = "persons"
    empty = 1.0

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of persons who enter in block b in a group of n."""
        persons, block, _ = blocks.of_arrivals(crowd)
        group = groups_of(crowd)
        size = np.bincount(group[group >= 0], minlength=1)
        together = group[persons] >= 0
        return {"counts": histograms(size[group[persons[together]]], block[together], len(blocks))}


class _OfPairs(RelativeWasserstein):
    """A length of pairs of companions at ticks, in steps of 5 cm, clipped at 5 m."""

    family = "space"
    unit = "m"
    lattice_step = 0.05
    empty = APART_M


class CompanionDistance(_OfPairs):
    """Distance between two companions at each tick, clipped at 5 m.

    Distance: Wasserstein-1 of distances rounded to 5 cm, divided by the recording's mean. A crowd
    without companions is treated as one whose companions are 5 m apart.
    """

    name = "companion_distance"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of pairs and ticks in block b with a distance of d · 5 cm."""
        pairs = pairs_of(crowd, blocks, place.walking.tick_frames)
        gap = np.minimum(np.hypot(*pairs.gap.T), APART_M)
        return self.histogram(gap, pairs.block, blocks)


class CompanionOffset(_OfPairs):
    """How far companions are apart across the direction in which they walk, clipped at 5 m.

    The direction is that of both together, over two ticks. Ticks at which they walk more slowly
    than 0.3 m/s are ignored. Distance: Wasserstein-1 of distances rounded to 5 cm, divided by the
    recording's mean. A crowd without companions is treated as one whose companions are 5 m apart.
    """

    name = "companion_offset"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of pairs and ticks in block b that are d · 5 cm abreast."""
        pairs = pairs_of(crowd, blocks, place.walking.tick_frames)
        walks, gap = pairs.abreast()
        across = np.minimum(np.abs(gap[:, 1]), APART_M)
        return self.histogram(across, pairs.block[walks], blocks)


class CompanionPairs(NamedTuple):
    """Pairs of companions at `n` ticks in blocks."""

    gap: Float[np.ndarray, "n 2"]
    """From one to the other, metres."""
    velocity: Float[np.ndarray, "n 2"]
    """Mean velocity of both from the tick before to the tick after, m/s; 0 where one is missing."""
    block: Int[np.ndarray, " n"]

    def abreast(self) -> tuple[Bool[np.ndarray, " n"], Float[np.ndarray, "m 2"]]:
        """Who walks, and the gaps of those along and across the direction in which both walk."""
        speed = np.hypot(*self.velocity.T)
        walks = speed >= STANDING_MPS
        (x, y), (vx, vy) = self.gap[walks].T, self.velocity[walks].T
        along, across = x * vx + y * vy, x * vy - y * vx
        return walks, np.column_stack([along, across]) / speed[walks, None]


@lru_cache(maxsize=1)  # two metrics use the pairs of the same crowd
def pairs_of(crowd: Trajectories, blocks: TimeBlocks, tick_frames: int) -> CompanionPairs:
    """All pairs of companions at the ticks at which both are there."""
    at = ticks_of(crowd, blocks, tick_frames)
    group = groups_of(crowd)
    members = np.flatnonzero(group >= 0)
    members = members[np.argsort(group[members], kind="stable")]
    edges = np.flatnonzero(np.diff(group[members])) + 1
    groups = [of_group.tolist() for of_group in np.split(members, edges)]
    pairs = [pair for of_group in groups for pair in combinations(of_group, 2)]
    persons = np.array(pairs, dtype=np.int64).reshape(-1, 2)
    begin = np.searchsorted(at.person, persons)
    stop = np.searchsorted(at.person, persons, side="right")
    seen = (begin < stop).all(axis=1)
    begin, stop = begin[seen], stop[seen]
    origin = begin - at.tick[begin]  # index of a person's position at tick 0, if it were there
    first, last = (begin - origin).max(axis=1), (stop - origin).min(axis=1)
    size = np.maximum(last - first, 0)
    tick = np.arange(size.sum()) + np.repeat(first - (size.cumsum() - size), size)
    one, other = (tick + np.repeat(origin[:, k], size) for k in (0, 1))
    inside = at.block[one] >= 0
    one, other = one[inside], other[inside]
    velocity, of_other = _velocities(at, one), _velocities(at, other)
    both = (velocity + of_other) / 2
    known = (velocity != 0).any(axis=1) & (of_other != 0).any(axis=1)
    both[~known] = 0.0
    return CompanionPairs(at.xy[other] - at.xy[one], both, at.block[one])


def _velocities(at: Ticks, index: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Mean velocities from the tick before to the tick after, m/s; 0 where one is missing."""
    before, after = np.maximum(index - 1, 0), np.minimum(index + 1, len(at.person) - 1)
    velocity = (at.xy[after] - at.xy[before]) / (2 * at.dt_s)
    velocity[(at.person[before] != at.person[after]) | (after - before < 2)] = 0.0
    return velocity
