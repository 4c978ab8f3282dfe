"""Histograms on a lattice (values 0, 1, 2, … in a common unit) and statistics computed from them.

Leading axes are batch axes, such as resamples or rollouts.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

Numbers = Float[np.ndarray, "*batch"] | np.float64
"""One number per batch element; without batch axes numpy returns a scalar."""


def histograms(
    values: Int[np.ndarray, " n"], block: Int[np.ndarray, " n"], blocks: int, size: int = 0
) -> Int[np.ndarray, "B V"]:
    """Histogram of the values in each block; V is `size`, or the largest value plus one if more."""
    size = max(size, 1, int(values.max(initial=0)) + 1)
    return np.bincount(block * size + values, minlength=blocks * size).reshape(blocks, size)


def rounded(values: Float[np.ndarray, " n"], step: float) -> Int[np.ndarray, " n"]:
    """Index of the lattice point nearest to each value; halves are rounded up."""
    return np.floor(values / step + 0.5).astype(np.int64)


def cdf(
    counts: np.ndarray, support: Int[np.ndarray, " V"], *, if_empty: int
) -> Float[np.ndarray, "*batch V"]:
    """Distribution function of a histogram at each value of the support.

    An empty sample is treated as a point mass at `if_empty`, which the support contains.
    """
    return cdfs([counts], support, if_empty=if_empty)


def cdfs(
    counts: Sequence[np.ndarray], support: Int[np.ndarray, " V"], *, if_empty: int
) -> Float[np.ndarray, "*batch FV"]:
    """Distribution functions of `F` histograms on the same support, concatenated; see `cdf`."""
    from crowdbench.metrics.kernels import write_cdf

    size, empty = len(support), (support >= if_empty).astype(np.float64)
    result = np.empty((*counts[0].shape[:-1], len(counts) * size))
    for k, c in enumerate(counts):
        rows = np.ascontiguousarray(c, dtype=np.float64).reshape(-1, size)
        write_cdf(rows, empty, result.reshape(len(rows), -1), k * size)
    return result


def kaplan_meier_cdf(
    events: np.ndarray, censored: np.ndarray, support: Int[np.ndarray, " V"], *, if_empty: int
) -> Float[np.ndarray, "*batch V"]:
    """Distribution function of a right-censored time by Kaplan & Meier (1958), eq. 2b.

    `events` counts the trips that ended at each value of the support, `censored` those that were
    censored at it. At the same value, events come before censorings. If the longest trip is
    censored, the remaining probability is placed at its length (Efron's 1967 convention). An empty
    sample is treated as a point mass at `if_empty`.
    """
    from crowdbench.metrics.kernels import write_kaplan_meier

    result, size = np.empty(events.shape), len(support)
    write_kaplan_meier(
        np.ascontiguousarray(events, dtype=np.float64).reshape(-1, size),
        np.ascontiguousarray(censored, dtype=np.float64).reshape(-1, size),
        (support >= if_empty).astype(np.float64),
        result.reshape(-1, size),
    )
    return result


def widths(support: Int[np.ndarray, " V"]) -> Int[np.ndarray, " V"]:
    """Lattice steps from each value of the support to the next; 0 for the last.

    In one dimension the Wasserstein-1 distance is the area between two distribution functions
    (Vallender 1974). They are constant between the values, so Σ |P − Q| · width is exact.
    """
    return np.diff(support, append=support[-1])


def mean_of_cdf(values: Float[np.ndarray, "*batch V"], support: Int[np.ndarray, " V"]) -> Numbers:
    """Mean of a distribution, in lattice steps, from its distribution function."""
    return (1 - values) @ widths(support) + support[0]


def moments(counts: np.ndarray, support: Int[np.ndarray, " V"]) -> tuple[Numbers, Numbers]:
    """Mean and variance (divided by n, not n − 1) of histograms (…, V); 0 for an empty one."""
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
    """Per block, the sums that `correlation` takes as input."""
    sums = np.zeros((6, blocks), dtype=np.int64)
    for of_term, term in zip(sums, (np.ones_like(x), x, y, x * y, x**2, y**2), strict=True):
        np.add.at(of_term, block, term)  # with one axis it is much faster than with two
    return np.ascontiguousarray(sums.T)


def counted(hits: Bool[np.ndarray, " n"], block: np.ndarray, blocks: int) -> np.ndarray:
    """Number of true values and number of values per block, (B, 2)."""
    return np.stack(
        [np.bincount(block[hits], minlength=blocks), np.bincount(block, minlength=blocks)], axis=1
    )


def share(sums: np.ndarray) -> Numbers:
    """Numerator over denominator (last axis); 0 if the denominator is 0."""
    return sums[..., 0] / np.maximum(sums[..., 1], 1)
