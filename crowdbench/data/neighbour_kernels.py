"""Neighbours, companions and who stands, compiled because crowds may have millions of rows.

Positions are sorted by frame, and by x within each frame, so that only people with similar x are
compared. `begins` holds the start of each frame: `xy[begins[f]:begins[f + 1]]` are the positions
in frame f.
"""

import math

import numpy as np
from numba import njit

from crowdbench.compilation import compiled


@compiled
def from_left_to_right(frame, person, x):
    """Indices that sort positions by frame, then x, then index; and `begins` of each frame.

    The positions are given trip by trip. From one frame to the next few people change places, so
    each frame begins with the order of the one before, and insertion sort has little to do.
    """
    size = len(frame)
    frames = frame.max() + 1 if size > 0 else 0
    begins = np.zeros(frames + 1, np.int64)
    for i in range(size):
        begins[frame[i] + 1] += 1
    begins = np.cumsum(begins)
    order, sorted_x, newcomers = np.empty(size, np.int64), np.empty(size), begins[1:].copy()
    for i in range(size - 1, -1, -1):
        if i == 0 or person[i] != person[i - 1] or frame[i] != frame[i - 1] + 1:
            newcomers[frame[i]] -= 1  # they fill the end of their frame
            order[newcomers[frame[i]]] = i
    for f in range(frames):
        count = begins[f]
        for k in range(begins[f - 1] if f > 0 else 0, begins[f]):
            i = order[k] + 1
            if i < size and person[i] == person[i - 1] and frame[i] == f:
                order[count] = i
                count += 1
        for k in range(begins[f], begins[f + 1]):
            i, to = order[k], k
            while to > begins[f] and (
                sorted_x[to - 1] > x[i] or (sorted_x[to - 1] == x[i] and order[to - 1] > i)
            ):
                order[to], sorted_x[to] = order[to - 1], sorted_x[to - 1]
                to -= 1
            order[to], sorted_x[to] = i, x[i]
    return order, begins


@compiled
def stands(xy, offsets, half, slow_mps, dt_s):
    """Whether the person of each row stands; see `crowdbench.data.stops.standing`."""
    result = np.zeros(len(xy), np.bool_)
    for p in range(len(offsets) - 1):
        for row in range(offsets[p], offsets[p + 1]):
            before, after = max(row - half, offsets[p]), min(row + half, offsets[p + 1] - 1)
            dx = np.float64(xy[after, 0]) - np.float64(xy[before, 0])
            dy = np.float64(xy[after, 1]) - np.float64(xy[before, 1])
            limit = slow_mps * (after - before) * dt_s
            result[row] = dx * dx + dy * dy < limit * limit  # never true for a single row
    return result


@compiled
def nearest(xy, begins, far_m):
    """Distance of each position to the nearest other in its frame; infinite beyond `far_m`."""
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


@compiled
def companions(xy, begin, stop, first, half, late, least, share, within_m, relative_m):
    """Pairs (n, 2) of companions, as indices of persons; see `crowdbench.data.companions`.

    Person p has the rows `begin[p]` to `stop[p]`; persons are sorted by `first` frame. Times are in
    frames: velocities are measured over `half` frames before and after, people enter at most `late`
    frames apart and have `least` or more steps in common. `within_m` is the distance, `relative_m`
    the relative motion per frame.
    """
    found = np.empty((1024, 2), np.int64)
    count = 0
    for i in range(len(first)):
        last_i = first[i] + stop[i] - begin[i] - 1
        j = i
        while j + 1 < len(first) and first[j + 1] - first[i] <= late:
            j += 1
            last = min(last_i, first[j] + stop[j] - begin[j] - 1)
            common = last - first[j] + 1
            if common - 1 < least:
                continue
            far = common - math.ceil(share * common - 1e-9)  # frames in which they may be apart
            near, motion = 0, 0.0
            for t in range(first[j], last + 1):
                a, b = begin[i] + t - first[i], begin[j] + t - first[j]
                dx, dy = xy[a, 0] - xy[b, 0], xy[a, 1] - xy[b, 1]
                if dx * dx + dy * dy > within_m * within_m:
                    far -= 1
                    if far < 0:
                        break
                    continue
                near += 1
                ax, ay = _velocity(xy, a, begin[i], stop[i], half)
                bx, by = _velocity(xy, b, begin[j], stop[j], half)
                motion += math.hypot(ax - bx, ay - by)
            if far >= 0 and motion <= relative_m * near:
                if count == len(found):
                    found = np.concatenate((found, np.empty((count, 2), np.int64)))
                found[count, 0], found[count, 1] = i, j
                count += 1
    return found[:count]


@njit(error_model="numpy")
def _velocity(xy, row, first, stop, half):
    """Displacement per frame over `half` frames before and after, less at the ends of a trip."""
    before, after = max(row - half, first), min(row + half, stop - 1)
    frames = max(1, after - before)
    return (xy[after, 0] - xy[before, 0]) / frames, (xy[after, 1] - xy[before, 1]) / frames
