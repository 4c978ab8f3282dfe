"""Family interaction: how people keep clear of each other and of walls."""

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

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
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

ENCOUNTER_M = 2.0
STRANGERS_MPS = 0.7
CELLS = 250_000
"""At most so many cells, of 0.25 m or more, tell where walls are."""
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
        # By pair of persons, then by frame, as they come.
        both = person[pairs[:, 0]] * len(crowd) + person[pairs[:, 1]]
        order = np.argsort(both, kind="stable")
        pairs, both = pairs[order], both[order]
        t = frame[pairs[:, 0]]
        new = (np.diff(both, prepend=-1) != 0) | (np.diff(t, prepend=-1) != 1)
        encounter = np.cumsum(new) - 1
        gap = _lengths(crowd.xy.astype(np.float64), pairs)
        fast = np.bincount(encounter, _lengths(velocities(crowd), pairs) > STRANGERS_MPS)
        strangers = fast > np.bincount(encounter) / 2
        # The first frame of each encounter's smallest distance.
        smallest = np.minimum.reduceat(gap, np.flatnonzero(new)) if len(gap) else gap
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
        rows, block = rows_in(crowd, blocks)
        return {"share": counted(touching(place.walls, crowd.xy[rows]), block, len(blocks))}


def touching(
    walls: tuple[tuple[tuple[float, float], ...], ...], xy: Float32[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Whether each position is at a wall, or in one."""
    import shapely

    solid, lower, cell_m, near = _walls_by_cell(walls)
    column, line = (
        np.clip((xy[:, k].astype(np.float64) - lower[k]) / cell_m, -1, size).astype(np.int64)
        for k, size in enumerate(near.shape)
    )
    beyond = (column < 0) | (column == near.shape[0]) | (line < 0) | (line == near.shape[1])
    at = np.flatnonzero(~beyond)
    at = at[near[column[at], line[at]]]
    hit = np.zeros(len(xy), dtype=bool)
    hit[at] = shapely.dwithin(solid, shapely.points(xy[at].astype(np.float64)), TOUCH_M)
    return hit


@lru_cache(maxsize=8)
def _walls_by_cell(
    walls: tuple[tuple[tuple[float, float], ...], ...],
) -> tuple[Any, Float[np.ndarray, " 2"], float, Bool[np.ndarray, "X Y"]]:
    """All walls as one shape, and in which cells, from `lower` on, a position may be at one."""
    import shapely

    solid = shapely.union_all([shapely.Polygon(corners) for corners in walls])
    shapely.prepare(solid)
    if solid.is_empty:
        return solid, np.zeros(2), 1.0, np.zeros((0, 0), dtype=bool)
    x_min, y_min, x_max, y_max = solid.bounds
    cell_m = max(0.25, ((x_max - x_min) * (y_max - y_min) / CELLS) ** 0.5)
    lower = np.array([x_min, y_min]) - cell_m
    count = np.ceil((np.array([x_max, y_max]) - lower) / cell_m).astype(int) + 1
    x, y = (low + (np.arange(n) + 0.5) * cell_m for low, n in zip(lower, count, strict=True))
    centre = shapely.points(*np.meshgrid(x, y, indexing="ij"))
    # A centre is at most 0.71 of a cell away from the cell's points.
    return solid, lower, cell_m, shapely.dwithin(solid, centre, TOUCH_M + 0.75 * cell_m)
