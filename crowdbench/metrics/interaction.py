"""Family interaction: how people avoid each other and walls."""

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.metrics.forms import RelativeWasserstein, ShareDifference
from crowdbench.metrics.lattice import counted, histograms
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support, Vectors, Weights
from crowdbench.metrics.rows import Ticks, nearest_neighbour_m, rows_in, ticks_of

ENCOUNTER_M = 2.0
STRANGERS_MPS = 0.7
BIN_M = 0.05
BINS = round(ENCOUNTER_M / BIN_M)
WALL_RANGE_M = 2.0
"""Distances to walls are clipped at this value."""


class Avoidance(Metric):
    """How much less often strangers come close to each other than if they ignored each other.

    An encounter is a run of consecutive ticks in which two people are within 2 m of each other.
    They are strangers if their mean velocities, each from the start to the end of the whole trip,
    differ by more than 0.7 m/s. With velocities of the encounter itself, a person who slows down
    near others would not count as a stranger. The closest approach is the smallest distance on the
    linear steps from the tick before to the tick after. The baseline is the same quantity for pairs
    of people one of whom is delayed, so that they cannot have seen each other; their paths, and how
    crowded they are, are the same.

    Distance: ∫ |ΔG(d)| dd over 2 m, where G is the distribution function of the observed closest
    approaches minus that of the baseline.
    """

    name = "avoidance"
    family = "interaction"
    unit = "m"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`observed[b, d]`, `shifted[b, d]`: encounters in block b, in bins of 5 cm."""
        from crowdbench.data.neighbour_kernels import from_left_to_right
        from crowdbench.metrics.kernels import encounters

        at = ticks_of(crowd, blocks, place.walking.tick_frames)
        velocity = _mean_velocities(at)
        order, begins = from_left_to_right(at.tick, at.person, at.xy[:, 0])

        def histogram(shift: int) -> Int[np.ndarray, "B 40"]:
            closest, index = encounters(
                at.xy, velocity, at.person, order, begins, shift, ENCOUNTER_M, STRANGERS_MPS
            )
            block = at.block[index]
            inside = block >= 0
            bins = np.minimum((closest[inside] / BIN_M).astype(np.int64), BINS - 1)
            return histograms(bins, block[inside], len(blocks), BINS)

        shifts = [round(shift_s / at.dt_s) for shift_s in place.walking.shifts_s]
        return {"observed": histogram(0), "shifted": np.sum([histogram(k) for k in shifts], axis=0)}

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """G at the upper edge of each bin; without encounters a distribution function is 0."""
        observed, shifted = (
            counts.cumsum(axis=-1) / np.maximum(counts.sum(axis=-1, keepdims=True), 1)
            for counts in (sums["observed"], sums["shifted"])
        )
        return np.asarray(observed - shifted)

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """Width of a bin, metres."""
        return np.full(1, BIN_M)

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """∫ G dd: minus the distance by which strangers keep away from each other, metres."""
        return float(self.embed(sums, support, blocks).sum() * BIN_M)

    def size(self, sums: Sums) -> int:
        """Number of observed encounters."""
        return int(sums["observed"].sum())


def _mean_velocities(at: Ticks) -> Float[np.ndarray, "n 2"]:
    """Mean velocity of each position's person from its first to its last tick, m/s."""
    begin = np.flatnonzero(np.diff(at.person, prepend=-1) != 0)
    length = np.diff(np.append(begin, len(at.person)))
    way = at.xy[begin + length - 1] - at.xy[begin]
    return np.repeat(way / (np.maximum(length - 1, 1) * at.dt_s)[:, None], length, axis=0)


class WallClearance(RelativeWasserstein):
    """Distance of each position at a tick to the nearest wall, clipped at 2 m.

    Distance: Wasserstein-1 of distances rounded to 5 cm, divided by the recording's mean.
    """

    name = "wall_clearance"
    family = "interaction"
    unit = "m"
    lattice_step = 0.05
    empty = WALL_RANGE_M

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of positions in block b at a distance of d · 5 cm from walls."""
        at = ticks_of(crowd, blocks, place.walking.tick_frames)
        inside = at.block >= 0
        distance = clearance(place.walls, at.xy[inside])
        return self.histogram(distance, at.block[inside], blocks)


def clearance(
    walls: tuple[tuple[tuple[float, float], ...], ...], xy: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Distance of each position to the nearest wall in metres, at most 2; 0 inside a wall."""
    import shapely

    from crowdbench.metrics.kernels import CELL_M, clearances

    if not walls:
        return np.full(len(xy), WALL_RANGE_M)
    solid, grid = _walls_by_cell(walls)
    distance = clearances(xy, WALL_RANGE_M, *grid)
    near = np.flatnonzero(distance <= CELL_M)  # the others are where the centre of their cell is
    distance[near[shapely.contains_xy(solid, *xy[near].T)]] = 0.0
    return distance


@lru_cache(maxsize=8)
def _walls_by_cell(
    walls: tuple[tuple[tuple[float, float], ...], ...],
) -> tuple[Any, tuple[Any, ...]]:
    """The union of all walls; their edges, and for each cell of a grid the edges near it, and
    whether its centre is inside a wall.
    """
    import shapely

    from crowdbench.metrics.kernels import CELL_M, near_segments

    solid = shapely.union_all([shapely.Polygon(corners) for corners in walls])
    shapely.prepare(solid)
    rings = [np.array([*corners, corners[0]], dtype=np.float64) for corners in walls]
    segments = np.concatenate([np.hstack([ring[:-1], ring[1:]]) for ring in rings])
    points = np.concatenate(rings)
    lower = points.min(axis=0) - WALL_RANGE_M
    columns, rows = (np.ceil((points.max(axis=0) + WALL_RANGE_M - lower) / CELL_M)).astype(int)
    start, near = near_segments(segments, lower, int(columns), int(rows), WALL_RANGE_M)
    row, column = np.divmod(np.arange(columns * rows), columns)
    inside = shapely.contains_xy(
        solid, lower[0] + (column + 0.5) * CELL_M, lower[1] + (row + 0.5) * CELL_M
    )
    return solid, (segments, lower, int(columns), int(rows), start, near, inside)


class OverlapRate(ShareDifference):
    """Share of positions at which a person's disc overlaps another person's disc.

    Positions of people who are alone in a frame are ignored. The distance |difference| is
    two-sided, because people overlap in recordings too, mostly those who walk together.
    """

    name = "overlap_rate"
    family = "interaction"
    scored = False

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: number of positions with an overlap, and of positions of people not alone."""
        rows, block = rows_in(crowd, blocks)
        nearest = nearest_neighbour_m(crowd)[rows]
        known = np.isfinite(nearest)
        return {"share": counted(nearest[known] < 2 * place.radius_m, block[known], len(blocks))}
