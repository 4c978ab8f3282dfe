"""`poisson-gmm`: people enter each area at a constant rate, independently of each other.

`poisson-paper` is the same model as the founding paper's published code fits it.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, TypeVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.times.groups import Hazards, spells_of
from crowdbench.spawn.weights import Fits, check_numbers, check_split, read_split, write_splits

NAME = "poisson-gmm"

Model = TypeVar("Model", bound="PoissonGMM")


@dataclass(frozen=True, eq=False)
class PoissonGMM:
    """Homogeneous Poisson arrivals per area, with the scene's Gaussian areas."""

    areas: Areas
    rate: Float[np.ndarray, " K"]
    """Expected persons per second for each area."""
    name: str = NAME
    kind: ClassVar[str] = NAME
    """Name of the model, and of its file."""
    start: ClassVar[Start] = "stationary"

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

    @classmethod
    def write(cls, folder: Path, fits: "Fits[PoissonGMM]") -> None:
        """Write the rates of all splits into a scene's folder."""
        scene = fits["full"][0].areas.scene
        splits = {split: {"rate_per_s": models[0].rate} for split, models in fits.items()}
        write_splits(folder / f"{cls.kind}.json", cls.kind, scene, splits)

    @classmethod
    def read(
        cls: type[Model], scene: Scene, areas: Areas, split: str = "full", fit: int = 0
    ) -> Model:
        """The fit that a scene ships for a split; all values of `fit` give the same fit.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        check_split(split, fit)
        rate = read_split(scene, cls.kind, ["rate_per_s"], len(areas.spawn), split)["rate_per_s"]
        check_numbers(scene, cls.kind, {"rate_per_s": (bool((rate >= 0).all()), "rates ≥ 0")})
        return cls(areas, rate)


@dataclass(frozen=True, eq=False)
class PoissonPaper(PoissonGMM):
    """`poisson-gmm` as fitted by the published code of the paper (`code/src/tpp/poisson.py`).

    The rate of an area is the number of frames in which anybody enters, divided by the time from
    the first to the last of them. So people who enter together are lost, and areas with few
    arrivals close together get rates that are much too high. The paper itself describes the
    maximum-likelihood rate, which is that of `poisson-gmm`.
    """

    name: str = "poisson-paper"
    kind: ClassVar[str] = "poisson-paper"

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
