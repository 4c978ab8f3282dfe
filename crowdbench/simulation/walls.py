"""Look-up tables of the walls that rays and steps can hit.

Ray directions are fixed in the world frame. For each cell of a grid and each ray direction, the
table therefore lists the few segments that can be hit first. The table only narrows the search;
distances are exact.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from crowdbench.compilation import compiled, subroutine
from crowdbench.simulation.rules import distance_to_segment

CELL_M = 0.5
FAR_M = 8.0
"""Longest distance to walls that is kept, in metres."""
EDGE_ON = 1e-9  # sine of the angle below which a ray counts as parallel to a wall


class WallTable(NamedTuple):
    """Wall segments and lists of candidates, for `C` cells, `R` rays and `S` segments."""

    segments: np.ndarray
    """(S, 4) float64: x0, y0, x1, y1 in metres."""
    origin: np.ndarray
    """(2,) float64: lower left corner of the grid."""
    columns: int
    rows: int
    cos: np.ndarray
    """(R,) float64: cosine of each ray's direction."""
    sin: np.ndarray
    """(R,) float64: sine of each ray's direction."""
    lines: np.ndarray
    """(R, S, 4) float64: with l = lines[r, s], segment s in the frame of ray r (u along the ray,
    v across it) is u = l[0] + l[1]·v for l[2] ≤ v ≤ l[3]."""
    ray_start: np.ndarray
    """(C + 1,) int32: cell c has the rows `ray_start[c]:ray_start[c + 1]` of `meeting`."""
    meeting: np.ndarray
    """(M, 2) int32: pairs of a ray and a segment that it can hit first."""
    step_start: np.ndarray
    """(C + 1,) int32: cell c has the elements `step_start[c]:step_start[c + 1]` of
    `step_segment`."""
    step_segment: np.ndarray
    """int32: the segments that a step from each cell can hit."""
    clear: np.ndarray
    """(C,) float64: lower bound of the distance from the cell to all segments, in metres."""


@lru_cache(maxsize=4)
def wall_table(
    walls: bytes,
    *,
    lower: tuple[float, float],
    upper: tuple[float, float],
    rays: int,
    ray_range_m: float,
    step_m: float,
) -> WallTable:
    """Tables for positions between `lower` and `upper` and steps of at most `step_m` metres.

    `walls` are the bytes of the segments, (S, 4) float64. Recent tables are cached and shared
    between simulations, so they must not be changed.
    """
    segments = np.frombuffer(walls).reshape(-1, 4).copy()
    columns = max(1, math.ceil((upper[0] - lower[0]) / CELL_M))
    rows = max(1, math.ceil((upper[1] - lower[1]) / CELL_M))
    origin = np.array(lower, dtype=np.float64)
    angle = 2 * np.pi * np.arange(rays) / rays
    cos, sin = np.cos(angle), np.sin(angle)
    lines = np.empty((rays, len(segments), 4))
    for r in range(rays):
        u = segments[:, [0, 2]] * cos[r] + segments[:, [1, 3]] * sin[r]
        v = segments[:, [1, 3]] * cos[r] - segments[:, [0, 2]] * sin[r]
        across = v[:, 1] - v[:, 0]
        with np.errstate(divide="ignore", invalid="ignore"):
            slope = (u[:, 1] - u[:, 0]) / across
            offset = u[:, 0] - slope * v[:, 0]
        lines[r] = np.stack([offset, slope, v.min(axis=1), v.max(axis=1)], axis=1)
        # Segments parallel to the ray are excluded; the ray hits their neighbours instead. For
        # nearly parallel segments the slope would cause rounding errors of metres.
        edge_on = np.abs(across) <= EDGE_ON * np.hypot(across, u[:, 1] - u[:, 0])
        lines[r, edge_on] = [0.0, 0.0, np.inf, -np.inf]
    ray_start, meeting = np.zeros(columns * rows + 1, np.int32), np.empty((0, 2), np.int32)
    if rays:
        within = walls_near(segments, origin, columns, rows, ray_range_m + CELL_M)[:2]
        ray_start, meeting = _meetings(origin, columns, rows, cos, sin, lines, ray_range_m, *within)
    # A little further than a step, because a wall just beyond its end can also stop it.
    step_start, step_segment, _, clear = walls_near(
        segments, origin, columns, rows, step_m + CELL_M / 4
    )
    return WallTable(
        segments, origin, columns, rows, cos, sin, lines, ray_start, meeting, step_start,
        step_segment, clear,
    )  # fmt: skip


@subroutine
def cell_of(x, y, grid):
    """Index of a position's cell; `grid` is (x, y of the corner, cell size, columns, rows).

    A position outside the grid gets the nearest cell of its border.
    """
    column = min(grid[3] - 1, max(0, int((x - grid[0]) / grid[2])))
    row = min(grid[4] - 1, max(0, int((y - grid[1]) / grid[2])))
    return row * grid[3] + column


