"""Distances to walls, compiled because crowds have millions of positions."""

import math

import numpy as np
from numba import njit

from crowdbench.compilation import compiled

CELL_M = 0.5


@compiled
def near_segments(segments, lower, columns, rows, reach_m):
    """Segments (x0, y0, x1, y1) that may be within `reach_m` of a point in each cell of a grid.

    Cell c has the segments `near[start[c]:start[c + 1]]`.
    """
    start = np.zeros(columns * rows + 1, np.int64)
    near = np.empty(0, np.int64)
    limit = reach_m + CELL_M * math.sqrt(0.5)
    for writing in (False, True):
        count = 0
        for c in range(columns * rows):
            x = lower[0] + (c % columns + 0.5) * CELL_M
            y = lower[1] + (c // columns + 0.5) * CELL_M
            for s in range(len(segments)):
                if _distance(x, y, segments[s]) <= limit:
                    if writing:
                        near[count] = s
                    count += 1
            start[c + 1] = count
        if not writing:
            near = np.empty(count, np.int64)
    return start, near


@compiled
def clearances(xy, reach_m, segments, lower, columns, rows, start, near):
    """Distance of each position to the nearest segment, at most `reach_m`, in metres."""
    result = np.full(len(xy), reach_m)
    for k in range(len(xy)):
        column = math.floor((xy[k, 0] - lower[0]) / CELL_M)
        row = math.floor((xy[k, 1] - lower[1]) / CELL_M)
        if not (0 <= column < columns and 0 <= row < rows):
            continue
        c = row * columns + column
        for m in range(start[c], start[c + 1]):
            result[k] = min(result[k], _distance(xy[k, 0], xy[k, 1], segments[near[m]]))
    return result


@njit(error_model="numpy")
def _distance(x, y, segment):
    """Distance of the point (x, y) to a segment."""
    ax, ay = segment[0], segment[1]
    dx, dy = segment[2] - ax, segment[3] - ay
    squared = dx * dx + dy * dy
    along = 0.0
    if squared > 0.0:
        along = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / squared))
    return math.hypot(x - ax - along * dx, y - ay - along * dy)
