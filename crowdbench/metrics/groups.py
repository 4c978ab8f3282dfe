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
from crowdbench.metrics.rows import ticks_of

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
    begin = np.searchsorted(at.person, np.arange(len(crowd)))
    stop = np.searchsorted(at.person, np.arange(len(crowd)), side="right")
    tick = crowd.row_frame()[at.row] // tick_frames
    velocity = np.zeros_like(at.xy)
    inner = at.with_room(1, 1)
    velocity[inner] = (at.xy[inner + 1] - at.xy[inner - 1]) / (2 * at.dt_s)
    members = np.flatnonzero(group >= 0)
    members = members[np.argsort(group[members], kind="stable")]
    edges = np.flatnonzero(np.diff(group[members])) + 1
    ones, others = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for of_group in np.split(members, edges):
        for a, b in combinations(of_group.tolist(), 2):
            if stop[a] == begin[a] or stop[b] == begin[b]:
                continue
            shift = int(begin[b] - tick[begin[b]] - begin[a] + tick[begin[a]])
            first, last = max(begin[a], begin[b] - shift), min(stop[a], stop[b] - shift)
            if first < last:
                ones.append(np.arange(first, last))
                others.append(np.arange(first, last) + shift)
    one, other = np.concatenate(ones), np.concatenate(others)
    inside = at.block[one] >= 0
    one, other = one[inside], other[inside]
    both = (velocity[one] + velocity[other]) / 2
    known = (velocity[one] != 0).any(axis=1) & (velocity[other] != 0).any(axis=1)
    both[~known] = 0.0
    return CompanionPairs(at.xy[other] - at.xy[one], both, at.block[one])