@compiled
def _meetings(origin, columns, rows, cosine, sine, lines, ray_range_m, near_start, near):
    """`ray_start` and `meeting`: which segments each ray can hit first from each cell.

    The segments within reach of cell c are `near[near_start[c]:near_start[c + 1]]`.
    """
    rays, size = lines.shape[0], lines.shape[1]
    nearest = np.empty(size)
    farthest = np.empty(size)
    start = np.zeros(columns * rows + 1, np.int32)
    for writing in (False, True):
        meeting = np.empty((start[-1] if writing else 0, 2), np.int32)
        count = 0
        for c in range(columns * rows):
            x0 = origin[0] + (c % columns) * CELL_M
            y0 = origin[1] + (c // columns) * CELL_M
            for r in range(rays):
                cos, sin = cosine[r], sine[r]
                # The cell's extent along (u) and across (v) the ray.
                u0 = x0 * cos + y0 * sin + CELL_M * (min(cos, 0.0) + min(sin, 0.0))
                u1 = x0 * cos + y0 * sin + CELL_M * (max(cos, 0.0) + max(sin, 0.0))
                v0 = y0 * cos - x0 * sin + CELL_M * (min(cos, 0.0) + min(-sin, 0.0))
                v1 = y0 * cos - x0 * sin + CELL_M * (max(cos, 0.0) + max(-sin, 0.0))
                blocked = np.inf  # segments beyond are hidden by one that spans the whole strip
                for k in range(near_start[c], near_start[c + 1]):
                    s = near[k]
                    lo, hi = max(v0, lines[r, s, 2]), min(v1, lines[r, s, 3])
                    nearest[s] = np.inf
                    if lo > hi:
                        continue
                    at_lo = lines[r, s, 0] + lines[r, s, 1] * lo
                    at_hi = lines[r, s, 0] + lines[r, s, 1] * hi
                    farthest[s] = max(at_lo, at_hi)
                    if farthest[s] < u0 - 1e-9:
                        continue
                    nearest[s] = min(at_lo, at_hi)
                    if lines[r, s, 2] <= v0 and lines[r, s, 3] >= v1 and nearest[s] >= u1:
                        blocked = min(blocked, farthest[s])
                for k in range(near_start[c], near_start[c + 1]):
                    s = near[k]
                    if nearest[s] <= blocked + 1e-9 and nearest[s] - u1 <= ray_range_m:
                        if writing:
                            meeting[count, 0] = r
                            meeting[count, 1] = s
                        count += 1
            start[c + 1] = count
    return start, meeting


def walls_near(
    segments: np.ndarray, origin: np.ndarray, columns: int, rows: int, reach_m: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Segments within `reach_m` of each cell, and lower bounds of the distances to segments.

    Returns `start` (C + 1,), `segment`, `free` (C,) and `clear` (C,). Cell c has the nearby
    segments `segment[start[c]:start[c + 1]]`, in ascending order. `free` is a lower bound of the
    distance from the cell to all other segments, and `clear` to all segments, in metres. Both are
    at most `FAR_M`, or four times `reach_m`: farther segments are not looked at.
    """
    far_m = max(FAR_M, 4 * reach_m) if len(segments) else np.inf
    return _walls_near(segments, origin, columns, rows, reach_m, far_m)


@compiled
def _walls_near(segments, origin, columns, rows, reach_m, far_m):
    size = columns * rows
    start = np.zeros(size + 1, np.int32)
    free, clear = np.full(size, far_m), np.full(size, far_m)
    half = CELL_M * math.sqrt(0.5)  # half a diagonal: from the centre to a corner
    wide = far_m + 2 * half
    for writing in (False, True):
        segment = np.empty(start[size] if writing else 0, np.int32)
        at = start[:size].copy()
        for s in range(len(segments)):
            ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            left = max(0, int((min(ax, bx) - wide - origin[0]) / CELL_M))
            right = min(columns, int((max(ax, bx) + wide - origin[0]) / CELL_M) + 1)
            low = max(0, int((min(ay, by) - wide - origin[1]) / CELL_M))
            top = min(rows, int((max(ay, by) + wide - origin[1]) / CELL_M) + 1)
            for row in range(low, top):
                for column in range(left, right):
                    c = row * columns + column
                    distance = distance_to_segment(
                        origin[0] + (column + 0.5) * CELL_M, origin[1] + (row + 0.5) * CELL_M,
                        ax, ay, bx, by,
                    )  # fmt: skip
                    clear[c] = min(clear[c], distance - half)
                    if distance > reach_m + half:
                        free[c] = min(free[c], distance - half)
                    elif writing:
                        segment[at[c]] = s
                        at[c] += 1
                    else:
                        start[c + 1] += 1
        if not writing:
            start = np.cumsum(start).astype(np.int32)
    return start, segment, free, clear
