"""Family interaction: how people keep clear of each other and of walls."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.blocks import TimeBlocks
from crowdbench.metrics.forms import RelativeWasserstein, ShareDifference
from crowdbench.metrics.lattice import counted, histograms, rounded
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import (
    block_of_frames,
    nearest_neighbour_m,
    pairs_within,
    rows_in,
    velocities,
)
from crowdbench.trajectories import Trajectories

ENCOUNTER_M = 2.0
STRANGERS_MPS = 0.7
TOUCH_M = 0.02
"""This close to a wall counts as touching it: a simulated step ends a hair before."""


def _lengths(
    vectors: Float[np.ndarray, "R 2"], pairs: Int[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Length of the difference of the two rows of each pair."""
    x, y = (vectors[pairs[:, 0]] - vectors[pairs[:, 1]]).T
    length: np.ndarray = np.sqrt(x * x + y * y)
    return length


class ClosestApproach(RelativeWasserstein):
    """Smallest distance between two strangers in each of their encounters.

    An encounter is a run of frames in which two people are within 2 m of each other; they are
    strangers where their relative speed exceeds 0.7 m/s in more than half of these frames. It
    sees avoidance, since people who walk together do not count. It counts in the block of its
    minimum. Distance: Wasserstein-1 of distances rounded to 1 cm, divided by the recording's
    mean; a crowd without an encounter counts as one whose strangers pass 2 m apart.
    """

    name = "closest_approach"
    family = "interaction"
    unit = "m"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: encounters with a closest approach of d cm in block b."""
        pairs = pairs_within(crowd, ENCOUNTER_M)
        person, frame = crowd.row_person(), crowd.row_frame()
        # By pair of persons, then by frame.
        a, b = person[pairs].T
        order = np.lexsort((pairs[:, 0], b, a))
        pairs, a, b = pairs[order], a[order], b[order]
        t = frame[pairs[:, 0]]
        new = (np.diff(a, prepend=-1) != 0) | (np.diff(b, prepend=-1) != 0)
        new |= np.diff(t, prepend=-1) != 1
        encounter = np.cumsum(new) - 1
        gap = _lengths(crowd.xy.astype(np.float64), pairs)
        fast = np.bincount(encounter, _lengths(velocities(crowd), pairs) > STRANGERS_MPS)
        strangers = fast > np.bincount(encounter) / 2
        # The first frame of each encounter's smallest distance.
        smallest = np.full(len(strangers), np.inf)
        np.minimum.at(smallest, encounter, gap)
        closest = np.flatnonzero(gap == smallest[encounter])
        closest = closest[np.diff(encounter[closest], prepend=-1) != 0]
        block = block_of_frames(blocks, crowd.frames)[t[closest]]
        counts = strangers & (block >= 0)
        return {
            "counts": histograms(rounded(gap[closest][counts], 0.01), block[counts], len(blocks))
        }

    def step(self, blocks: TimeBlocks) -> float:
        """1 cm."""
        return 0.01

    def if_empty(self, blocks: TimeBlocks) -> int:
        """2 m."""
        return round(ENCOUNTER_M / 0.01)


class OverlapRate(ShareDifference):
    """Share of the frames of people who are not alone in which their disc overlaps another's.

    Two-sided: in recordings people overlap too, mostly those who walk together. Distance:
    |difference|.
    """

    name = "overlap_rate"
    family = "interaction"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: persons and frames that overlap someone, and that are not alone."""
        rows, block = rows_in(crowd, blocks)
        nearest = nearest_neighbour_m(crowd)[rows]
        known = np.isfinite(nearest)
        return {"share": counted(nearest[known] < 2 * place.radius_m, block[known], len(blocks))}


class WallHits(ShareDifference):
    """Share of people's frames in which they touch a wall, that is, come within 2 cm of it.

    Distance: |difference|.
    """

    name = "wall_hits"
    family = "interaction"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: persons and frames at a wall, and in all."""
        import shapely

        rows, block = rows_in(crowd, blocks)
        walls = shapely.union_all([shapely.Polygon(corners) for corners in place.walls])
        shapely.prepare(walls)
        points = shapely.points(crowd.xy[rows].astype(np.float64))
        return {"share": counted(shapely.dwithin(walls, points, TOUCH_M), block, len(blocks))}
