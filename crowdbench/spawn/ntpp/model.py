"""`ntpp-gmm`: neural temporal point processes, one per area, with the scene's Gaussian areas.

Based on the ICRA 2025 paper "Whenever, Wherever", Sec. III-B: a recurrent network (GRU) reads an
area's groups, and a small head maps its state to a Weibull distribution of the time to the next
group. The differences to the paper, and their reasons:

- People who enter an area at the same grid point are one event with a size. The size has a
  geometric distribution, which is the head's third output. If each person were an event, there
  would be gaps of 0, at which a Weibull density is 0 or infinite.
- Gaps are on the annotation grid: with S the Weibull survival function in grid steps, a gap lasts
  g ≥ 1 steps with probability S(g − 1) − S(g).
- An observed stretch starts at any time, not at a group. The wait to the first group is predicted
  by the same head from a learned initial state, which thereby learns the forward recurrence time.
  Samples start stationary instead of with a group in every area.
- After a silence as long as a training window, the state is reset to the initial state, because no
  training window contains what follows a longer silence.
- Areas with few groups, and areas where cross-validation selects no training step, keep the model
  from before training: a constant rate of groups, as in `poisson-groups` (see `trained`).
- Training and sampling compute state updates in the same way, without clamping. The outputs of the
  head are bounded around the Poisson solution (`ntpp_kernels`).

Training needs torch (`crowdbench.spawn.ntpp.training`); sampling and likelihood do not.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.ntpp.files import NetworkFile
from crowdbench.spawn.times.groups import Hazards, check_grid, per_person, spells_of
from crowdbench.spawn.weights import Fits

NAME = "ntpp-gmm"
SCHEMA = 2
NEVER_FORGETS = 2**31 - 1
HIDDEN = 32
HEAD = 32
SHAPES: dict[str, tuple[int, ...]] = {
    "input_weight": (3 * HIDDEN, 2),
    "input_bias": (3 * HIDDEN,),
    "state_weight": (3 * HIDDEN, HIDDEN),
    "state_bias": (3 * HIDDEN,),
    "initial": (HIDDEN,),
    "hidden_weight": (HEAD, HIDDEN),
    "hidden_bias": (HEAD,),
    "out_weight": (3, HEAD),
    "out_bias": (3,),
    "base": (3,),
    "scaling": (4,),
}
"""Shapes of the weights of one area. The gates of the GRU are in the order reset, update,
candidate, as in torch. `base` is added to the head's outputs: log shape, log scale (grid steps) and
log odds of one more member. `scaling` holds mean and standard deviation of log gap (grid steps),
then of log size."""


_FILE = NetworkFile(NAME, SCHEMA, SHAPES)


@dataclass(frozen=True, eq=False)
class NtppGMM:
    """Neural temporal point process of groups per area, with the scene's Gaussian areas."""

    areas: Areas
    weights: Mapping[str, Float[np.ndarray, "K ..."]]
    """Arrays with the names and shapes of `SHAPES`, with the areas as first axis."""
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    memory: int = NEVER_FORGETS
    """Number of grid steps without a group after which the state is reset to the initial one."""
    settings: Mapping[str, int | float] = field(default_factory=dict)
    """Training settings (`ntpp_training.Settings`); fit k of a file has the seed k."""
    name: str = NAME
    start: ClassVar[Start] = "stationary"

    def of_area(self, k: int) -> tuple[np.ndarray, ...]:
        """The weights of one area in the form that the kernels expect."""
        return tuple(np.ascontiguousarray(self.weights[n][k], dtype=np.float64) for n in SHAPES)

    def trained(self) -> Bool[np.ndarray, " K"]:
        """Whether each area has a trained network, whose output depends on past groups.

        In areas with few groups, and where cross-validation selected no training step, the output
        weights are 0: groups enter at a constant rate, as in `poisson-groups`.
        """
        found: Bool[np.ndarray, " K"] = (self.weights["out_weight"] != 0).any(axis=(1, 2))
        return found

    def learned(self) -> int:
        """Number of learned parameters that samples depend on.

        These are all weights of the trained networks, and two parameters for each other area: a
        rate and P(one more member).
        """
        each = sum(math.prod(shape) for shape in SHAPES.values())
        trained = int(self.trained().sum())
        return trained * each + (len(self.areas.spawn) - trained) * 2

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        from crowdbench.spawn.ntpp.kernels import draw

        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        tick, area = [np.empty(0)], [np.empty(0, dtype=np.int64)]
        for k in range(len(self.areas.spawn)):
            groups, size = draw(points, self.memory, self.of_area(k), rng)
            tick.append(np.repeat(groups, size))
            area.append(np.full(len(tick[-1]), k))
        return self.areas.draw(np.concatenate(tick) * self.grid_s, np.concatenate(area), scene, rng)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Log-probability of the arrivals, in nats per person."""
        return per_person(self.hazards(arrivals), arrivals)

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        return self._along(arrivals)[0]

    def parameters(self, arrivals: Arrivals) -> Float[np.ndarray, "n 3"]:
        """Output of the head before each group.

        The columns are Weibull shape, Weibull scale (grid steps), and −log P(one more member).
        """
        return self._along(arrivals)[1]

    def _along(self, arrivals: Arrivals) -> tuple[Hazards, Float[np.ndarray, "n 3"]]:
        from crowdbench.spawn.ntpp.kernels import expect

        check_grid(arrivals, self.grid_s, NAME)
        spells = spells_of(arrivals)
        n = len(spells.gap)
        hazards = Hazards(np.zeros((n, 2)), np.zeros((n, 2)), np.zeros(len(spells.rest)))
        parameters = np.ones((n, 3))
        for k in range(len(self.areas.spawn)):
            mine = np.flatnonzero(spells.area == k)
            own = slice(mine[0], mine[-1] + 1)
            offsets = spells.offsets[mine[0] : mine[-1] + 2]
            groups = slice(offsets[0], offsets[-1])
            expect(
                spells.gap[groups],
                spells.size[groups],
                offsets - offsets[0],
                spells.rest[own],
                self.memory,
                self.of_area(k),
                hazards.gap[groups],
                hazards.size[groups],
                hazards.rest[own],
                parameters[groups],
            )
        return hazards, parameters

    @classmethod
    def write(cls, folder: Path, fits: "Fits[NtppGMM]") -> None:
        """Write all fits of all splits into a scene's folder."""
        first = fits["full"][0]
        _FILE.write(
            folder,
            first.areas.scene,
            {split: [model.weights for model in models] for split, models in fits.items()},
            grid_s=first.grid_s,
            memory=first.memory,
            settings=first.settings,
        )

    @classmethod
    def read(cls, scene: Scene, areas: Areas, split: str = "full", fit: int = 0) -> "NtppGMM":
        """A fit that a scene ships for a split; `fit` is taken modulo the number of fits.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        header, weights = _FILE.read(scene, len(areas.spawn), split, fit)
        return cls(areas, weights, header.grid_s, header.memory, header.settings)


def networks(scene: Scene, areas: Areas, splits: Sequence[str]) -> Int[np.ndarray, "F K"]:
    """Number of trained networks for each fit and area, over the given splits.

    Raises:
        WeightsError: the scene's file is missing or broken, or belongs to another scene.
    """
    fits = range(scene.protocol.fits)
    each = [[NtppGMM.read(scene, areas, p, fit).trained() for p in splits] for fit in fits]
    return np.sum(each, axis=1)
