"""Products of successive accelerations, compiled because crowds have millions of positions."""

import math

import numpy as np

from crowdbench.compilation import compiled


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
