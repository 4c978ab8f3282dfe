"""What a metric is: per-block statistics of a crowd, and a distance between two of them."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Int

from crowdbench.blocks import TimeBlocks
from crowdbench.trajectories import Trajectories

Histograms = dict[str, Int[np.ndarray, "_B _V"]]
"""Counts on a lattice per block, by name; V may differ from crowd to crowd. Sums over blocks are
all that a distance looks at, so shipping them loses nothing against shipping the crowd."""


@dataclass(frozen=True)
class MetricResult:
    """A distance between two crowds, with what stands behind it."""

    distance: float
    """Wasserstein-1 distance divided by the recording's mean: 0 is equal, no unit."""
    recorded: float
    """Mean of the recording, in `unit`."""
    simulated: float
    """Mean of the other crowd, in `unit`."""
    unit: str
    n: int
    """Size of the other crowd's sample."""


@runtime_checkable  # tests check annotations at run time
class Metric(Protocol):
    """A metric: `compare(summarise(a, blocks), summarise(b, blocks), blocks)`."""

    name: str

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks) -> Histograms:
        """Statistics of `crowd` in each block."""
        ...

    def compare(
        self, recorded: Histograms, simulated: Histograms, blocks: TimeBlocks
    ) -> MetricResult:
        """Distance between two crowds' statistics in the same blocks."""
        ...


def distance(
    metric: Metric, recorded: Trajectories, simulated: Trajectories, blocks: TimeBlocks
) -> MetricResult:
    """`metric` between two crowds, looked at through `blocks`."""
    return metric.compare(
        metric.summarise(recorded, blocks), metric.summarise(simulated, blocks), blocks
    )
