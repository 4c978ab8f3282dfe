"""Base classes for the common forms of distances; each metric adds its own statistics."""

from abc import abstractmethod
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.metrics.lattice import Numbers, cdf, histograms, mean_of_cdf, rounded, share, widths
from crowdbench.metrics.metric import Metric, Statistics, Sums, Support, Vectors, Weights


class RelativeWasserstein(Metric):
    """Wasserstein-1 of two samples on a lattice, divided by the recording's mean.

    The statistics hold one histogram per block under `counts`.
    """

    lattice_step: ClassVar[float] = 1.0
    """Size of one lattice step, in `unit`."""
    empty: ClassVar[float] = 0.0
    """The value that stands for an empty sample, in `unit`."""

    def step(self, blocks: TimeBlocks) -> float:
        """Size of one lattice step, in `unit`, where it depends on the blocks."""
        return self.lattice_step

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The value, in lattice steps, that stands for an empty sample."""
        return round(self.empty / self.step(blocks))

    def histogram(
        self, values: Float[np.ndarray, " n"], block: Int[np.ndarray, " n"], blocks: TimeBlocks
    ) -> Statistics:
        """`counts[b, v]`: number of values in block b, by the nearest lattice step v."""
        return {"counts": histograms(rounded(values, self.lattice_step), block, len(blocks))}

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The distribution function at each value of the support."""
        return cdf(sums["counts"], support, if_empty=self.if_empty(blocks))

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """Width of each lattice interval over the recording's mean; infinite if that mean is 0."""
        mean = mean_of_cdf(self.embed(recorded, support, blocks), support)
        if mean == 0:
            return np.full(1, np.inf)
        return widths(support) / mean

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """Mean of the sample, in `unit`."""
        return float(mean_of_cdf(self.embed(sums, support, blocks), support)) * self.step(blocks)


class LogRatio(Metric):
    """|log((a + .05)/(b + .05))| of one number a, b ≥ 0 per crowd."""

    @abstractmethod
    def value(self, sums: Sums, support: Support) -> Numbers:
        """The number that is compared, in `unit`."""

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """log(value + .05)."""
        return np.log(np.asarray(self.value(sums, support)) + 0.05)[..., None]

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The number that is compared, in `unit`."""
        return float(self.value(sums, support))


class ShareDifference(Metric):
    """Absolute difference of two shares.

    The statistics hold numerator and denominator per block under `share`.
    """

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The share, a number from 0 to 1."""
        return np.asarray(share(sums["share"]))[..., None]

    def size(self, sums: Sums) -> int:
        """Denominator of the share."""
        return int(sums["share"][1])


class TotalVariation(Metric):
    """½ Σ |p − q| of two distributions over cells; an empty sample has an extra cell."""

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """Probability of each cell, then 1 for an empty sample and 0 otherwise."""
        counts = sums["counts"]
        n = counts.sum(axis=-1, keepdims=True)
        result = np.empty((*counts.shape[:-1], counts.shape[-1] + 1))
        np.divide(counts, np.maximum(n, 1), out=result[..., :-1])
        result[..., -1:] = n == 0
        return result

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """The factor ½ of the total variation."""
        return np.full(1, 0.5)

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """NaN: a distribution over cells has no typical value."""
        return float("nan")
