"""How far the nearest wall or bound is, on a grid of points of the scene.

The grid is computed once per scene. Between its points the distance is interpolated bilinearly. The
result is off by less than a cell, and along straight walls hardly at all.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np
import shapely

from crowdbench.compilation import compiled, subroutine
from crowdbench.scene import Bounds, Wall
from crowdbench.simulation.rules import distance_to_segment

CELL_M = 0.1
"""Edge length of a cell in metres."""
MOST_CELLS = 2**20
"""Larger scenes have larger cells, so that the grid has about this number at most."""
REACH_M = 2.0
"""Distances are clipped at this value."""


class FreeSpace(NamedTuple):
    """Distances to the nearest wall or bound at the corners of C columns and R rows of cells."""

    distance: np.ndarray
    """((R + 1)·(C + 1),) float32 distances in metres, row by row, from −`REACH_M` to `REACH_M`.
    They are negative in walls."""
    x_min: float
    """The grid covers the bounds of the scene exactly."""
    y_min: float
    per_x: float
    """Number of cells per metre along x."""
    per_y: float
    """Number of cells per metre along y."""
    columns: int
    rows: int


@lru_cache(maxsize=4)
def free_space(walls: tuple[Wall, ...], bounds: Bounds) -> FreeSpace:
    """The grid of a scene. Recent ones are cached, so they must not be changed."""
    wide, high = bounds.x_max_m - bounds.x_min_m, bounds.y_max_m - bounds.y_min_m
    cell_m = max(CELL_M, math.sqrt(wide * high / MOST_CELLS))
    columns, rows = math.ceil(wide / cell_m), math.ceil(high / cell_m)
    x = np.linspace(bounds.x_min_m, bounds.x_max_m, columns + 1)
    y = np.linspace(bounds.y_min_m, bounds.y_max_m, rows + 1)
    to_wall = np.full((rows + 1, columns + 1), REACH_M)
    inside = np.zeros(to_wall.shape, bool)
    for wall in walls:
        corners = np.array(wall.corners_m, np.float64)
        _approach(to_wall, x, y, np.hstack([corners, np.roll(corners, -1, axis=0)]))
        (left, low), (right, top) = corners.min(axis=0), corners.max(axis=0)
        at_x = slice(*np.searchsorted(x, (left, np.nextafter(right, np.inf))).tolist())
        at_y = slice(*np.searchsorted(y, (low, np.nextafter(top, np.inf))).tolist())
        solid = shapely.Polygon(corners)
        shapely.prepare(solid)
        inside[at_y, at_x] |= shapely.intersects_xy(solid, x[None, at_x], y[at_y, None])
    to_bound = np.minimum(
        np.minimum(x - bounds.x_min_m, bounds.x_max_m - x),
        np.minimum(y - bounds.y_min_m, bounds.y_max_m - y)[:, None],
    )
    # Negative in walls, so that the interpolated distance is 0 where a wall begins.
    distance = np.minimum(np.where(inside, -to_wall, to_wall), to_bound)
    return FreeSpace(
        distance=distance.astype(np.float32).ravel(),
        x_min=bounds.x_min_m,
        y_min=bounds.y_min_m,
        per_x=columns / wide,
        per_y=rows / high,
        columns=columns,
        rows=rows,
    )


@compiled
def _approach(distance, x, y, segments):
    """Lower `distance` (R + 1, C + 1) at the grid points near each segment (x0, y0, x1, y1)."""
    for s in range(len(segments)):
        ax, ay, bx, by = segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
        first = np.searchsorted(x, min(ax, bx) - REACH_M)
        stop = np.searchsorted(x, max(ax, bx) + REACH_M)
        for row in range(
            np.searchsorted(y, min(ay, by) - REACH_M), np.searchsorted(y, max(ay, by) + REACH_M)
        ):
            for column in range(first, stop):
                off = distance_to_segment(x[column], y[row], ax, ay, bx, by)
                distance[row, column] = min(distance[row, column], off)


@subroutine
def free_distance(x, y, distance, grid):
    """Interpolated distance of a point from walls and bounds in metres, 0 inside or outside them.

    `distance` is flat, and `grid` is (x_min, y_min, cells per metre along x, along y, columns,
    rows).
    """
    u, v = (x - grid[0]) * grid[2], (y - grid[1]) * grid[3]
    columns, rows = grid[4], grid[5]
    if not ((u > 0.0) & (u < columns) & (v > 0.0) & (v < rows)):
        return 0.0
    column, row = np.uint32(u), np.uint32(v)
    # Unsigned, because numba tests other indices for being negative.
    at = np.uintp(row) * np.uintp(columns + 1) + np.uintp(column)
    up = at + np.uintp(columns + 1)
    u, v = u - np.float64(column), v - np.float64(row)
    below = np.float64(distance[at])
    below += u * (np.float64(distance[at + np.uintp(1)]) - below)
    above = np.float64(distance[up])
    above += u * (np.float64(distance[up + np.uintp(1)]) - above)
    return max(0.0, below + v * (above - below))
