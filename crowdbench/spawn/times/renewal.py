"""`renewal-gmm`: groups enter each area with independent gaps, the simplest non-Poisson model.

Gaps have a Weibull distribution that is discretised on the annotation grid: with S its survival
function in grid steps, a gap lasts g ≥ 1 steps with probability S(g − 1) − S(g). Group sizes are
geometric. Gaps and sizes are independent of the past.

The wait from the start of a stretch, or of a sample, to the first group is the forward recurrence
time of the stationary process: it lasts w ≥ 1 steps with probability S(w − 1) / μ, where
μ = Σ S(j) is the mean gap. The expected number of persons is therefore the same at every grid
point. Source: Cox (1962), Renewal Theory, secs. 2.3 and 5.2, in discrete time.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, Rule
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile, Fitted
from crowdbench.spawn.times.groups import (
    HasHazards,
    Hazards,
    Spells,
    check_grid,
    geometric_sizes,
    group_size,
    next_members,
    spells_of,
)

NAME = "renewal-gmm"
SHAPES = (0.3, 3.0)
"""Smallest and largest shape that can be fitted."""
SPREAD = 0.5
"""Standard deviation of the normal prior of the log shape, whose mean 0 is a Poisson process. The
values 0.25, 0.5, 1 and 10 give −3.439, −3.441, −3.452 and −3.518 nats per held-out person on ETH's
folds; on the plaza's folds, which had no waves then, 0.25 gives −3.454, and the others −3.452."""
_EXACT = 512  # terms of Σ S(j) that are summed one by one


class RenewalFit(Fit, frozen=True):
    """Weibull gaps, and P(one more member)."""

    next_member: Float[np.ndarray, " K"]
    scale_s: Float[np.ndarray, " K"]
    shape: Float[np.ndarray, " K"]

    def rules(self, scene: Scene) -> list[Rule]:
        """Shapes, scales and probabilities are possible."""
        return [
            ("shape", (self.shape > 0).all(), "shapes > 0"),
            ("scale_s", (self.scale_s > 0).all(), "scales > 0"),
            next_members(self.next_member),
        ]


@dataclass(frozen=True, eq=False)
class RenewalGMM(HasHazards, Fitted):
    """Weibull renewal arrivals of groups per area, with the scene's Gaussian areas."""

    shape: Float[np.ndarray, " K"]
    """Weibull shape of the gaps: 1 is Poisson, smaller is bursty, larger is regular."""
    scale_s: Float[np.ndarray, " K"]
    """Weibull scale of the gaps, seconds."""
    next_member: Float[np.ndarray, " K"]
    """P(a group has one more member) for each area."""
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    name: str = NAME
    file: ClassVar[FitFile[RenewalFit]] = FitFile(NAME, 2, RenewalFit)

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "RenewalGMM":
        """Fit the most likely shape per area, given the recorded number of persons.

        The scale is such that the expected number of persons equals the recorded one. A weak prior
        keeps areas with few groups close to a Poisson process.
        """
        more, groups = group_size(arrivals)
        spells = spells_of(arrivals)
        found = [_most_likely(spells.of_area(k), 1 / rate) for k, rate in enumerate(groups)]
        shape, scale = np.array(found).T
        return cls(areas, shape, scale * arrivals.grid_s, more, arrivals.grid_s)

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        tick, area = [], []
        for k in range(len(self.shape)):
            found = self._groups(k, points, rng)
            found = np.repeat(found, rng.geometric(1 - self.next_member[k], len(found)))
            tick.append(found)
            area.append(np.full(len(found), k))
        return self.areas.draw(np.concatenate(tick) * self.grid_s, np.concatenate(area), scene, rng)

    def _groups(self, k: int, points: int, rng: Generator) -> Int[np.ndarray, " n"]:
        shape, scale = self.shape[k], self.scale_s[k] / self.grid_s
        mean = np.exp(_log_tail(np.zeros(1), shape, scale))
        within = np.cumsum(np.exp(-((np.arange(points) / scale) ** shape))) / mean
        ticks = [np.searchsorted(within, rng.random(1), side="right")]
        while ticks[-1][-1] < points:
            size = 16 + int(1.1 * points / mean[0])
            gap = np.ceil(scale * rng.standard_exponential(size) ** (1 / shape))
            # The exact length of a gap beyond the horizon does not matter.
            gap = np.clip(gap, 1, points).astype(np.int64)
            ticks.append(ticks[-1][-1] + np.cumsum(gap))
        every = np.concatenate(ticks)
        return every[every < points]

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        check_grid(arrivals, self.grid_s, NAME)
        spells = spells_of(arrivals)
        gap, rest = _gap_hazards(spells, self.shape, self.scale_s / self.grid_s)
        return Hazards(gap=gap, size=geometric_sizes(spells, self.next_member), rest=rest)


