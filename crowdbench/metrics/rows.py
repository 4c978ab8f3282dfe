"""Helpers shared by several metrics: rows in time blocks, and velocities."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories


def rows_in(
    crowd: Trajectories, blocks: TimeBlocks
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
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


def velocities(crowd: Trajectories) -> Float[np.ndarray, "R 2"]:
    """Velocity at each row, m/s: central differences, one-sided at the ends of a trip."""
    xy = crowd.xy.astype(np.float64)
    first, last = crowd.offsets[:-1], crowd.offsets[1:] - 1
    result = np.empty_like(xy)
    result[1:-1] = (xy[2:] - xy[:-2]) / (2 * crowd.dt_s)
    result[first] = (xy[np.minimum(first + 1, last)] - xy[first]) / crowd.dt_s
    result[last] = (xy[last] - xy[np.maximum(last - 1, first)]) / crowd.dt_s
    return result
