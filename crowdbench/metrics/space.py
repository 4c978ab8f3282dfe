"""Family space: where people are, and how close to each other."""

import numpy as np

from crowdbench.metrics.forms import RelativeWasserstein, TotalVariation
from crowdbench.metrics.lattice import histograms, rounded
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import nearest_neighbour_m, rows_in
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

ALONE_M = 50.0


class Occupancy(TotalVariation):
    """Shares of the time that people spend in each cell of 1 m, in the frames in the blocks.

    Cells stand on whole metres; positions beyond the bounds count in a margin of one cell.
    Distance: total variation.
    """

    name = "occupancy"
    family = "space"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, cell]`: frames that persons spend in each cell, column by column."""
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
    """Distance to the nearest other person, of everyone who is not alone in a frame.

    It sees groups rather than avoidance. Distance: Wasserstein-1 of distances rounded to 1 cm,
    divided by the recording's mean; a crowd in which nobody has a neighbour counts as one whose
    neighbours are 50 m away, where distances end.
    """

    name = "nearest_neighbour"
    family = "space"
    unit = "m"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: persons and frames with a nearest neighbour d cm away."""
        rows, block = rows_in(crowd, blocks)
        nearest = nearest_neighbour_m(crowd)[rows]
        known = np.isfinite(nearest)
        gap = np.minimum(nearest[known], ALONE_M)
        return {"counts": histograms(rounded(gap, 0.01), block[known], len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """1 cm."""
        return 0.01

    def if_empty(self, blocks: TimeBlocks) -> int:
        """50 m."""
        return round(ALONE_M / 0.01)
