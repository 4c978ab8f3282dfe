"""`joint-gmm`: one neural point process for the arrivals at all areas, with their sizes.

The founding paper models each area by a network of its own, which knows nothing of the others, and
asks for joint models (Sec. VI). Here one small network reads the past of the whole place. In area a
and at grid point t, a group enters with probability 1 − exp(−λ), where

    λ_a(t) = μ_a exp(f_a) + (1 − ρ_a) Σ_h φ(h) n_a(t − h)

and has n members with probability ρⁿ⁻¹(1 − ρ), where the odds of ρ are ρ_a exp(g_a) / (1 − ρ_a).
μ_a and ρ_a are constants of the area. φ(h) is the number of people who follow each person h steps
later, for at most 6 s: companions, and the next people of a queue. f_a and g_a are the outputs of
the network (two layers of 32, tanh), for steps of 0.8 s or one of the grid. Its inputs are *traces*
of the area and of all areas: numbers of past arrivals n, weighted by exp(−age / τ) with τ of 2, 6,
20, 60 and 180 s, in relation to their means. So one set of weights serves all areas of all places,
and can learn from all of them. Traces start at their means, and the network knows how old they are.

The outputs are bounded by tanh: no history makes a rate more than exp(3) times the usual one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float32, Int, Int64
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.arrays import Fit, Rule
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.fits import FitFile, Fitted
from crowdbench.spawn.joint.traces import mean_traces, width_of
from crowdbench.spawn.times.cox import spread
from crowdbench.spawn.times.groups import HasHazards, Hazards, check_grid, spells_of

NAME = "joint-gmm"


class JointFit(Fit, frozen=True):
    """The network, and what is different in each of the `K` areas.

    `followers` are numbers of people for each bin of delays in `FOLLOWING_S`. `own_in` is added to
    the first layer, and `own_out` to the outputs.
    """

    in_weight: Float32[np.ndarray, "H 20"]
    in_bias: Float32[np.ndarray, " H"]
    weight: Float32[np.ndarray, "H H"]
    bias: Float32[np.ndarray, " H"]
    out_weight: Float32[np.ndarray, "2 H"]
    out_bias: Float32[np.ndarray, " 2"]
    followers: Float32[np.ndarray, " 5"]
    own_in: Float32[np.ndarray, "K H"]
    own_out: Float32[np.ndarray, "K 2"]
    rate_per_s: Float32[np.ndarray, " K"]
    log_rate: Float32[np.ndarray, " K"]
    log_odds: Float32[np.ndarray, " K"]
    steps: Int64[np.ndarray, " 1"]
    """Number of training steps on the scene's own recording."""
    grid_s: float

    def rules(self, scene: Scene) -> list[Rule]:
        """Rates and followers are possible."""
        followers = (self.followers >= 0).all() and self.followers.sum() < 1
        same = np.isclose(self.grid_s, scene.grid_s)
        return [
            ("rate_per_s", (self.rate_per_s >= 0).all(), "rates ≥ 0"),
            ("followers", followers, "numbers ≥ 0 with a sum below 1"),
            ("grid_s", same, f"{scene.grid_s:g} s, the step of the scene's grid"),
        ]


SHARED = ("in_weight", "in_bias", "weight", "bias", "out_weight", "out_bias")
"""Names of the weights of the network that are the same for all areas."""
WEIGHTS = (*SHARED, "own_in", "own_out")
"""Names of all weights, in the order of the kernels."""


@dataclass(frozen=True, eq=False)
class JointGMM(HasHazards, Fitted):
    """Arrivals at all areas by one network, with the scene's Gaussian areas."""

    weights: Mapping[str, Float32[np.ndarray, "..."]]
    """Those of the network by name, see `JointFit`."""
    followers: Float32[np.ndarray, " 5"]
    """Number of persons who follow each person, for each bin of delays in `FOLLOWING_S`."""
    rate_per_s: Float32[np.ndarray, " K"]
    """Mean number of persons per second for each area, to which its traces are compared."""
    log_rate: Float32[np.ndarray, " K"]
    """log μ, groups per grid step."""
    log_odds: Float32[np.ndarray, " K"]
    """Log odds of ρ."""
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    steps: int = 0
    name: str = NAME
    file: ClassVar[FitFile[JointFit]] = FitFile(NAME, 1, JointFit, ".safetensors")

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        number = self.counts(int(np.ceil(horizon_s / self.grid_s - 1e-6)), rng)
        tick, area = np.nonzero(number)
        times = number[tick, area]
        return self.areas.draw(
            np.repeat(tick, times) * self.grid_s, np.repeat(area, times), scene, rng
        )

    def counts(self, points: int, rng: Generator) -> Int[np.ndarray, "points K"]:
        """Sample the numbers of people at so many grid points."""
        from crowdbench.spawn.joint.kernels import draw

        return draw(points, *self._for_kernels, rng)

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups, given all arrivals before them.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        from crowdbench.spawn.joint.kernels import expect

        check_grid(arrivals, self.grid_s, NAME)
        counts = arrivals.by_window()
        rates, odds = [], []
        for n in counts:
            filled = np.empty(n.shape), np.empty(n.shape)
            expect(n, *self._for_kernels, *filled)
            rates.append(filled[0])
            odds.append(filled[1])
        number, rate, log_odds = (np.concatenate(x) for x in (counts, rates, odds))
        spells = spells_of(arrivals)
        end = np.tile(np.cumsum([len(n) for n in counts]), number.shape[1])  # as in spells
        total = np.concatenate([np.zeros((1, number.shape[1])), np.cumsum(rate, axis=0)])
        area, tick = np.nonzero(number.T)  # by area, then by time, as in spells
        until = total[tick + 1, area]
        since = total[tick + 1 - spells.gap, area]
        gap = np.stack([total[tick, area] - since, until - since], axis=1)
        rest = total[end, spells.area] - total[end - spells.rest, spells.area]
        more = np.logaddexp(0.0, -log_odds[tick, area])  # −log P(one more member)
        size = more[:, None] * np.stack([spells.size - 1, spells.size], axis=1)
        return Hazards(gap=gap, size=size, rest=rest)

    @cached_property
    def _for_kernels(self) -> tuple[Any, ...]:
        width = width_of(self.grid_s)
        weights = tuple(self.weights[name].astype(np.float64) for name in WEIGHTS)
        log_rate, log_odds = (x.astype(np.float64) for x in (self.log_rate, self.log_odds))
        following = spread(self.followers.astype(np.float64), self.grid_s)
        mean = mean_traces(self.rate_per_s.astype(np.float64))
        step_s = width * self.grid_s
        return width, step_s, mean, weights, log_rate, log_odds, following

    def _fit(self) -> JointFit:
        mine: dict[str, Any] = dict(self.weights)
        mine["steps"] = np.array([self.steps])
        names = (n for n in JointFit.__struct_fields__ if n not in mine)
        return JointFit(**mine, **{name: getattr(self, name) for name in names})

    @classmethod
    def _of_fit(cls, fit: Any, areas: Areas, scene: Scene, **more: Any) -> Any:
        weights = {name: getattr(fit, name) for name in WEIGHTS}
        steps = int(fit.steps[0])
        return super()._of_fit(fit, areas, scene, weights=weights, steps=steps)
