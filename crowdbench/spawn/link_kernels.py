"""Drawing of companions, compiled."""

import numpy as np
from jaxtyping import Float, Int
from numba import njit


@njit(cache=True)
def joined(
    earlier: Int[np.ndarray, " n"],
    begin: Int[np.ndarray, " B"],
    weight: Float[np.ndarray, " n"],
    larger: Float[np.ndarray, " 4"],
    u: Float[np.ndarray, " E"],
) -> Int[np.ndarray, " E"]:
    """Whom each person joins, or −1.

    Person i may join `earlier[begin[i] : begin[i + 1]]`, with these weights times the factor in
    `larger` for groups of one, two, three, and four and more; `u` are uniform random numbers.
    """
    found = np.full(u.size, -1, np.int64)
    leader = np.arange(u.size)
    size = np.ones(u.size, np.int64)
    for i in range(u.size):
        total = 1.0
        for k in range(begin[i], begin[i + 1]):
            total += weight[k] * larger[min(size[leader[earlier[k]]], larger.size) - 1]
        aim = u[i] * total
        for k in range(begin[i], begin[i + 1]):
            aim -= weight[k] * larger[min(size[leader[earlier[k]]], larger.size) - 1]
            if aim < 0:
                found[i] = earlier[k]
                leader[i] = leader[earlier[k]]
                size[leader[i]] += 1
                break
    return found
