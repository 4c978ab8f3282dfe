"""Family space: where people are, and how close they are to each other."""

import numpy as np

from crowdbench.metrics.forms import RelativeWasserstein, TotalVariation
from crowdbench.metrics.lattice import histograms, rounded
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import rows_in
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.neighbours import nearest_neighbour_m
from crowdbench.trajectories.table import Trajectories

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
        x0, x1, y0, y1 = place.bounds_m
        low = np.floor([x0, y0]).astype(np.int64) - 1
        high = np.ceil([x1, y1]).astype(np.int64)
        cell = np.clip(np.floor(crowd.xy[rows]), low, high).astype(np.int64) - low
        columns, cells = high - low + 1, int((high - low + 1).prod())
        flat = block * cells + cell[:, 0] * columns[1] + cell[:, 1]
        counts = np.bincount(flat, minlength=len(blocks) * cells)
        return {"counts": counts.reshape(len(blocks), cells)}


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

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of positions whose nearest neighbour is d cm away."""
        rows, block = rows_in(crowd, blocks)
        nearest = nearest_neighbour_m(crowd)[rows]
        known = np.isfinite(nearest)
        gap = np.minimum(nearest[known], ALONE_M)
        return {"counts": histograms(rounded(gap, 0.01), block[known], len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """Lattice step: 0.01 m."""
        return 0.01

    def if_empty(self, blocks: TimeBlocks) -> int:
        """Value of an empty sample: 50 m, in lattice steps."""
        return round(ALONE_M / 0.01)
