"""Rows in time blocks, their nearest neighbours, and ticks: the frames with annotated positions."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Indices, Trajectories

FAR_M = 5e3
"""Distance beyond which people do not count as neighbours."""


def rows_in(crowd: Trajectories, blocks: TimeBlocks) -> tuple[Indices, Indices]:
    """Indices of the rows whose frame lies in a block, and the block of each."""
    block = block_of_frames(blocks, crowd.frames)[crowd.row_frame()]
    rows = np.flatnonzero(block >= 0)
    return rows, block[rows]


def block_of_frames(blocks: TimeBlocks, frames: int) -> Int[np.ndarray, " frames"]:
    """The block of each frame; −1 outside all blocks."""
    block = np.full(max(frames, int(blocks.frames.max())), -1)
    for b, (start, stop) in enumerate(blocks.frames):
        block[start:stop] = b
    return block


@lru_cache(maxsize=1)  # several metrics search for neighbours in the same crowd
def nearest_neighbour_m(crowd: Trajectories) -> Float[np.ndarray, " R"]:
    """Distance of each row to the nearest other person in the same frame; infinite if alone."""
    from crowdbench.data.neighbour_kernels import nearest

    frame = crowd.row_frame()
    row = np.lexsort((crowd.xy[:, 0], frame))  # in each frame from left to right
    begins = np.concatenate([[0], np.cumsum(np.bincount(frame))])
    xy = crowd.xy[row].astype(np.float64)
    result = np.empty(len(row))
    result[row] = nearest(xy, begins, FAR_M)
    return result


class Ticks(NamedTuple):
    """The positions of a crowd at its `n` ticks, trip by trip."""

    xy: Float[np.ndarray, "n 2"]
    """Metres."""
    row: Int[np.ndarray, " n"]
    """Index of each position in `Trajectories.xy`."""
    person: Int[np.ndarray, " n"]
    block: Int[np.ndarray, " n"]
    """Time block of each position; −1 outside all blocks."""
    dt_s: float
    """Seconds from one tick to the next."""

    def with_room(self, before: int, after: int) -> Int[np.ndarray, " m"]:
        """Indices of the positions whose trip has as many ticks before and after them."""
        index = np.arange(before, max(before, len(self.xy) - after))
        return index[self.person[index - before] == self.person[index + after]]


@lru_cache(maxsize=1)  # several metrics use the ticks of the same crowd
def ticks_of(crowd: Trajectories, blocks: TimeBlocks, tick_frames: int) -> Ticks:
    """The positions of a crowd at its ticks."""
    frame = crowd.row_frame()
    rows = np.flatnonzero(frame % tick_frames == 0)
    block = block_of_frames(blocks, crowd.frames)[frame[rows]]
    xy = crowd.xy[rows].astype(np.float64)
    return Ticks(xy, rows, crowd.row_person()[rows], block, tick_frames * crowd.dt_s)
