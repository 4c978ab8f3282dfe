"""Family space: where people are, and how close they are to each other."""

import numpy as np
from jaxtyping import Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Indices, Points, Trajectories
from crowdbench.metrics.forms import RelativeWasserstein, TotalVariation
from crowdbench.metrics.lattice import histograms
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import nearest_neighbour_m, rows_in

ALONE_M = 50.0


class Occupancy(TotalVariation):
    """Share of the time that people spend in each 1 m × 1 m cell.

    Cell edges are at whole metres; positions outside the bounds are counted in a margin of one
    cell. Distance: total variation.
    """

    name = "occupancy"
    family = "space"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, cell]`: number of positions in each cell; cells are in order of x, then y."""
        rows, block = rows_in(crowd, blocks)
        return {"counts": _cells(crowd.xy[rows], block, len(blocks), place)}


class StartDensity(TotalVariation):
    """Share of people who enter in each 1 m × 1 m cell; cells are those of `Occupancy`.

    Distance: total variation.
    """

    name = "start_density"
    family = "space"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, cell]`: number of persons who enter in block b in each cell."""
        persons, block, _ = blocks.of_arrivals(crowd)
        return {"counts": _cells(crowd.start[persons], block, len(blocks), place)}


class GoalDensity(TotalVariation):
    """Share of people who leave in each 1 m × 1 m cell; cells are those of `Occupancy`.

    People who were not seen to leave are ignored. Distance: total variation.
    """

    name = "goal_density"
    family = "space"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, cell]`: number of persons who enter in block b and leave in each cell."""
        persons, block, _ = blocks.of_arrivals(crowd)
        left = crowd.left[persons]
        return {"counts": _cells(crowd.end[persons[left]], block[left], len(blocks), place)}


def _cells(xy: Points, block: Indices, blocks: int, place: Place) -> Int[np.ndarray, "B C"]:
    """Number of points of each block in each cell, with a margin of one cell."""
    x0, x1, y0, y1 = place.bounds_m
    low = np.floor([x0, y0]).astype(np.int64) - 1
    high = np.ceil([x1, y1]).astype(np.int64)
    cell = np.clip(np.floor(xy), low, high).astype(np.int64) - low
    columns, cells = high - low + 1, int((high - low + 1).prod())
    return histograms(cell[:, 0] * columns[1] + cell[:, 1], block, blocks, cells)


class NearestNeighbour(RelativeWasserstein):
    """Distance to the nearest other person in the same frame.

    People who are alone in a frame are ignored. The metric measures groups rather than avoidance.
    Distance: Wasserstein-1 of distances rounded to 1 cm and clipped at 50 m, divided by the
    recording's mean. A crowd in which nobody has a neighbour is treated as one whose neighbours
    are 50 m away.
    """

    name = "nearest_neighbour"
    family = "space"
    unit = "m"
    lattice_step = 0.01
    empty = ALONE_M

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of positions whose nearest neighbour is d cm away."""
        rows, block = rows_in(crowd, blocks)
        nearest = nearest_neighbour_m(crowd)[rows]
        known = np.isfinite(nearest)
        gap = np.minimum(nearest[known], ALONE_M)
        return self.histogram(gap, block[known], blocks)
