"""`cox-gmm`: groups whose rates rise and fall in slow, common waves, and whom others follow.

A log-Gaussian Cox process with self-excitation. In area a and grid step t, groups enter at the rate

    λ_a(t) = (1 − ρ_a) [μ_a (1 − Σ φ) w_a(t) + Σ_h φ(h) n_a(t − h)]

where n are the persons who entered before, w the factors of `waves`, which areas share, φ(h) the
number of persons who follow each person h steps later, for at most 6 s, and ρ_a is P(a group has
one more member). Group sizes are geometric, so that μ_a is the mean rate of persons. The factors
are constant for 0.8 s, or a step of the annotation grid if that is longer.

Everything is fitted by moments, in less than a second: the waves to the correlations at delays of
more than 6 s, φ to those of less by the Yule–Walker equations of an integer-valued autoregression
(Du and Li 1991, Journal of Time Series Analysis 12), and ρ_a to the variance that is left.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, Rule
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile, Fitted
from crowdbench.spawn.plans.links import EDGES_S
from crowdbench.spawn.times.groups import check_grid, next_members
from crowdbench.spawn.times.waves import STEP_S, Waves, fit_waves, in_steps, mean_correlations

NAME = "cox-gmm"
PARTICLES = 300
"""Number of particles of the filter that computes the likelihood."""
FOLLOWING_S = EDGES_S[1:]
"""Limits of the bins of delays in which φ is constant, seconds."""
_MOST_MEMBERS = 0.95
_MOST_FOLLOWERS = 0.8
_WARM_UP = 4  # samples begin this number of times the longest delay before time 0


class CoxFit(Fit, frozen=True):
    """Rates, group sizes, followers, and the `J` scales of the waves."""

    rate_per_s: Float[np.ndarray, " K"]
    next_member: Float[np.ndarray, " K"]
    followers: Float[np.ndarray, " 5"]
    tau_s: Float[np.ndarray, " J"]
    covariance: Float[np.ndarray, "J K K"]

    def rules(self, scene: Scene) -> list[Rule]:
        """Rates, probabilities, followers and waves are possible."""
        symmetric = np.allclose(self.covariance, self.covariance.transpose(0, 2, 1))
        least = np.linalg.eigvalsh(self.covariance).min(initial=0)
        followers = (self.followers >= 0).all() and self.followers.sum() < 1
        matrices = "symmetric, positive semidefinite matrices"
        return [
            ("rate_per_s", (self.rate_per_s >= 0).all(), "rates ≥ 0"),
            next_members(self.next_member),
            ("followers", followers, "numbers ≥ 0 with a sum below 1"),
            ("tau_s", (self.tau_s > 0).all(), "times > 0"),
            ("covariance", symmetric and least > -1e-6, matrices),
        ]


@dataclass(frozen=True, eq=False)
class CoxGMM(Fitted):
    """Groups at rates with slow waves, with the scene's Gaussian areas."""

    rate_per_s: Float[np.ndarray, " K"]
    """Mean number of persons per second for each area."""
    next_member: Float[np.ndarray, " K"]
    """P(a group has one more member) for each area."""
    followers: Float[np.ndarray, " F"]
    """Number of persons who follow each person, for each bin of delays in `FOLLOWING_S`."""
    waves: Waves
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    name: str = NAME
    file: ClassVar[FitFile[CoxFit]] = FitFile(NAME, 1, CoxFit)

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "CoxGMM":
        """Fit waves, followers and group sizes to the correlations of the numbers of arrivals."""
        waves = fit_waves(arrivals)
        counts = arrivals.counts()
        mean = counts.mean(axis=0)
        excess = _excess(arrivals, waves, len(lags(arrivals.grid_s)))
        followers = _followers(excess.sum(axis=1) / max(mean.sum(), 1e-12), arrivals.grid_s)
        due = spread(followers, arrivals.grid_s) @ excess[1:]
        return cls(
            areas,
            mean / arrivals.grid_s,
            _members(excess[0] - due, mean, len(counts) * mean),
            followers,
            waves,
            arrivals.grid_s,
        )

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        from crowdbench.spawn.times.cox_kernels import drawn

        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        following = spread(self.followers, self.grid_s)
        before = _WARM_UP * len(following)
        width = self._width()
        steps = -(-(before + points) // width)
        factors = self.waves.factors(steps, width * self.grid_s, rng)
        rate = np.repeat(self._groups() * factors, width, axis=0)[: before + points]
        number = drawn(rate, following, self.next_member, rng)[before:]
        tick, area = np.nonzero(number)
        times = number[tick, area]
        return self.areas.draw(
            np.repeat(tick, times) * self.grid_s, np.repeat(area, times), scene, rng
        )

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """An estimate of the log-probability of the arrivals, nats per person.

        By a bootstrap particle filter with 300 particles (Gordon, Salmond and Smith 1993, IEE
        Proceedings F 140), whose estimate of the probability is unbiased: that of its logarithm
        is too low on average.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        from crowdbench.spawn.times.cox_kernels import filtered

        check_grid(arrivals, self.grid_s, NAME)
        width, total = self._width(), 0.0
        step_s = width * self.grid_s
        for counts in arrivals.by_window():
            total += filtered(
                counts,
                self._drawn_after(counts),
                width,
                self._groups(),
                self.next_member,
                self.waves.roots(),
                self.waves.recursion(step_s),
                0.5 * self.waves.variance(),
                PARTICLES,
                np.random.default_rng(0),
            )
        return total / max(1, len(arrivals.tick))

    def _groups(self) -> Float[np.ndarray, " K"]:
        share = (1 - self.followers.sum()) * (1 - self.next_member)
        return np.asarray(self.rate_per_s * self.grid_s * share)

    def _drawn_after(self, counts: Int[np.ndarray, "T K"]) -> Float[np.ndarray, "T K"]:
        """Rates of groups that follow those who entered; before the first step, the mean number."""
        from scipy.signal import lfilter

        following = spread(self.followers, self.grid_s)
        mean = self.rate_per_s * self.grid_s
        past = np.broadcast_to(mean, (len(following), len(mean)))
        rates = lfilter([0.0, *following], [1.0], np.concatenate([past, counts]), axis=0)
        return np.asarray(rates[len(following) :] * (1 - self.next_member))

    def _width(self) -> int:
        return max(1, round(STEP_S / self.grid_s))

    def _fit(self) -> CoxFit:
        waves = self.waves.tau_s, self.waves.covariance
        return CoxFit(self.rate_per_s, self.next_member, self.followers, *waves)

    @classmethod
    def _of_fit(cls, fit: CoxFit, areas: Areas, scene: Scene, **more: Any) -> Any:
        return super()._of_fit(fit, areas, scene, waves=Waves(fit.tau_s, fit.covariance))


def lags(grid_s: float) -> Int[np.ndarray, " H"]:
    """Bin of `FOLLOWING_S` of each delay of 1, 2, … grid steps that is not longer than 6 s."""
    delay = np.arange(1, int(FOLLOWING_S[-1] / grid_s + 1e-6) + 1) * grid_s
    return np.asarray(np.searchsorted(FOLLOWING_S, delay, side="right") - 1).clip(
        0, len(FOLLOWING_S) - 2
    )


def spread(followers: Float[np.ndarray, " F"], grid_s: float) -> Float[np.ndarray, " H"]:
    """φ at each delay: the numbers of each bin, spread over its grid steps."""
    of_bin = lags(grid_s)
    return np.asarray(followers / np.bincount(of_bin, minlength=len(followers)).clip(1))[of_bin]


def _excess(arrivals: Arrivals, waves: Waves, most: int) -> Float[np.ndarray, "H K"]:
    """E[n(t) n(t + h)] of each area, less what the waves explain, for h from 0 to `most` steps."""
    products, pairs = np.zeros((most + 1, arrivals.areas)), np.zeros(most + 1)
    for n in in_steps(arrivals, 1):
        for h in range(min(most + 1, len(n))):
            products[h] += (n[: len(n) - h] * n[h:]).sum(axis=0)
            pairs[h] += len(n) - h
    mean = arrivals.counts().mean(axis=0)
    delay = np.arange(most + 1) * arrivals.grid_s
    correlations = waves.correlations(delay) - mean_correlations(waves, arrivals)
    log = correlations @ np.diagonal(waves.covariance, axis1=1, axis2=2)
    return np.asarray(products / pairs.clip(1)[:, None] - mean**2 * np.exp(np.minimum(log, 5.0)))


def _followers(excess: Float[np.ndarray, " H"], grid_s: float) -> Float[np.ndarray, " F"]:
    """Solve κ(h) = Σ_j φ(j) κ(h − j) for h ≥ 1, with φ ≥ 0 constant in each bin of delays."""
    from scipy.linalg import toeplitz
    from scipy.optimize import nnls

    of_bin = lags(grid_s)
    found = np.zeros(len(FOLLOWING_S) - 1)
    if len(of_bin) == 0 or excess[0] <= 0:
        return found
    bins, member = np.unique(of_bin, return_inverse=True)
    share = np.equal.outer(member, np.arange(len(bins))) / np.bincount(member)
    found[bins] = nnls(toeplitz(excess[:-1]) @ share, excess[1:])[0]
    return np.asarray(found * min(1.0, _MOST_FOLLOWERS / max(found.sum(), 1e-12)))


def _members(
    variance: Float[np.ndarray, " K"],
    mean: Float[np.ndarray, " K"],
    persons: Float[np.ndarray, " K"],
) -> Float[np.ndarray, " K"]:
    """P(one more member): geometric groups have the variance m (1 + ρ) / (1 − ρ) per mean m.

    The ratio of variance and mean is drawn towards that of all areas where there are few persons.
    """
    pooled = variance.sum() / max(mean.sum(), 1e-12)
    own = np.divide(variance, mean, out=np.ones_like(mean), where=mean > 0)
    ratio = (persons * own + 100.0 * pooled) / (persons + 100.0)
    return np.clip((ratio - 1) / (ratio + 1), 1e-6, _MOST_MEMBERS)
