"""Rows of a crowd in time blocks, and who is near whom: what several metrics look at."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

FAR_M = 5e3
"""From here on people are nobody's neighbours."""


def rows_in(
    crowd: Trajectories, blocks: TimeBlocks
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Rows whose frame lies in a block, and that block."""
    block = block_of_frames(blocks, crowd.frames)[crowd.row_frame()]
    rows = np.flatnonzero(block >= 0)
    return rows, block[rows]


def block_of_frames(blocks: TimeBlocks, frames: int) -> Int[np.ndarray, " frames"]:
    """The block of each frame, −1 outside all of them."""
    block = np.full(max(frames, int(blocks.frames.max())), -1)
    for b, (start, stop) in enumerate(blocks.frames):
        block[start:stop] = b
    return block


@lru_cache(maxsize=1)  # neighbours are looked for by three metrics of the same crowd
def _by_frame(
    crowd: Trajectories,
) -> tuple[Float[np.ndarray, "R 2"], Int[np.ndarray, " _"], Int[np.ndarray, " R"]]:
    """Positions as `neighbours` wants them, where each frame begins, and the row of each."""
    from crowdbench.metrics.neighbours import sort_from_left

    frame = crowd.row_frame()
    row = np.argsort(frame, kind="stable")
    begins = np.concatenate([[0], np.cumsum(np.bincount(frame))])
    xy = crowd.xy[row].astype(np.float64)
    sort_from_left(xy, row, begins)
    return xy, begins, row


@lru_cache(maxsize=1)
def nearest_neighbour_m(crowd: Trajectories) -> Float[np.ndarray, " R"]:
    """Distance of each row to the nearest other person in the same frame; infinite if alone."""
    from crowdbench.metrics.neighbours import nearest

    xy, begins, row = _by_frame(crowd)
    result = np.empty(len(row))
    result[row] = nearest(xy, begins, FAR_M)
    return result


def pairs_within(crowd: Trajectories, radius_m: float) -> Int[np.ndarray, "n 2"]:
    """All pairs of rows of one frame that are no further apart than this, frame by frame.

    Within a pair the smaller row, which is the person with the smaller index, comes first.
    """
    from crowdbench.metrics.neighbours import pairs

    xy, begins, row = _by_frame(crowd)
    found: np.ndarray = row[pairs(xy, begins, radius_m)]
    found.sort(axis=1)
    return found


def velocities(crowd: Trajectories) -> Float[np.ndarray, "R 2"]:
    """Velocity at each row, m/s: central differences, one-sided at the ends of a life."""
    xy = crowd.xy.astype(np.float64)
    first, last = crowd.offsets[:-1], crowd.offsets[1:] - 1
    result = np.empty_like(xy)
    result[1:-1] = (xy[2:] - xy[:-2]) / (2 * crowd.dt_s)
    result[first] = (xy[np.minimum(first + 1, last)] - xy[first]) / crowd.dt_s
    result[last] = (xy[last] - xy[np.maximum(last - 1, first)]) / crowd.dt_s
    return result
