"""Distances between histograms on one lattice: integer values 0, 1, 2, … in a common unit."""

import numpy as np
from jaxtyping import Float, Int


def histograms(
    values: Int[np.ndarray, " n"], block: Int[np.ndarray, " n"], blocks: int
) -> Int[np.ndarray, "B V"]:
    """Count the values per block; V is the largest value plus one (at least 1)."""
    size = int(values.max()) + 1 if len(values) else 1
    return np.bincount(block * size + values, minlength=blocks * size).reshape(blocks, size)


def wasserstein1(p: Float[np.ndarray, " V"], q: Float[np.ndarray, " U"]) -> float:
    """Wasserstein-1 distance of two probability vectors, in lattice steps.

    On a line it is the area between the distribution functions: Σ_v |P(v) − Q(v)|
    (Vallender 1974), which is exact on a lattice.
    """
    size = max(len(p), len(q))
    difference = np.pad(p, (0, size - len(p))) - np.pad(q, (0, size - len(q)))
    return float(np.abs(np.cumsum(difference)).sum())


def relative_wasserstein1(p: Float[np.ndarray, " V"], q: Float[np.ndarray, " U"]) -> float:
    """Wasserstein-1 distance divided by the mean of `p`; infinite if that is 0 and q differs."""
    absolute = wasserstein1(p, q)
    if absolute == 0:
        return 0.0
    return absolute / mean(p) if mean(p) > 0 else float("inf")


def normalised(counts: Int[np.ndarray, " V"], *, if_empty: int) -> Float[np.ndarray, " U"]:
    """The counts as a distribution; an empty sample is a point mass at `if_empty`."""
    total = counts.sum()
    if total == 0:
        return np.eye(1, if_empty + 1, if_empty)[0]
    return counts / total


def mean(p: Float[np.ndarray, " V"]) -> float:
    """Mean of a distribution, in lattice steps."""
    return float(p @ np.arange(len(p)))


def kaplan_meier(
    events: Int[np.ndarray, " V"], censored: Int[np.ndarray, " V"]
) -> Float[np.ndarray, " V"]:
    """Distribution of a right-censored time by Kaplan & Meier (1958), eq. 2b.

    `events[v]` lives ended at v, `censored[v]` were last seen alive at v (and so outlived it:
    events come before censorings at the same v). The mass that no event claims, when the
    longest life is a censored one, stands at that life's length (Efron's 1967 convention).
    """
    at_risk = np.cumsum((events + censored)[::-1])[::-1]
    hazard = np.divide(events, at_risk, out=np.zeros(len(events)), where=at_risk > 0)
    survival = np.cumprod(1 - hazard)
    p = -np.diff(survival, prepend=1.0)
    p[np.flatnonzero(at_risk)[-1]] += survival[-1]
    return p
