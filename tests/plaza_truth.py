"""What follows from the true process of the plaza, in closed form."""

import numpy as np
from jaxtyping import Float
from scipy.stats import binom

from crowdbench.spawn.plaza import FOLLOWS, LATE, SIZES, PlazaArrivals


def rates_per_s(truth: PlazaArrivals) -> Float[np.ndarray, " K"]:
    """Mean number of persons who enter each area per second."""
    common, own = truth._common[0], truth._own[0]
    per_frame = np.einsum("c,z,cza->a", common, own, truth._enters)
    members = SIZES @ np.arange(1, len(SIZES) + 1) / (1 - LATE * FOLLOWS)
    return np.asarray(per_frame * members / truth._grid_s)


def correlations(
    truth: PlazaArrivals, delay_s: Float[np.ndarray, " L"]
) -> Float[np.ndarray, "L K K"]:
    """Pair correlation of groups, E[n_a(t) n_b(t + h)] / m_a m_b, for delays h > 0 in seconds.

    That of persons is the same at delays that are long compared with those of late members.
    """
    mean = np.einsum("c,z,cza->a", truth._common[0], truth._own[0], truth._enters)
    of_rush = np.einsum("z,cza->ca", truth._own[0], truth._enters)
    found = np.empty((len(delay_s), len(mean), len(mean)))
    same = np.eye(len(mean), dtype=bool)
    for k, h in enumerate(delay_s.tolist()):
        common, own = (_joint(*c, h / truth._grid_s) for c in (truth._common, truth._own))
        found[k] = np.einsum("cd,ca,db->ab", common, of_rush, of_rush)
        enters = (truth._enters, truth._enters)
        found[k][same] = np.einsum("cd,yz,cya,dza->a", common, own, *enters)
    return found / np.outer(mean, mean)


def group_sizes(most: int) -> Float[np.ndarray, " most"]:
    """P(a group has 1, 2, …, `most` members), late members included.

    The total progeny of a branching process with as many ancestors as enter together (Dwass 1969,
    Journal of Applied Probability 6): P(n members | k together) = k/n P(n persons are followed by
    n − k).
    """
    n, k = np.arange(1, most + 1)[:, None], np.arange(1, len(SIZES) + 1)
    return np.asarray((k / n * binom.pmf(n - k, LATE * n, FOLLOWS)) @ SIZES)


def _joint(
    stationary: Float[np.ndarray, " 2"], step: Float[np.ndarray, "2 2"], steps: float
) -> Float[np.ndarray, "2 2"]:
    """Probabilities of the states at two times this number of steps apart."""
    kept = (step[0, 0] + step[1, 1] - 1) ** steps  # the second eigenvalue; the first one is 1
    return np.asarray(stationary[:, None] * (kept * np.eye(2) + (1 - kept) * stationary[None, :]))
