"""Who walks together, by one rule for recordings and rollouts.

Two people are companions if they are seen to enter at most 6 s apart, are within 2 m of each other
for at least 80 % of their common time (4 s or more), and have a mean relative speed of at most
0.5 m/s. Groups are the connected components of this relation. People who are there when observation
begins have no companions, because it is not known when they entered: strangers who stand near each
other then would all be one group.
"""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from jaxtyping import Int

from crowdbench.data.stops import HALF_S
from crowdbench.data.table import Trajectories

ENTRY_S = 6.0
WITHIN_M = 2.0
SHARE = 0.8
RELATIVE_MPS = 0.5
LEAST_S = 4.0


def with_companions(crowd: Trajectories) -> Trajectories:
    """The same crowd, with `group` set by the rule; groups are numbered by their first members."""
    return replace(crowd, group=groups_of(crowd))


@lru_cache(maxsize=1)  # several metrics use the groups of the same crowd
def groups_of(crowd: Trajectories) -> Int[np.ndarray, " P"]:
    """Group of each person, −1 for people without a companion."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    from crowdbench.data.neighbour_kernels import companions

    size, dt_s = len(crowd), crowd.dt_s
    order = np.flatnonzero(crowd.entered)
    order = order[np.argsort(crowd.first[order], kind="stable")]
    pairs = companions(
        crowd.xy.astype(np.float64),
        crowd.offsets[:-1][order],
        crowd.offsets[1:][order],
        crowd.first[order],
        max(1, round(HALF_S / dt_s)),
        ENTRY_S / dt_s + 1e-9,
        LEAST_S / dt_s - 1e-9,
        SHARE,
        WITHIN_M,
        RELATIVE_MPS * dt_s,
    )
    a, b = order[pairs].T
    links = coo_array((np.ones(len(a), dtype=bool), (a, b)), shape=(size, size))
    label = connected_components(links, directed=False)[1]
    alone = np.bincount(label, minlength=1)[label] == 1
    _, first = np.unique(label[~alone], return_index=True)
    number = np.full(size, -1, dtype=np.int32)
    number[label[~alone][np.sort(first)]] = np.arange(len(first))
    return number[label]
