"""The base class of metrics: statistics of a crowd per time block, and a distance between sums.

Each distance is the weighted L1 distance of two vectors that are computed from sums over blocks:
the distribution function for Wasserstein-1, the probabilities for total variation, a logarithm or
a share for the others. This has three consequences. The statistics contain everything that is
needed of a crowd, so a scene can be shipped without its recording. Blocks can be resampled without
access to the trajectories. And every distance is of negative type (Székely & Rizzo 2013, Sec. 2),
so the energy score based on it is proper.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar, Literal, get_args

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.scene import Walking

Statistics = dict[str, Int[np.ndarray, "_B _V"]]
"""Counts or sums per block, by name.

Those for which `Metric.on_lattice` is true are histograms: column v counts the value v. Their
number of columns V may differ between crowds; `Metric.aligned` brings them to a common support."""

Support = Int[np.ndarray, " V"]
"""Lattice values of the columns of aligned histograms, ascending from 0."""

Sums = dict[str, np.ndarray]
"""Aligned statistics summed over blocks, (…, V); leading axes are resamples or rollouts."""

Vectors = Float[np.ndarray, "*batch F"]
"""The vectors that are compared; leading axes are resamples or rollouts."""
Weights = Float[np.ndarray, " #F"]
"""The weight of each component, or one for all."""

Family = Literal["arrivals", "presence", "trips", "space", "motion", "interaction"]
FAMILIES: tuple[Family, ...] = get_args(Family)
WALK: tuple[Family, ...] = ("motion", "interaction")
"""Families that evaluate how people walk; they are scored under the recorded arrivals."""


@dataclass(frozen=True)
class Place:
    """The properties of a scene that metrics use."""

    spawn_areas: int
    goal_areas: int
    bounds_m: tuple[float, float, float, float]
    """x min, x max, y min, y max."""
    radius_m: float = 0.3
    """Radius of a person's disc."""
    walls: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Corners of each wall, metres."""
    walking: Walking = field(default_factory=Walking)
    """Time scales of the walking metrics."""


@dataclass(frozen=True)
class MetricResult:
    """A distance between two crowds, with their typical values and a sample size."""

    distance: float
    """The distance; 0 means equal. Each metric documents its normalisation."""
    recorded: float
    """Typical value of the recording or reference crowd, in `unit`; NaN if the metric has none."""
    simulated: float
    """Typical value of the simulated crowd."""
    unit: str
    n: int
    """Sample size of the simulated crowd."""

    def __repr__(self) -> str:
        if np.isnan(self.recorded):
            return f"MetricResult({self.distance:.3f}, n = {self.n})"
        recorded, simulated = (
            f"{value:.3g} {self.unit}".rstrip() for value in (self.recorded, self.simulated)
        )
        return (
            f"MetricResult({self.distance:.3f}: recorded {recorded}, simulated {simulated}, "
            f"n = {self.n})"
        )


def in_blocks(statistics: Statistics, inside: Bool[np.ndarray, " B"]) -> Statistics:
    """The statistics of some of the blocks."""
    return {name: values[inside] for name, values in statistics.items()}


class Metric(ABC):
    """A metric: its statistics, the vectors that are compared, and the weights of their components.

    Subclasses set `name`, `family` and, if the typical value has one, `unit`.
    """

    name: ClassVar[str]
    family: ClassVar[Family]
    unit: ClassVar[str] = ""
    """Unit of the typical value; empty for a pure number."""
    scored: ClassVar[bool] = True
    """False for metrics that are computed and shown, but never affect scores."""

    def __repr__(self) -> str:
        return f"<metric {self.name}, {self.family}>"

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether the metric applies to time blocks of this length."""
        return True

    def on_lattice(self, name: str) -> bool:
        """Whether the statistic of this name is a histogram over a lattice of values."""
        return name == "counts"

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The value, in lattice steps, that stands for an empty sample."""
        return 0

    @abstractmethod
    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """Statistics of `crowd` in each block."""

    @abstractmethod
    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The vectors whose weighted L1 distance is the metric's distance."""

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """Weight of each vector component, computed from the recording's sums."""
        return np.ones(1)

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The typical value that tables show, in `unit`; by default the mean of the vector."""
        return float(self.embed(sums, support, blocks).mean())

    def size(self, sums: Sums) -> int:
        """Size of the sample; that of the histogram `counts` unless a metric says otherwise."""
        return int(sums["counts"].sum())

    def compare(
        self, recorded: Statistics, simulated: Statistics, blocks: TimeBlocks
    ) -> MetricResult:
        """Distance between the statistics of two crowds in the same blocks."""
        (y, x), support = self.aligned([recorded, simulated], blocks)
        p, q = total(y), total(x)
        weight = self.weights(p, support, blocks)
        difference = np.abs(self.embed(p, support, blocks) - self.embed(q, support, blocks))
        with np.errstate(invalid="ignore"):  # 0 times an infinite weight counts as 0
            parts = np.where(difference > 0, difference * weight, 0.0)
        return MetricResult(
            distance=float(parts.sum()),
            recorded=self.typical(p, support, blocks),
            simulated=self.typical(q, support, blocks),
            unit=self.unit,
            n=self.size(q),
        )

    def aligned(
        self, crowds: Sequence[Statistics], blocks: TimeBlocks
    ) -> tuple[list[Statistics], Support]:
        """The statistics of several crowds on a common support, and that support.

        The support holds 0, `if_empty` and every value that occurs in any of the crowds.
        """
        names = [name for name in crowds[0] if self.on_lattice(name)]
        used = {0, self.if_empty(blocks)}
        for crowd in crowds:
            for name in names:
                used.update(np.flatnonzero(crowd[name].any(axis=0)).tolist())
        support = np.array(sorted(used))
        return [
            {
                # All in the order of the first crowd: statistics from a file may be sorted
                # differently.
                name: _at(crowd[name], support) if name in names else crowd[name]
                for name in crowds[0]
            }
            for crowd in crowds
        ], support


def _at(counts: Int[np.ndarray, "B _"], support: Support) -> Int[np.ndarray, "B V"]:
    there = support < counts.shape[1]
    result = np.zeros((len(counts), len(support)), dtype=counts.dtype)
    result[:, there] = counts[:, support[there]]
    return result


def distance(
    metric: Metric,
    recorded: Trajectories,
    simulated: Trajectories,
    blocks: TimeBlocks,
    place: Place,
) -> MetricResult:
    """Distance between two crowds by `metric`, computed in the same time blocks."""
    return metric.compare(
        metric.summarise(recorded, blocks, place),
        metric.summarise(simulated, blocks, place),
        blocks,
    )


def total(statistics: Statistics) -> Sums:
    """Sum of each statistic over all blocks."""
    return {name: values.sum(axis=0) for name, values in statistics.items()}
