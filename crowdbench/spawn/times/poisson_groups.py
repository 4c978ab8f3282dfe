"""`poisson-groups`: groups enter each area at a constant rate.

At each grid point a group enters an area with a constant probability, independent of the past. Its
size is geometric, as in `renewal-gmm`. The gain over `poisson-gmm` is the effect of groups alone,
and the gain of other models over this one is the effect of modelling times. An area of `ntpp-gmm`
without a trained network uses this model.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.times.groups import (
    Hazards,
    check_grid,
    geometric_sizes,
    group_size,
    per_person,
    spells_of,
)
from crowdbench.spawn.weights import Fits, check_numbers, check_split, read_split, write_splits

NAME = "poisson-groups"
_NUMBERS = ("rate_per_s", "next_member")


@dataclass(frozen=True, eq=False)
class PoissonGroups:
    """Groups at a constant rate per area, with the scene's Gaussian areas."""

    areas: Areas
    rate_per_s: Float[np.ndarray, " K"]
    """Expected groups per second for each area; at each grid point a group enters with probability
    rate × grid step."""
    next_member: Float[np.ndarray, " K"]
    """P(a group has one more member) for each area."""
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    name: str = NAME
    start: ClassVar[Start] = "stationary"

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "PoissonGroups":
        """Maximum-likelihood fit by `group_size`; the expected number of persons is as recorded."""
        more, groups = group_size(arrivals)
        return cls(areas, groups / arrivals.grid_s, more, arrivals.grid_s)

    def mean_rate(self) -> Float[np.ndarray, " K"]:
        """Expected persons per second for each area."""
        return self.rate_per_s / (1 - self.next_member)

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

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Log-probability of the arrivals, in nats per person."""
        return per_person(self.hazards(arrivals), arrivals)

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Cumulative hazards of the groups: gaps and sizes are geometric.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        check_grid(arrivals, self.grid_s, NAME)
        spells = spells_of(arrivals)
        step = -np.log1p(-self._chance())
        at = spells.area[spells.of_group]
        return Hazards(
            gap=step[at, None] * np.stack([spells.gap - 1, spells.gap], axis=1),
            size=geometric_sizes(spells, self.next_member),
            rest=step[spells.area] * spells.rest,
        )

    @classmethod
    def write(cls, folder: Path, fits: "Fits[PoissonGroups]") -> None:
        """Write the fits of all splits into a scene's folder."""
        scene = fits["full"][0].areas.scene
        splits = {p: {name: getattr(m[0], name) for name in _NUMBERS} for p, m in fits.items()}
        write_splits(folder / f"{NAME}.json", NAME, scene, splits)

    @classmethod
    def read(cls, scene: Scene, areas: Areas, split: str = "full", fit: int = 0) -> "PoissonGroups":
        """The fit that a scene ships for a split; all values of `fit` give the same fit.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        check_split(split, fit)
        numbers = read_split(scene, NAME, _NUMBERS, len(areas.spawn), split)
        rate, more = (numbers[name] for name in _NUMBERS)
        check_numbers(
            scene,
            NAME,
            {
                "rate_per_s": (
                    bool(((rate >= 0) & (rate * scene.grid_s < 1)).all()),
                    "rates from 0 to below one group per grid step",
                ),
                "next_member": (bool(((more > 0) & (more < 1)).all()), "probabilities in (0, 1)"),
            },
        )
        return cls(areas, rate, more, scene.grid_s)
