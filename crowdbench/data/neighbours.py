"""Neighbours of people in the same frame."""

from functools import lru_cache

import numpy as np
from jaxtyping import Float

from crowdbench.data.table import Trajectories

FAR_M = 5e3
"""Distance beyond which people do not count as neighbours."""


@lru_cache(maxsize=1)  # several metrics search for neighbours in the same crowd
def nearest_neighbour_m(crowd: Trajectories) -> Float[np.ndarray, " R"]:
    """Distance of each row to the nearest other person in the same frame; infinite if alone."""
    from crowdbench.data.neighbour_kernels import from_left_to_right, nearest

    row, begins = from_left_to_right(crowd.row_frame(), crowd.row_person(), crowd.xy[:, 0])
    xy = crowd.xy[row].astype(np.float64)
    result = np.empty(len(row))
    result[row] = nearest(xy, begins, FAR_M)
    return result
