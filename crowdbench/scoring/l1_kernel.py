"""L1 distances, compiled because scoring computes about a billion absolute differences."""

import numpy as np
from numba import njit, prange

from crowdbench.compilation import compiled

LANES = 8


@njit(cache=False, error_model="numpy")
def _l1(a, b):
    """Sum of absolute differences, as eight partial sums in a fixed order.

    `fastmath` may choose a different order of summation when the machine code is loaded from the
    cache, so results would not be reproducible.
    """
    sums = np.zeros(LANES)
    whole = len(a) - len(a) % LANES
    for f in range(0, whole, LANES):
        for lane in range(LANES):
            sums[lane] += abs(a[f + lane] - b[f + lane])
    for f in range(whole, len(a)):
        sums[f - whole] += abs(a[f] - b[f])
    total = 0.0
    for lane in range(LANES):
        total += sums[lane]
    return total


@compiled(parallel=True)
def l1_distances(y, x):
    """L1 distances of x (r, g, K, F) to y (r, F), shape (r, g, K), and within each group.

    The distances within groups have the shape (r, g, K, K).
    """
    n, groups, each, _ = x.shape
    to_y = np.zeros((n, groups, each))
    between = np.zeros((n, groups, each, each))
    for r in prange(n):
        for g in range(groups):
            for k in range(each):
                to_y[r, g, k] = _l1(x[r, g, k], y[r])
                for other in range(k):
                    d = _l1(x[r, g, k], x[r, g, other])
                    between[r, g, k, other] = d
                    between[r, g, other, k] = d
    return to_y, between
