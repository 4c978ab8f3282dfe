"""`poisson-gmm`: each area lets people in at a constant rate, independently of everything."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.groups import Hazards, spells_of
from crowdbench.spawn.model import Start
from crowdbench.spawn.weights import Fits, check_numbers, check_part, read_part, write_parts

NAME = "poisson-gmm"


@dataclass(frozen=True, eq=False)
class PoissonGMM:
    """Homogeneous Poisson arrivals per area, with the scene's Gaussian areas."""

    areas: Areas
    rate: Float[np.ndarray, " K"]
    """Persons per second and area."""
    name: str = NAME
    start: ClassVar[Start] = "stationary"

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "PoissonGMM":
        """Maximum likelihood: persons per observed second, each person of a group counted.

        Source: Daley & Vere-Jones (2003), An Introduction to the Theory of Point Processes I,
        eq. 2.1.4.
        """
        count = np.bincount(arrivals.area, minlength=arrivals.areas)
        return cls(areas, count / arrivals.exposure_s())

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Events in [0, `horizon_s`)."""
        count = rng.poisson(self.rate * horizon_s)
        area = np.repeat(np.arange(len(self.rate)), count)
        return self.areas.draw(rng.random(len(area)) * horizon_s, area, scene, rng)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Nats per person: the counts at each grid point are Poisson of mean rate × grid step."""
        from scipy.stats import poisson

        total = poisson.logpmf(arrivals.counts(), self.rate * arrivals.grid_s).sum()
        return float(total / max(1, len(arrivals.tick)))

    def hazards(self, arrivals: Arrivals) -> Hazards:
        """Gaps are geometric, the sizes of groups Poisson given that they are not 0."""
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

    @classmethod
    def write(cls, folder: Path, fits: "Fits[PoissonGMM]") -> None:
        """Write the rates of all parts into a scene's folder."""
        scene = fits["full"][0].areas.scene
        parts = {part: {"rate_per_s": models[0].rate} for part, models in fits.items()}
        write_parts(folder / f"{NAME}.json", NAME, scene, parts)

    @classmethod
    def read(cls, scene: Scene, areas: Areas, part: str = "full", fit: int = 0) -> "PoissonGMM":
        """The rates that a scene ships for a part; its one fit stands for every `fit`.

        Raises:
            SettingError: there is no such part or fit.
            WeightsError: the file is missing, broken or another scene's.
        """
        check_part(part, fit)
        rate = read_part(scene, NAME, ["rate_per_s"], len(areas.spawn), part)["rate_per_s"]
        check_numbers(scene, NAME, {"rate_per_s": (bool((rate >= 0).all()), "rates ≥ 0")})
        return cls(areas, rate)
