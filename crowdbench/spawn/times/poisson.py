"""Constant rates: of people, `poisson-gmm`, or of groups, `poisson-groups`.

With `poisson-gmm`, people enter each area independently of each other. `poisson-paper` is the same
model as the founding paper's published code fits it. With `poisson-groups`, a group enters an area
with a constant probability at each grid point, independent of the past. Its size is geometric, as
in `renewal-gmm`. The gain over `poisson-gmm` is the effect of groups alone, and the gain of other
models over this one is the effect of modelling times. An area of `ntpp-gmm` without a trained
network uses this model.
"""

from dataclasses import dataclass
from typing import ClassVar

import msgspec
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, Rule
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile, Fitted
from crowdbench.spawn.times.groups import (
    HasHazards,
    Hazards,
    check_grid,
    geometric_sizes,
    group_size,
    next_members,
    spells_of,
)

NAME, PAPER, GROUPS = "poisson-gmm", "poisson-paper", "poisson-groups"


class PoissonFit(Fit, frozen=True):
    """The fit of either model."""

    rate: Float[np.ndarray, " K"] = msgspec.field(name="rate_per_s")

    def rules(self, scene: Scene) -> list[Rule]:
        """Rates are not negative."""
        return [("rate_per_s", (self.rate >= 0).all(), "rates ≥ 0")]


@dataclass(frozen=True, eq=False)
class PoissonGMM(Fitted):
    """Homogeneous Poisson arrivals per area, with the scene's Gaussian areas."""

    rate: Float[np.ndarray, " K"]
    """Expected persons per second for each area."""
    name: str = NAME
    file: ClassVar[FitFile[PoissonFit]] = FitFile(NAME, 2, PoissonFit)

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "PoissonGMM":
        """Maximum-likelihood fit: persons per observed second, counting each member of a group.

        Source: Daley & Vere-Jones (2003), An Introduction to the Theory of Point Processes I,
        eq. 2.1.4.
        """
        count = np.bincount(arrivals.area, minlength=arrivals.areas)
        return cls(areas, count / arrivals.exposure_s())

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds."""
        count = rng.poisson(self.rate * horizon_s)
        area = np.repeat(np.arange(len(self.rate)), count)
        return self.areas.draw(rng.random(len(area)) * horizon_s, area, scene, rng)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Log-probability in nats per person, with Poisson counts at each grid point."""
        from scipy.stats import poisson

        total = poisson.logpmf(arrivals.counts(), self.rate * arrivals.grid_s).sum()
        return float(total / max(1, len(arrivals.tick)))

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups: geometric gaps and zero-truncated Poisson sizes."""
        from scipy.stats import poisson

        spells = spells_of(arrivals)
        mean = self.rate * arrivals.grid_s
        at = spells.area[spells.of_group]
        sizes = np.stack([spells.size - 1, spells.size], axis=1)
        someone = np.log(-np.expm1(-mean[at]))[:, None]
        return Hazards(
            gap=mean[at, None] * np.stack([spells.gap - 1, spells.gap], axis=1),
            size=someone - poisson.logsf(sizes, mean[at, None]),
            rest=mean[spells.area] * spells.rest,
        )


@dataclass(frozen=True, eq=False)
class PoissonPaper(PoissonGMM):
    """`poisson-gmm` as fitted by the published code of the paper (`code/src/tpp/poisson.py`).

    The rate of an area is the number of frames in which anybody enters, divided by the time from
    the first to the last of them. So people who enter together are lost, and areas with few
    arrivals close together get rates that are much too high. The paper itself describes the
    maximum-likelihood rate, which is that of `poisson-gmm`.
    """

    name: str = PAPER
    file: ClassVar[FitFile[PoissonFit]] = FitFile(PAPER, 2, PoissonFit)

    @classmethod
    def fit_frames(cls, arrivals: Arrivals, areas: Areas, scene: Scene) -> "PoissonPaper":
        """Count occupied frames. Time between observed stretches is left out.

        An area with arrivals in a single frame, where the code divides by 0, gets one person per
        observed time.
        """
        counts = arrivals.counts()
        frame = (np.arange(len(counts)) * arrivals.grid_s / scene.dt_s + 1e-6).astype(np.int64)
        rate = np.zeros(arrivals.areas)
        for k in range(arrivals.areas):
            frames = np.unique(frame[counts[:, k] > 0])
            if len(frames) > 1:
                rate[k] = len(frames) / ((frames[-1] - frames[0]) * scene.dt_s)
            elif len(frames):
                rate[k] = 1 / arrivals.exposure_s()
        return cls(areas, rate)


class GroupsFit(Fit, frozen=True):
    """Rates of groups, and P(one more member)."""

    next_member: Float[np.ndarray, " K"]
    rate_per_s: Float[np.ndarray, " K"]

    def rules(self, scene: Scene) -> list[Rule]:
        """Rates and probabilities are possible."""
        possible = (self.rate_per_s >= 0) & (self.rate_per_s * scene.grid_s < 1)
        return [
            ("rate_per_s", possible.all(), "rates from 0 to below one group per grid step"),
            next_members(self.next_member),
        ]


@dataclass(frozen=True, eq=False)
class PoissonGroups(HasHazards, Fitted):
    """Groups at a constant rate per area, with the scene's Gaussian areas."""

    rate_per_s: Float[np.ndarray, " K"]
    """Expected groups per second for each area; at each grid point a group enters with probability
    rate × grid step."""
    next_member: Float[np.ndarray, " K"]
    """P(a group has one more member) for each area."""
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    name: str = GROUPS
    file: ClassVar[FitFile[GroupsFit]] = FitFile(GROUPS, 2, GroupsFit)

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "PoissonGroups":
        """Maximum-likelihood fit by `group_size`; the expected number of persons is as recorded."""
        more, groups = group_size(arrivals)
        return cls(areas, groups / arrivals.grid_s, more, arrivals.grid_s)

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        area, tick = np.nonzero(
            rng.random((len(self.rate_per_s), points)) < self._chance()[:, None]
        )
        size = rng.geometric(1 - self.next_member[area])
        area, tick = np.repeat(area, size), np.repeat(tick, size)
        return self.areas.draw(tick * self.grid_s, area, scene, rng)

    def _chance(self) -> Float[np.ndarray, " K"]:
        """P(a group enters at a grid point)."""
        return self.rate_per_s * self.grid_s

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups: gaps and sizes are geometric.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        check_grid(arrivals, self.grid_s, GROUPS)
        spells = spells_of(arrivals)
        step = -np.log1p(-self._chance())
        at = spells.area[spells.of_group]
        return Hazards(
            gap=step[at, None] * np.stack([spells.gap - 1, spells.gap], axis=1),
            size=geometric_sizes(spells, self.next_member),
            rest=step[spells.area] * spells.rest,
        )
