"""Rows of a crowd in time blocks, and who is near whom: what several metrics look at."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.blocks import TimeBlocks
from crowdbench.trajectories import Trajectories

FAR_M = 1e4
"""Distance between frames in the search tree: nobody's neighbour is in another frame."""


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
def _tree(crowd: Trajectories):  # type: ignore[no-untyped-def]  # scipy's tree has no types
    """A search tree over space and time, its points, and the row of each point.

    The points stand frame by frame: neighbours then lie side by side in memory, which makes the
    search three times as fast.
    """
    from scipy.spatial import KDTree

    frame = crowd.row_frame()
    row = np.argsort(frame, kind="stable")
    points = np.empty((len(row), 3))
    points[:, :2] = crowd.xy[row]
    points[:, 2] = frame[row] * FAR_M
    return KDTree(points), points, row


@lru_cache(maxsize=1)
def nearest_neighbour_m(crowd: Trajectories) -> Float[np.ndarray, " R"]:
    """Distance of each row to the nearest other person in the same frame; infinite if alone."""
    nearest = np.full(len(crowd.xy), np.inf)
    if len(nearest) > 1:
        tree, points, row = _tree(crowd)
        gap, _ = tree.query(points, k=2, distance_upper_bound=FAR_M / 2)
        nearest[row] = gap[:, 1]
    return nearest


def pairs_within(crowd: Trajectories, radius_m: float) -> Int[np.ndarray, "n 2"]:
    """All pairs of rows of one frame that are no further apart than this.

    Within a pair the smaller row, which is the person with the smaller index, comes first.
    """
    tree, _, row = _tree(crowd)
    pairs: np.ndarray = row[tree.query_pairs(radius_m, output_type="ndarray")]
    pairs.sort(axis=1)
    return pairs


def velocities(crowd: Trajectories) -> Float[np.ndarray, "R 2"]:
    """Velocity at each row, m/s: central differences, one-sided at the ends of a life."""
    xy = crowd.xy.astype(np.float64)
    row = np.arange(len(xy))
    person = crowd.row_person()
    before = np.maximum(row - 1, crowd.offsets[:-1][person])
    after = np.minimum(row + 1, crowd.offsets[1:][person] - 1)
    span = np.maximum(after - before, 1)[:, None] * crowd.dt_s
    return (xy[after] - xy[before]) / span
