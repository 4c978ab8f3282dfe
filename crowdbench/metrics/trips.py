"""Family trips: the trips of people who enter in a block, even if they leave after its end."""

import numpy as np

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.metrics.forms import RelativeWasserstein, ShareDifference, TotalVariation
from crowdbench.metrics.lattice import counted, histograms, kaplan_meier_cdf
from crowdbench.metrics.metric import Place, Statistics, Sums, Support, Vectors

SHORTEST_WAY_M = 1.0
"""Trips with a shorter distance from start to end have no meaningful detour ratio."""
LONGEST_DETOUR = 100.0
FAILED = (OUTCOMES.index("exit"), OUTCOMES.index("timeout"))


class Dwell(RelativeWasserstein):
    """Time from a person's first row to the last, for people who enter in the blocks.

    People who are still present when observation ends are right-censored, so the distribution is
    the Kaplan–Meier estimate. Distance: Wasserstein-1 divided by the recording's mean dwell time.
    A crowd that nobody enters is treated as if people stayed for one block.
    """

    name = "dwell"
    family = "trips"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`ended[b, d]`, `censored[b, d]`: trips of d frames that begin in block b."""
        persons, block, _ = blocks.of_arrivals(crowd)
        life = (crowd.last - crowd.first)[persons]
        left = crowd.left[persons]
        return {
            "ended": histograms(life[left], block[left], len(blocks)),
            "censored": histograms(life[~left], block[~left], len(blocks)),
        }

    def step(self, blocks: TimeBlocks) -> float:
        """Lattice step: one frame, in seconds."""
        return blocks.dt_s

    def if_empty(self, blocks: TimeBlocks) -> int:
        """Value of an empty sample: the mean length of the blocks, in frames."""
        return max(1, round(float(np.diff(blocks.frames).mean())))

    def on_lattice(self, name: str) -> bool:
        """True: both statistics are histograms."""
        return True

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The Kaplan–Meier distribution function."""
        return kaplan_meier_cdf(
            sums["ended"], sums["censored"], support, if_empty=self.if_empty(blocks)
        )

    def size(self, sums: Sums) -> int:
        """Number of trips, complete and censored."""
        return int(sums["ended"].sum() + sums["censored"].sum())


class OriginDestination(TotalVariation):
    """Share of each pair of spawn area and goal area among people who entered and left.

    Persons with an unknown area, or an area that the scene does not have, are ignored. Distance:
    total variation.
    """

    name = "origin_destination"
    family = "trips"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, k · G + g]`: persons who enter block b at area k with goal area g of G."""
        persons, block, _ = blocks.of_arrivals(crowd)
        origin, destination = crowd.spawn_area[persons], crowd.goal_area[persons]
        known = (origin >= 0) & (origin < place.spawn_areas) & crowd.left[persons]
        known &= (destination >= 0) & (destination < place.goal_areas)
        cell = origin[known].astype(np.int64) * place.goal_areas + destination[known]
        cells = place.spawn_areas * place.goal_areas
        return {"counts": histograms(cell, block[known], len(blocks), cells)}


class Detour(RelativeWasserstein):
    """Path length over the straight distance from start to end, for people who entered and left.

    People whose start and end are less than 1 m apart are ignored; ratios are clipped at 100.
    Distance: Wasserstein-1 of ratios rounded to 0.01, divided by the recording's mean. An empty
    sample is treated as people who walk straight.
    """

    name = "detour"
    family = "trips"
    lattice_step = 0.01
    empty = 1.0

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, r]`: trips that begin in block b with a ratio of r hundredths."""
        persons, block, _ = blocks.of_arrivals(crowd)
        length = crowd.path_lengths()[persons]
        way = np.linalg.norm(crowd.end.astype(np.float64) - crowd.start, axis=1)[persons]
        counts = crowd.left[persons] & (way >= SHORTEST_WAY_M)
        ratio = np.minimum(length[counts] / way[counts], LONGEST_DETOUR)
        return self.histogram(ratio, block[counts], blocks)


class GoalShare(ShareDifference):
    """Share of people who reached their goal, among those who entered and left.

    Trips that end with the outcome `exit` or `timeout` did not reach their goal. A recorded
    person's goal is the place where it left, so the share of a recording is 1. Distance:
    |difference|.
    """

    name = "goal_share"
    family = "trips"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: number of persons entering in block b who reach their goal, and who leave."""
        persons, block, _ = blocks.of_arrivals(crowd)
        left = crowd.left[persons]
        reached = ~np.isin(crowd.outcome[persons][left], FAILED)
        return {"share": counted(reached, block[left], len(blocks))}
