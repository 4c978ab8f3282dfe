"""L1 distances, compiled because scoring computes about a billion absolute differences."""

import numpy as np
from numba import njit, prange

from crowdbench.compilation import compiled

LANES = 8
SERIAL = 10_000_000
"""Up to this number of differences, a few milliseconds, one thread is used: the others would spend
more time on waiting for work than on work."""


@njit(cache=False, error_model="numpy")
def _l1(a, b):
    """Sum of absolute differences, as eight partial sums in a fixed order.

    `fastmath` may choose a different order of summation when the machine code is loaded from the
    cache, so results would not be reproducible.
    """
    s0 = s1 = s2 = s3 = s4 = s5 = s6 = s7 = 0.0  # in registers: an array would be in memory
    whole = len(a) - len(a) % LANES
    for f in range(0, whole, LANES):
        s0 += abs(a[f] - b[f])
        s1 += abs(a[f + 1] - b[f + 1])
        s2 += abs(a[f + 2] - b[f + 2])
        s3 += abs(a[f + 3] - b[f + 3])
        s4 += abs(a[f + 4] - b[f + 4])
        s5 += abs(a[f + 5] - b[f + 5])
        s6 += abs(a[f + 6] - b[f + 6])
        s7 += abs(a[f + 7] - b[f + 7])
    left = len(a) - whole
    if left > 0:
        s0 += abs(a[whole] - b[whole])
    if left > 1:
        s1 += abs(a[whole + 1] - b[whole + 1])
    if left > 2:
        s2 += abs(a[whole + 2] - b[whole + 2])
    if left > 3:
        s3 += abs(a[whole + 3] - b[whole + 3])
    if left > 4:
        s4 += abs(a[whole + 4] - b[whole + 4])
    if left > 5:
        s5 += abs(a[whole + 5] - b[whole + 5])
    if left > 6:
        s6 += abs(a[whole + 6] - b[whole + 6])
    return s0 + s1 + s2 + s3 + s4 + s5 + s6 + s7


@njit(cache=False, error_model="numpy")
def _of_resample(y, x, to_y, between):
    """The distances of one resample: of x (g, K, F) to y (F), and within each group."""
    groups, each, _ = x.shape
    for g in range(groups):
        for k in range(each):
            to_y[g, k] = _l1(x[g, k], y)
            for other in range(k):
                d = _l1(x[g, k], x[g, other])
                between[g, k, other] = d
                between[g, other, k] = d


@compiled
def _serial(y, x, to_y, between):
    for r in range(len(y)):
        _of_resample(y[r], x[r], to_y[r], between[r])


@compiled(parallel=True)
def _parallel(y, x, to_y, between):
    for r in prange(len(y)):
        _of_resample(y[r], x[r], to_y[r], between[r])


def l1_distances(y: np.ndarray, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """L1 distances of x (r, g, K, F) to y (r, F), shape (r, g, K), and within each group.

    The distances within groups have the shape (r, g, K, K). The result does not depend on the
    number of threads.
    """
    n, groups, each, length = x.shape
    to_y = np.zeros((n, groups, each))
    between = np.zeros((n, groups, each, each))
    differences = n * groups * each * (each + 1) // 2 * length
    of = _parallel if differences > SERIAL else _serial
    of(y, x, to_y, between)
    return to_y, between