def _most_likely(spells: Spells, mean: float) -> tuple[float, float]:
    """The most likely shape and scale of one area's gaps, given their mean; in grid steps."""
    from scipy.optimize import minimize_scalar

    def loss(log_shape: float) -> float:
        shape = float(np.exp(log_shape))
        scale = _scale(shape, mean)
        gap, rest = _gap_hazards(spells, np.array([shape]), np.array([scale]))
        any_size = np.broadcast_to([0.0, np.inf], gap.shape)
        likelihood = Hazards(gap, any_size, rest).log_probability()
        return 0.5 * (log_shape / SPREAD) ** 2 - likelihood

    bounds = tuple(np.log(SHAPES))
    found = minimize_scalar(loss, bounds=bounds, method="bounded", options={"xatol": 1e-6})
    shape = float(np.exp(found.x))
    return shape, _scale(shape, mean)


def _scale(shape: float, mean: float) -> float:
    """The Weibull scale, in grid steps, for which the mean gap is `mean` grid steps."""
    from scipy.optimize import brentq

    aim = np.log(max(mean, 1 + 1e-6))

    def excess(log_scale: float) -> float:
        return float(_log_tail(np.zeros(1), shape, float(np.exp(log_scale)))[0] - aim)

    return float(np.exp(brentq(excess, -60.0, 60.0, xtol=1e-14)))


def _gap_hazards(
    spells: Spells, shape: Float[np.ndarray, " K"], scale: Float[np.ndarray, " K"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, " S"]]:
    """Cumulative hazards of the gaps and of the rests; `scale` is in grid steps."""
    spell = spells.of_group
    at = spells.area[spell]
    steps = np.stack([spells.gap - 1, spells.gap], axis=1)
    gap = (steps / scale[at, None]) ** shape[at, None]
    rest = (spells.rest / scale[spells.area]) ** shape[spells.area]

    first = spells.opens == 1
    waiting = at[first, None]
    gap[first] = _wait_hazard(steps[first], shape[waiting], scale[waiting])
    empty = np.diff(spells.offsets) == 0
    nobody = spells.area[empty]
    rest[empty] = _wait_hazard(spells.rest[empty], shape[nobody], scale[nobody])
    return gap, rest


def _wait_hazard(steps: np.ndarray, shape: np.ndarray, scale: np.ndarray) -> np.ndarray:
    """−log P(the wait from a start to the first group is longer than `steps`)."""
    return _log_tail(np.zeros(1), shape, scale) - _log_tail(steps, shape, scale)


def _log_tail(
    steps: np.ndarray, shape: np.ndarray | float, scale: np.ndarray | float
) -> np.ndarray:
    """Log of Σ_{j ≥ steps} S(j), with S the Weibull survival function in grid steps.

    The first terms are summed directly. The remaining sum is computed by the Euler–Maclaurin
    formula: the integral of S, an incomplete gamma function, plus S/2 − S′/12.
    """
    from scipy.special import gammaincc, gammaln, logsumexp

    steps, shape, scale = np.broadcast_arrays(np.asarray(steps, np.float64), shape, scale)
    with np.errstate(divide="ignore"):
        hazard = ((steps[..., None] + np.arange(_EXACT)) / scale[..., None]) ** shape[..., None]
        end = steps + _EXACT
        x = (end / scale) ** shape
        a = 1 / shape
        # For large x the incomplete gamma function underflows; its asymptote is accurate there.
        far = (a - 1) * np.log(x) - x + np.log1p((a - 1) / np.maximum(x, 10))
        near = np.log(gammaincc(a, x)) + gammaln(a)
        integral = np.log(scale * a) + np.where(x < 500, near, far)
        edge = np.log(0.5 + shape * x / end / 12) - x
    terms = np.concatenate([-hazard, integral[..., None], edge[..., None]], axis=-1)
    return logsumexp(terms, axis=-1)
