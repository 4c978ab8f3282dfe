"""Histograms on one lattice (values 0, 1, 2, … in a common unit) and what is computed from them.

Leading axes are batches: resamples, rollouts.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

Numbers = Float[np.ndarray, "*batch"] | np.float64
"""One number per batch; numpy makes a scalar of one without a batch."""


def histograms(
    values: Int[np.ndarray, " n"], block: Int[np.ndarray, " n"], blocks: int
) -> Int[np.ndarray, "B V"]:
    """Count the values per block; V is the largest value plus one (at least 1)."""
    size = int(values.max()) + 1 if len(values) else 1
    return np.bincount(block * size + values, minlength=blocks * size).reshape(blocks, size)


def rounded(values: Float[np.ndarray, " n"], step: float) -> Int[np.ndarray, " n"]:
    """The nearest point of a lattice with this step; a half goes up."""
    return np.floor(values / step + 0.5).astype(np.int64)


def cdf(
    counts: np.ndarray, support: Int[np.ndarray, " V"], *, if_empty: int
) -> Float[np.ndarray, "*batch V"]:
    """Distribution function at each value of the support.

    An empty sample is a point mass at `if_empty`, which the support holds.
    """
    result = np.atleast_1d(counts.cumsum(axis=-1, dtype=np.float64))
    n = result[..., -1:].copy()
    result /= np.maximum(n, 1)
    result[n[..., 0] == 0] = support >= if_empty
    return result


def kaplan_meier_cdf(
    events: np.ndarray, censored: np.ndarray, support: Int[np.ndarray, " V"], *, if_empty: int
) -> Float[np.ndarray, "*batch V"]:
    """Distribution function of a right-censored time by Kaplan & Meier (1958), eq. 2b.

    `events` counts the lives that ended at each value of the support, `censored` those last seen
    alive at it (which outlived it: events come before censorings at the same value). The mass that
    no event claims, when the longest life is a censored one, stands at that life's length (Efron's
    1967 convention). Nobody at all is a point mass at `if_empty`.
    """
    at_risk = np.cumsum((events + censored)[..., ::-1], axis=-1)[..., ::-1]
    hazard = np.divide(events, at_risk, out=np.zeros(events.shape), where=at_risk > 0)
    result = 1 - np.cumprod(1 - hazard, axis=-1)
    nobody_left = np.ones(events.shape, dtype=bool)
    nobody_left[..., :-1] = at_risk[..., 1:] == 0
    result[nobody_left] = 1.0
    return np.where(at_risk[..., :1] > 0, result, support >= if_empty)


def widths(support: Int[np.ndarray, " V"]) -> Int[np.ndarray, " V"]:
    """Lattice steps from each value to the next: a distribution function is constant in between.

    On a line the Wasserstein-1 distance is the area between two distribution functions (Vallender
    1974), Σ |P − Q| · width, which is exact on a lattice.
    """
    return np.diff(support, append=support[-1])


def mean_of_cdf(values: Float[np.ndarray, "*batch V"], support: Int[np.ndarray, " V"]) -> Numbers:
    """Mean of a distribution by its distribution function, in lattice steps."""
    return (1 - values) @ widths(support) + support[0]


def moments(counts: np.ndarray, support: Int[np.ndarray, " V"]) -> tuple[Numbers, Numbers]:
    """Mean and variance (over n, not n − 1) of histograms (…, V); 0 for an empty one."""
    n = np.maximum(counts.sum(axis=-1), 1)
    mean = counts @ support / n
    return mean, np.maximum(counts @ support**2 / n - mean**2, 0.0)


def correlation(sums: np.ndarray) -> Numbers:
    """Pearson's correlation from n, Σx, Σx′, Σxx′, Σx², Σx′² (last axis); 0 where undefined."""
    n, x, y, xy, xx, yy = np.moveaxis(sums.astype(np.float64), -1, 0)
    covariance = n * xy - x * y
    spread = np.sqrt(np.maximum(n * xx - x**2, 0) * np.maximum(n * yy - y**2, 0))
    return np.divide(covariance, spread, out=np.zeros_like(covariance), where=spread > 0)


def lagged_sums(
    x: Int[np.ndarray, " n"], y: Int[np.ndarray, " n"], block: Int[np.ndarray, " n"], blocks: int
) -> Int[np.ndarray, "B 6"]:
    """The sums that `correlation` takes, per block."""
    terms = np.stack([np.ones_like(x), x, y, x * y, x**2, y**2], axis=1)
    sums = np.zeros((blocks, 6), dtype=np.int64)
    np.add.at(sums, block, terms)
    return sums


def counted(hits: Bool[np.ndarray, " n"], block: np.ndarray, blocks: int) -> np.ndarray:
    """Per block how many are true, and of how many: (B, 2)."""
    return np.stack(
        [np.bincount(block[hits], minlength=blocks), np.bincount(block, minlength=blocks)], axis=1
    )


def share(sums: np.ndarray) -> Numbers:
    """Numerator over denominator (last axis); 0 of none."""
    return sums[..., 0] / np.maximum(sums[..., 1], 1)
