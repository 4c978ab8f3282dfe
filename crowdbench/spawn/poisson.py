"""`poisson-gmm`: each area lets people in at a constant rate, independently of everything."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, as_array
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start

SCHEMA = 1


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    rate_per_s: list[float]


@dataclass(frozen=True, eq=False)
class PoissonGMM:
    """Homogeneous Poisson arrivals per area, with the scene's Gaussian areas."""

    areas: Areas
    rate: Float[np.ndarray, " K"]
    """Persons per second and area."""
    name: str = "poisson-gmm"
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

    def write(self, folder: Path) -> None:
        """Write the rates into a scene's folder."""
        file = _File(
            schema=SCHEMA,
            model=self.name,
            scene=self.areas.scene,
            rate_per_s=self.rate.tolist(),
        )
        write_json(folder / "poisson-gmm.json", file)

    @classmethod
    def read(cls, scene: Scene, areas: Areas) -> "PoissonGMM":
        """The rates that a scene ships.

        Raises:
            WeightsError: the file is missing, broken or another scene's.
        """
        path = scene.folder / "poisson-gmm.json"
        mend = f"Run `crowdbench fit {scene.asked}`."
        file = read_struct(path, _File, WeightsError, mend)
        got = (file.model, file.scene, file.schema)
        if got != ("poisson-gmm", scene.id, SCHEMA):
            raise WeightsError(
                path,
                got=f"{file.model} of {file.scene}, schema {file.schema}",
                expected=f"poisson-gmm of {scene.id}, schema {SCHEMA}",
                mend=mend,
            )
        rate = as_array(file.rate_per_s, (len(areas.spawn),), f"{path}, rate_per_s", mend)
        if (rate < 0).any():
            raise WeightsError(path, got="a negative rate", expected="rates ≥ 0", mend=mend)
        return cls(areas, rate)
