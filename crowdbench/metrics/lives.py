"""Family lives: what becomes of those who enter in the blocks, followed past their edges."""

import numpy as np
from jaxtyping import Float

from crowdbench.metrics.forms import RelativeWasserstein, ShareDifference, TotalVariation
from crowdbench.metrics.lattice import counted, histograms, kaplan_meier_cdf, rounded
from crowdbench.metrics.metric import Place, Statistics, Sums, Support
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import OUTCOMES, Trajectories

SHORTEST_WAY_M = 1.0
"""Below this distance from start to end, a detour is no ratio to speak of."""
LONGEST_DETOUR = 100.0
FAILED = (OUTCOMES.index("exit"), OUTCOMES.index("timeout"))


class Dwell(RelativeWasserstein):
    """Time from a person's first row to its last, of those who enter in the blocks.

    Who is still there when observation ends is right-censored, and the distribution is
    Kaplan–Meier's. Distance: Wasserstein-1 divided by the recording's mean dwell time; a crowd
    that nobody enters counts as one that dwells a block long.
    """

    name = "dwell"
    family = "lives"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`ended[b, d]` and `censored[b, d]`: lives of d frames of those who enter in block b."""
        persons, block, _ = blocks.of_arrivals(crowd)
        life = (crowd.last - crowd.first)[persons]
        left = crowd.left[persons]
        return {
            "ended": histograms(life[left], block[left], len(blocks)),
            "censored": histograms(life[~left], block[~left], len(blocks)),
        }

    def step(self, blocks: TimeBlocks) -> float:
        """One frame."""
        return blocks.dt_s

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The mean length of the blocks."""
        return max(1, round(float(np.diff(blocks.frames).mean())))

    def on_lattice(self, name: str) -> bool:
        """Both."""
        return True

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """Kaplan–Meier's distribution function."""
        return kaplan_meier_cdf(
            sums["ended"], sums["censored"], support, if_empty=self.if_empty(blocks)
        )

    def size(self, sums: Sums) -> int:
        """Lives, whole and censored."""
        return int(sums["ended"].sum() + sums["censored"].sum())


class OriginDestination(TotalVariation):
    """Shares of the ways from spawn area to goal area among those who entered and left.

    Persons with an unknown area, or one that the place does not have, do not count. Distance:
    total variation.
    """

    name = "origin_destination"
    family = "lives"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, k · G + g]`: persons who enter at k in block b and walk to g."""
        persons, block, _ = blocks.of_arrivals(crowd)
        origin, destination = crowd.spawn_area[persons], crowd.goal_area[persons]
        known = (origin >= 0) & (origin < place.spawn_areas) & crowd.left[persons]
        known &= (destination >= 0) & (destination < place.goal_areas)
        cell = origin[known].astype(np.int64) * place.goal_areas + destination[known]
        cells = place.spawn_areas * place.goal_areas
        flat = np.bincount(block[known] * cells + cell, minlength=len(blocks) * cells)
        return {"counts": flat.reshape(len(blocks), cells)}


class Detour(RelativeWasserstein):
    """Path length over the straight distance from start to end, of those who entered and left.

    People whose start and end are less than 1 m apart do not count; ratios end at 100. Distance:
    Wasserstein-1 of ratios rounded to 0.01, divided by the recording's mean; nobody counts as
    people who walk straight.
    """

    name = "detour"
    family = "lives"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, r]`: lives with a ratio of r hundredths, of those who enter in block b."""
        persons, block, _ = blocks.of_arrivals(crowd)
        length = crowd.path_lengths()[persons]
        way = np.linalg.norm(crowd.end.astype(np.float64) - crowd.start, axis=1)[persons]
        counts = crowd.left[persons] & (way >= SHORTEST_WAY_M)
        ratio = np.minimum(length[counts] / way[counts], LONGEST_DETOUR)
        return {"counts": histograms(rounded(ratio, 0.01), block[counts], len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """0.01."""
        return 0.01

    def if_empty(self, blocks: TimeBlocks) -> int:
        """A ratio of 1."""
        return 100


class GoalShare(ShareDifference):
    """Share of those who entered and left who reached their goal: no exit, no timeout.

    A recorded person's goal is where it left, so that a recording's share is 1. Distance:
    |difference|.
    """

    name = "goal_share"
    family = "lives"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: persons who enter in block b and reach their goal, and who leave at all."""
        persons, block, _ = blocks.of_arrivals(crowd)
        left = crowd.left[persons]
        reached = ~np.isin(crowd.outcome[persons][left], FAILED)
        return {"share": counted(reached, block[left], len(blocks))}
