"""Vectors that half-planes allow."""

import numpy as np

from crowdbench.compilation import subroutine

SLACK_M = 1e-12
"""Rounding error of half-planes, in metres."""


@subroutine
def project(dx, dy, plane, count):
    """The vector nearest to d with n·v ≤ c for each of the first `count` rows (n, c), all c ≥ 0.

    It is d itself, its projection onto one line, or a corner of two.
    """
    worst = -1
    for k in range(count):
        if dx * plane[k, 0] + dy * plane[k, 1] > plane[k, 2]:
            worst = k
            break
    if worst < 0:
        return dx, dy
    for k in range(worst, count):
        over = dx * plane[k, 0] + dy * plane[k, 1] - plane[k, 2]
        if over > 0.0:
            x, y = dx - over * plane[k, 0], dy - over * plane[k, 1]
            if _allowed(x, y, plane, count, k, k):
                return x, y
    nearest, best_x, best_y = np.inf, 0.0, 0.0
    for k in range(count):
        for m in range(k + 1, count):
            cross = plane[k, 0] * plane[m, 1] - plane[k, 1] * plane[m, 0]
            if abs(cross) < 1e-9:
                continue
            x = (plane[k, 2] * plane[m, 1] - plane[m, 2] * plane[k, 1]) / cross
            y = (plane[m, 2] * plane[k, 0] - plane[k, 2] * plane[m, 0]) / cross
            off = (x - dx) * (x - dx) + (y - dy) * (y - dy)
            if off < nearest and _allowed(x, y, plane, count, k, m):
                nearest, best_x, best_y = off, x, y
    return best_x, best_y


@subroutine
def _allowed(x, y, plane, count, k, m):
    """Whether all half-planes but k and m, on whose lines the vector lies, allow it."""
    for n in range(count):
        if n not in (k, m) and x * plane[n, 0] + y * plane[n, 1] > plane[n, 2] + SLACK_M:
            return False
    return True
