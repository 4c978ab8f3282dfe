"""The few forms that distances take; each metric is one of them with statistics of its own."""

from abc import abstractmethod

import numpy as np
from jaxtyping import Float

from crowdbench.metrics.lattice import Numbers, cdf, mean_of_cdf, share, widths
from crowdbench.metrics.metric import Metric, Sums, Support
from crowdbench.trajectories.blocks import TimeBlocks


class RelativeWasserstein(Metric):
    """Wasserstein-1 of two samples on a lattice, divided by the recording's mean.

    The statistics hold one histogram per block under `counts`.
    """

    @abstractmethod
    def step(self, blocks: TimeBlocks) -> float:
        """One lattice step, in `unit`."""

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The distribution function."""
        return cdf(sums["counts"], support, if_empty=self.if_empty(blocks))

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """Width of each step over the recording's mean; infinite where that mean is 0."""
        mean = mean_of_cdf(self.embed(recorded, support, blocks), support)
        if mean == 0:
            return np.full(1, np.inf)
        return widths(support) / mean

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The mean."""
        return float(mean_of_cdf(self.embed(sums, support, blocks), support)) * self.step(blocks)

    def size(self, sums: Sums) -> int:
        """Values in the sample."""
        return int(sums["counts"].sum())


class LogRatio(Metric):
    """|log((a + .05)/(b + .05))| of a positive number per crowd."""

    @abstractmethod
    def value(self, sums: Sums, support: Support) -> Numbers:
        """The number."""

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """log(value + .05)."""
        return np.log(np.asarray(self.value(sums, support)) + 0.05)[..., None]

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The number itself."""
        return float(self.value(sums, support))

    def size(self, sums: Sums) -> int:
        """Values that the number is computed from."""
        return int(sums["counts"].sum())


class ShareDifference(Metric):
    """|difference| of two shares; the statistics hold numerator and denominator under `share`."""

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The share."""
        return np.asarray(share(sums["share"]))[..., None]

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The share."""
        return float(share(sums["share"]))

    def size(self, sums: Sums) -> int:
        """The denominator."""
        return int(sums["share"][1])


class TotalVariation(Metric):
    """½ Σ |p − q| of two distributions over cells; an empty sample is a cell of its own."""

    unit = ""

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The probabilities, and last the cell of the empty sample."""
        counts = sums["counts"]
        n = counts.sum(axis=-1, keepdims=True)
        return np.concatenate([counts / np.maximum(n, 1), n == 0], axis=-1)

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """One half."""
        return np.full(1, 0.5)

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """None."""
        return float("nan")

    def size(self, sums: Sums) -> int:
        """Values in the sample."""
        return int(sums["counts"].sum())
