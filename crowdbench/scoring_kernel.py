"""The one loop of scoring that is worth compiling: a billion absolute differences."""

import numpy as np
from numba import njit, prange


@njit(parallel=True, cache=True, fastmath=True, error_model="numpy")
def l1_distances(y, x):
    """L1 distances (r, g, K) of x (r, g, K, F) to y (r, F), and (r, g, K, K) within groups."""
    n, groups, each, size = x.shape
    to_y = np.zeros((n, groups, each))
    between = np.zeros((n, groups, each, each))
    for r in prange(n):
        for g in range(groups):
            for k in range(each):
                d = 0.0
                for f in range(size):
                    d += abs(x[r, g, k, f] - y[r, f])
                to_y[r, g, k] = d
                for other in range(k):
                    d = 0.0
                    for f in range(size):
                        d += abs(x[r, g, k, f] - x[r, g, other, f])
                    between[r, g, k, other] = d
                    between[r, g, other, k] = d
    return to_y, between
