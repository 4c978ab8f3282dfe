"""Kernels of the metrics, compiled because crowds have millions of positions.

Those of encounters take positions trip by trip. `order` sorts them by tick, and by x within each
tick, so that only people with similar x are compared; `begins` holds the start of each tick in
`order`.
"""

import math

import numpy as np
from numba import njit

from crowdbench.compilation import compiled

CELL_M = 0.5


@compiled
def write_cdf(counts, empty, result, at):
    """Write the distribution function of each row of `counts` into `result`, from column `at` on.

    Rows without counts get `empty`. This is memory-bound, so each row is passed over only once.
    """
    for r in range(len(counts)):
        total = 0.0
        for v in range(counts.shape[1]):
            total += counts[r, v]
            result[r, at + v] = total
        for v in range(counts.shape[1]):
            result[r, at + v] = result[r, at + v] / max(total, 1.0) if total != 0.0 else empty[v]


@compiled
def write_kaplan_meier(events, censored, empty, result):
    """Write the Kaplan–Meier distribution function of each row into `result`.

    Rows in which nobody is at risk get `empty`; see `crowdbench.metrics.lattice.kaplan_meier_cdf`.
    """
    size = events.shape[1]
    at_risk = np.zeros(size + 1)
    for r in range(len(events)):
        for v in range(size - 1, -1, -1):
            at_risk[v] = at_risk[v + 1] + (events[r, v] + censored[r, v])
        survival = 1.0
        for v in range(size):
            if at_risk[v] > 0:
                survival *= 1 - events[r, v] / at_risk[v]
            result[r, v] = 1 - survival if at_risk[v + 1] > 0 else 1.0
        if at_risk[0] == 0:
            result[r] = empty


@compiled
def products(xy, person, block, blocks, lag, span_s, stands_m, largest, unit):
    """Per block: sums of products along and across the path, in `unit`, and their number.

    With D(t) = (x(t + k) − 2 x(t) + x(t − k)) / span² at lag k and the direction u of
    x(t + k + 1) − x(t − k), they are (D(t)·u)(D(t + 1)·u), and the same with u turned by 90°. The
    two D share no position if k ≥ 2. People whose way is shorter than `stands_m` have no direction:
    theirs are D(t)·D(t + 1) and 0. Products are clipped at ± `largest` m²/s⁴.
    """
    sums = np.zeros((blocks, 3), np.int64)
    square = 1.0 / (span_s * span_s)
    for t in range(lag, len(xy) - lag - 1):
        b = block[t]
        if b < 0 or person[t - lag] != person[t + lag + 1]:
            continue
        ax = (xy[t + lag, 0] - 2 * xy[t, 0] + xy[t - lag, 0]) * square
        ay = (xy[t + lag, 1] - 2 * xy[t, 1] + xy[t - lag, 1]) * square
        bx = (xy[t + lag + 1, 0] - 2 * xy[t + 1, 0] + xy[t - lag + 1, 0]) * square
        by = (xy[t + lag + 1, 1] - 2 * xy[t + 1, 1] + xy[t - lag + 1, 1]) * square
        ux, uy = xy[t + lag + 1, 0] - xy[t - lag, 0], xy[t + lag + 1, 1] - xy[t - lag, 1]
        length = math.sqrt(ux * ux + uy * uy)
        along, across = ax * bx + ay * by, 0.0
        if length >= stands_m:
            ux, uy = ux / length, uy / length
            along = (ax * ux + ay * uy) * (bx * ux + by * uy)
            across = (ay * ux - ax * uy) * (by * ux - bx * uy)
        sums[b, 0] += round(min(largest, max(-largest, along)) / unit)
        sums[b, 1] += round(min(largest, max(-largest, across)) / unit)
        sums[b, 2] += 1
    return sums


@compiled
def harmonics(xy, begin, steps, along, sines, start):
    """Per trip, the sums of its sideways offsets times the sines of each harmonic.

    Trip p has `steps[p] + 1` positions from index `begin[p]` on and the direction `along[p]`. Trips
    of as many steps share their `sines`, which begin at `start[p]`, one row per step.
    """
    sums = np.zeros((len(begin), sines.shape[1]))
    for p in range(len(begin)):
        x, y = xy[begin[p], 0], xy[begin[p], 1]
        for step in range(steps[p] + 1):
            t = begin[p] + step
            offset = along[p, 0] * (xy[t, 1] - y) - along[p, 1] * (xy[t, 0] - x)
            for m in range(sines.shape[1]):
                sums[p, m] += offset * sines[start[p] + step, m]
    return sums


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
    # In order, because jumping through memory is slow.
    x, y, whose = xy[order, 0], xy[order, 1], person[order]
    vx, vy = velocity[order, 0], velocity[order, 1]
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
                if whose[k] == whose[m]:
                    continue
                ux, uy = vx[k] - vx[m], vy[k] - vy[m]
                if ux * ux + uy * uy <= stranger_mps * stranger_mps:
                    continue
                j = order[m]
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
def clearances(xy, reach_m, segments, lower, columns, rows, start, near, solid):
    """Distance of each position to the nearest segment, at most `reach_m`, in metres.

    It is 0 where no segment is within `CELL_M` and the cell's centre is `solid`, that is, inside a
    wall: then so is the position, because there is no edge between them.
    """
    result = np.full(len(xy), reach_m)
    for k in range(len(xy)):
        column = math.floor((xy[k, 0] - lower[0]) / CELL_M)
        row = math.floor((xy[k, 1] - lower[1]) / CELL_M)
        if not (0 <= column < columns and 0 <= row < rows):
            continue
        c = row * columns + column
        for m in range(start[c], start[c + 1]):
            result[k] = min(result[k], _distance(xy[k, 0], xy[k, 1], segments[near[m]]))
        if solid[c] and result[k] > CELL_M:
            result[k] = 0.0
    return result


@njit(error_model="numpy")
def _distance(x, y, segment):
    ax, ay = segment[0], segment[1]
    dx, dy = segment[2] - ax, segment[3] - ay
    squared = dx * dx + dy * dy
    along = 0.0
    if squared > 0.0:
        along = min(1.0, max(0.0, ((x - ax) * dx + (y - ay) * dy) / squared))
    return math.hypot(x - ax - along * dx, y - ay - along * dy)
