"""Who is near whom in a frame: compiled, since a crowd of a million rows asks it for each of them.

People stand frame by frame, in each from left to right, so that only those are compared who can be
near enough. `begins` says where each frame begins: its people are `xy[begins[f]:begins[f + 1]]`.
"""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy")
def sort_from_left(xy, row, begins):
    """Sort the positions of each frame by x, and `row` with them."""
    for f in range(len(begins) - 1):
        frame = slice(begins[f], begins[f + 1])
        order = np.argsort(xy[frame, 0])
        xy[frame], row[frame] = xy[frame][order], row[frame][order]


@njit(cache=True, error_model="numpy")
def nearest(xy, begins, far_m):
    """Distance of each to the nearest other of its frame, infinite from `far_m` on."""
    result = np.full(len(xy), np.inf)
    for f in range(len(begins) - 1):
        for i in range(begins[f], begins[f + 1]):
            least = far_m * far_m
            for step in (-1, 1):
                j = i + step
                while begins[f] <= j < begins[f + 1]:
                    dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                    if dx * dx >= least:
                        break
                    least = min(least, dx * dx + dy * dy)
                    j += step
            if least < far_m * far_m:
                result[i] = np.sqrt(least)
    return result


@njit(cache=True, error_model="numpy")
def pairs(xy, begins, radius_m):
    """All pairs (n, 2) of one frame that are no further apart than this, frame by frame."""
    found = np.empty((0, 2), np.int64)
    for writing in (False, True):
        count = 0
        for f in range(len(begins) - 1):
            for i in range(begins[f], begins[f + 1]):
                for j in range(i + 1, begins[f + 1]):
                    dx, dy = xy[j, 0] - xy[i, 0], xy[j, 1] - xy[i, 1]
                    if dx * dx > radius_m * radius_m:
                        break
                    if dx * dx + dy * dy <= radius_m * radius_m:
                        if writing:
                            found[count, 0], found[count, 1] = i, j
                        count += 1
        if not writing:
            found = np.empty((count, 2), np.int64)
    return found
