"""What a metric is: statistics of a crowd per time block, and a distance between their sums.

Each distance is the weighted L1 distance of two vectors that are computed from sums over blocks:
the distribution function for Wasserstein-1, the probabilities for total variation, a logarithm or
a share for the others. That has three consequences. Shipping the statistics loses nothing against
shipping the crowd. Blocks can be resampled without looking at a crowd again. And every distance is
of negative type (Székely & Rizzo 2013, Sec. 2), which makes the energy score of them proper.
"""

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Int

from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

Statistics = dict[str, Int[np.ndarray, "_B _V"]]
"""Counts or sums per block, by name. Those that `Metric.on_lattice` names are histograms: column v
counts the value v, and V may differ from crowd to crowd; `aligned` brings them to one support."""

Support = Int[np.ndarray, " V"]
"""Ascending lattice values that the columns of aligned histograms stand for; 0 is the first."""

Sums = dict[str, np.ndarray]
"""Aligned statistics summed over blocks, (…, V): leading axes are resamples or rollouts."""

Family = Literal["arrivals", "presence", "lives", "space", "motion", "interaction"]
FAMILIES: tuple[Family, ...] = (
    "arrivals",
    "presence",
    "lives",
    "space",
    "motion",
    "interaction",
)
WALK: tuple[Family, ...] = ("motion", "interaction")
"""Families that are compared under the recorded arrivals: they judge how people walk."""


@dataclass(frozen=True)
class Place:
    """What metrics need to know of a scene."""

    spawn_areas: int
    goal_areas: int
    bounds_m: tuple[float, float, float, float]
    """x from and to, y from and to."""
    radius_m: float = 0.3
    """Radius of a person's disc."""
    walls: tuple[tuple[tuple[float, float], ...], ...] = ()
    """Corners of each obstacle, metres."""


@dataclass(frozen=True)
class MetricResult:
    """A distance between two crowds, with what stands behind it."""

    distance: float
    """0 is equal. What it is divided by, the metric says."""
    recorded: float
    """Typical value of the recording, or of the crowd that stands for it, in `unit`; NaN where a
    metric has none."""
    simulated: float
    """That of the other crowd."""
    unit: str
    n: int
    """Size of the other crowd's sample."""

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


class Metric(ABC):
    """A metric: its statistics, the vectors that are compared, and their weights."""

    name: ClassVar[str]
    family: ClassVar[Family]
    unit: ClassVar[str]
    """Of the typical value."""

    def __repr__(self) -> str:
        return f"<metric {self.name}, {self.family}>"

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether blocks so long can tell anything."""
        return True

    def on_lattice(self, name: str) -> bool:
        """Whether the statistic of this name is a histogram over a lattice of values."""
        return name == "counts"

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The value, in lattice steps, at which an empty sample stands."""
        return 0

    @abstractmethod
    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """Statistics of `crowd` in each block."""

    @abstractmethod
    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The vectors whose L1 distance is taken."""

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """Weight of each component, from the recording's sums."""
        return np.ones(1)

    @abstractmethod
    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The value that a table shows, in `unit`."""

    @abstractmethod
    def size(self, sums: Sums) -> int:
        """Size of the sample."""

    def compare(
        self, recorded: Statistics, simulated: Statistics, blocks: TimeBlocks
    ) -> MetricResult:
        """Distance between two crowds' statistics in the same blocks."""
        (y, x), support = self.aligned([recorded, simulated], blocks)
        p, q = total(y), total(x)
        weight = self.weights(p, support, blocks)
        difference = np.abs(self.embed(p, support, blocks) - self.embed(q, support, blocks))
        with np.errstate(invalid="ignore"):  # 0 times an infinite weight is no difference
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
        """The statistics of several crowds on one support: the values that any of them has."""
        names = [name for name in crowds[0] if self.on_lattice(name)]
        used = {0, self.if_empty(blocks)}
        for crowd in crowds:
            for name in names:
                used.update(np.flatnonzero(crowd[name].any(axis=0)).tolist())
        support = np.array(sorted(used))
        return [
            {
                # In one order: a file sorts names otherwise than a crowd does.
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
    """`metric` between two crowds, looked at through `blocks`."""
    return metric.compare(
        metric.summarise(recorded, blocks, place),
        metric.summarise(simulated, blocks, place),
        blocks,
    )


def total(statistics: Statistics) -> Sums:
    """Sums over all blocks."""
    return {name: values.sum(axis=0) for name, values in statistics.items()}
