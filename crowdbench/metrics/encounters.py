"""Encounters of two people at ticks, compiled because crowds have millions of them.

Positions are listed trip by trip. `order` sorts them by tick, and by x within each tick, so that
only people with similar x are compared; `begins` holds the start of each tick in `order`.
"""

import math

import numpy as np
from numba import njit

from crowdbench.compilation import compiled


@compiled
def encounters(xy, velocity, person, order, begins, shift, radius_m, stranger_mps):
    """Closest approaches of strangers, in metres, and the position index of each.

    An encounter is a run of consecutive ticks in which two people are within `radius_m`. With
    `shift`, the second person of each pair is delayed by that number of ticks. People are
    strangers if their velocities, one per position, differ by more than `stranger_mps`. The
    closest approach is that on the linear steps from the tick before to the tick after the
    encounter. The index is that of the first person's position nearest to it.
    """
    ticks, count = len(begins) - 1, 0
    closest, index = np.empty(1024), np.empty(1024, np.int64)
    x, y = xy[order, 0], xy[order, 1]  # in order, because jumping through memory is slow
    for f in range(max(0, shift), min(ticks, ticks + shift)):
        first, stop = begins[f - shift], begins[f - shift + 1]
        for k in range(begins[f], begins[f + 1]):
            i = order[k]
            while first < stop and x[first] < x[k] - radius_m:
                first += 1
            start = max(first, k + 1) if shift == 0 else first
            for m in range(start, stop):
                dx, dy = x[m] - x[k], y[m] - y[k]
                if dx > radius_m:
                    break
                if dx * dx + dy * dy > radius_m * radius_m:
                    continue
                j = order[m]
                if person[i] == person[j]:
                    continue
                vx, vy = velocity[i, 0] - velocity[j, 0], velocity[i, 1] - velocity[j, 1]
                if vx * vx + vy * vy <= stranger_mps * stranger_mps:
                    continue
                if _same(person, i, j, -1) and _within(xy, i - 1, j - 1, radius_m):
                    continue  # the encounter began earlier
                if count == len(index):
                    closest = np.concatenate((closest, np.empty(count)))
                    index = np.concatenate((index, np.empty(count, np.int64)))
                closest[count], index[count] = _follow(xy, person, i, j, radius_m)
                count += 1
    return closest[:count], index[:count]


@njit(error_model="numpy")
def _within(xy, i, j, radius_m):
    dx, dy = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
    return dx * dx + dy * dy <= radius_m * radius_m


@njit(error_model="numpy")
def _same(person, i, j, ahead):
    """Whether both people are present that many ticks later."""
    size = len(person)
    if not (0 <= i + ahead < size and 0 <= j + ahead < size):
        return False
    return person[i + ahead] == person[i] and person[j + ahead] == person[j]


@njit(error_model="numpy")
def _follow(xy, person, i, j, radius_m):
    """The closest approach of the encounter that begins here, and the index of the position."""
    least, at = np.inf, i
    if _same(person, i, j, -1):
        least = _approach(xy, i - 1, j - 1, i, j)
    going = True
    while going:
        here = math.hypot(xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1])
        if here < least:
            least, at = here, i
        going = _same(person, i, j, 1)
        if going:
            step = _approach(xy, i, j, i + 1, j + 1)
            if step < least:
                least, at = step, i
            i, j = i + 1, j + 1
            going = _within(xy, i, j, radius_m)
    return least, at


@njit(error_model="numpy")
def _approach(xy, i, j, to_i, to_j):
    """Smallest distance of two people on the linear steps between two ticks."""
    px, py = xy[i, 0] - xy[j, 0], xy[i, 1] - xy[j, 1]
    dx, dy = xy[to_i, 0] - xy[to_j, 0] - px, xy[to_i, 1] - xy[to_j, 1] - py
    squared = dx * dx + dy * dy
    along = 0.0
    if squared > 0.0:
        along = min(1.0, max(0.0, -(px * dx + py * dy) / squared))
    return math.hypot(px + along * dx, py + along * dy)
