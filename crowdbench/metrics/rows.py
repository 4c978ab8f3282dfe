"""Rows in time blocks, their nearest neighbours, and ticks: the frames with annotated positions."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Indices, Trajectories

FAR_M = 5e3
"""Distance beyond which people do not count as neighbours."""


@lru_cache(maxsize=1)  # several metrics use the rows of the same crowd
def rows_in(crowd: Trajectories, blocks: TimeBlocks) -> tuple[Indices, Indices]:
    """Indices of the rows whose frame lies in a block, and the block of each."""
    block = block_of_frames(blocks, crowd.frames)[crowd.row_frame()]
    rows = np.flatnonzero(block >= 0)
    return rows, block[rows]


@lru_cache(maxsize=1)
def block_of_frames(blocks: TimeBlocks, frames: int) -> Int[np.ndarray, " frames"]:
    """The block of each frame; −1 outside all blocks."""
    block = np.full(max(frames, int(blocks.frames.max())), -1)
    for b, (start, stop) in enumerate(blocks.frames):
        block[start:stop] = b
    return block


@lru_cache(maxsize=1)  # several metrics search for neighbours in the same crowd
def nearest_neighbour_m(crowd: Trajectories) -> Float[np.ndarray, " R"]:
    """Distance of each row to the nearest other person in the same frame; infinite if alone."""
    from crowdbench.data.neighbour_kernels import from_left_to_right, nearest

    row, begins = from_left_to_right(crowd.row_frame(), crowd.row_person(), crowd.xy[:, 0])
    xy = crowd.xy[row].astype(np.float64)
    result = np.empty(len(row))
    result[row] = nearest(xy, begins, FAR_M)
    return result


class Ticks(NamedTuple):
    """The positions of a crowd at its `n` ticks, trip by trip."""

    xy: Float[np.ndarray, "n 2"]
    """Metres."""
    tick: Int[np.ndarray, " n"]
    """Number of the tick of each position: its frame over `Walking.tick_frames`."""
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
    frame, person = frame[rows], crowd.row_person()[rows]
    block = block_of_frames(blocks, crowd.frames)[frame]
    xy = crowd.xy[rows].astype(np.float64)
    return Ticks(xy, frame // tick_frames, person, block, tick_frames * crowd.dt_s)
