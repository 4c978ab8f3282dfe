"""Rows in time blocks, shared by several metrics."""

import numpy as np
from jaxtyping import Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories


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
