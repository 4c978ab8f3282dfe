"""`cox-gmm`: Poisson arrivals of groups whose rates rise and fall in slow, common waves.

A log-Gaussian Cox process: in each area groups enter at the rate μ_a (1 − ρ_a) w_a(t), where w are
the factors of `waves`, which areas share, and ρ_a is P(a group has one more member). Group sizes
are geometric, so that μ_a is the mean rate of persons. The factors are constant for 0.8 s, or a
step of the annotation grid if that is longer. Everything is fitted by moments, in less than a
second.
"""

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
from crowdbench.spawn.groups import check_grid
from crowdbench.spawn.model import Start
from crowdbench.spawn.waves import STEP_S, Waves, fit_waves
from crowdbench.spawn.weights import Fits, check_origin, check_split, hint
from crowdbench.trajectories.blocks import SPLITS

NAME = "cox-gmm"
SCHEMA = 1
PARTICLES = 300
"""Number of particles of the filter that computes the likelihood."""
_MOST_MEMBERS = 0.95


class CoxNumbers(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The fit for one split, as in the file."""

    rate_per_s: list[float]
    next_member: list[float]
    tau_s: list[float]
    covariance: list[list[list[float]]]


class _File(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    schema: int
    model: str
    scene: str
    splits: dict[str, CoxNumbers]


@dataclass(frozen=True, eq=False)
class CoxGMM:
    """Groups at rates with slow waves, with the scene's Gaussian areas."""

    areas: Areas
    rate_per_s: Float[np.ndarray, " K"]
    """Mean number of persons per second for each area."""
    next_member: Float[np.ndarray, " K"]
    """P(a group has one more member) for each area."""
    waves: Waves
    grid_s: float
    """Step of the time grid on which groups enter, seconds."""
    name: str = NAME
    start: ClassVar[Start] = "stationary"

    @classmethod
    def fit(cls, arrivals: Arrivals, areas: Areas) -> "CoxGMM":
        """Fit the waves to pair correlations, and group sizes to the variance that they leave."""
        waves = fit_waves(arrivals)
        counts = arrivals.counts()
        mean = counts.mean(axis=0)
        of_waves = mean**2 * np.expm1(np.minimum(waves.variance(), 5.0))
        return cls(
            areas,
            mean / arrivals.grid_s,
            _members(counts.var(axis=0) - of_waves, mean, counts.sum(axis=0)),
            waves,
            arrivals.grid_s,
        )

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        points = int(np.ceil(horizon_s / self.grid_s - 1e-6))
        width = self._width()
        steps = -(-points // width)
        factors = self.waves.factors(steps, width * self.grid_s, rng)
        groups = self.rate_per_s * (1 - self.next_member) * self.grid_s
        rate = np.repeat(groups * factors, width, axis=0)[:points]
        tick, area = np.nonzero(number := rng.poisson(rate))
        times = number[tick, area]
        tick, area = np.repeat(tick, times), np.repeat(area, times)
        size = rng.geometric(1 - self.next_member[area])
        return self.areas.draw(
            np.repeat(tick, size) * self.grid_s, np.repeat(area, size), scene, rng
        )

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """An estimate of the log-probability of the arrivals, nats per person.

        By a bootstrap particle filter with 300 particles (Gordon, Salmond and Smith 1993, IEE
        Proceedings F 140), whose estimate of the probability is unbiased: that of its logarithm
        is too low on average.

        Raises:
            SettingError: the arrivals have another time grid than the model.
        """
        from crowdbench.spawn.cox_kernels import filtered

        check_grid(arrivals, self.grid_s, NAME)
        width, counts, base, total = self._width(), arrivals.counts(), 0, 0.0
        step_s = width * self.grid_s
        stay = np.exp(-step_s / self.waves.tau_s)
        for length in np.diff(arrivals.windows, axis=1)[:, 0].tolist():
            total += filtered(
                counts[base : base + length],
                width,
                self.rate_per_s * (1 - self.next_member) * self.grid_s,
                self.next_member,
                self.waves.roots(),
                stay,
                0.5 * self.waves.variance(),
                PARTICLES,
                np.random.default_rng(0),
            )
            base += length
        return total / max(1, len(arrivals.tick))

    def _width(self) -> int:
        return max(1, round(STEP_S / self.grid_s))

    @classmethod
    def write(cls, folder: Path, fits: "Fits[CoxGMM]") -> None:
        """Write the fits of all splits into a scene's folder."""
        scene = fits["full"][0].areas.scene
        splits = {split: models[0]._numbers() for split, models in fits.items()}
        write_json(
            folder / f"{NAME}.json", _File(schema=SCHEMA, model=NAME, scene=scene, splits=splits)
        )

    def _numbers(self) -> CoxNumbers:
        return CoxNumbers(
            rate_per_s=self.rate_per_s.tolist(),
            next_member=self.next_member.tolist(),
            tau_s=self.waves.tau_s.tolist(),
            covariance=self.waves.covariance.tolist(),
        )

    @classmethod
    def read(cls, scene: Scene, areas: Areas, split: str = "full", fit: int = 0) -> "CoxGMM":
        """The fit that a scene ships for a split; all values of `fit` give the same fit.

        Raises:
            SettingError: the split or fit does not exist.
            WeightsError: the file is missing or broken, or belongs to another scene.
        """
        check_split(split, fit)
        path, how = scene.folder / f"{NAME}.json", hint(scene)
        file = read_struct(path, _File, WeightsError, how)
        origin = (file.model, file.scene, file.schema)
        check_origin(path, origin, (NAME, scene.id, SCHEMA), how)
        if set(file.splits) != set(SPLITS):
            raise WeightsError(
                f"{path}, splits",
                got=", ".join(sorted(file.splits)) or "nothing",
                expected=", ".join(SPLITS),
                hint=how,
            )
        numbers, size = file.splits[split], len(areas.spawn)
        shapes = {
            "rate_per_s": (size,),
            "next_member": (size,),
            "tau_s": (len(numbers.tau_s),),
            "covariance": (len(numbers.tau_s), size, size),
        }
        found = {
            name: as_array(getattr(numbers, name), shape, f"{path}, splits.{split}.{name}", how)
            for name, shape in shapes.items()
        }
        _check(found, f"{path}, splits.{split}", how)
        waves = Waves(found["tau_s"], found["covariance"])
        return cls(areas, found["rate_per_s"], found["next_member"], waves, scene.grid_s)


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


def _check(found: dict[str, np.ndarray], where: str, how: str) -> None:
    covariance = found["covariance"]
    symmetric = np.allclose(covariance, covariance.transpose(0, 2, 1))
    rules = {
        "rate_per_s": ((found["rate_per_s"] >= 0).all(), "rates ≥ 0"),
        "next_member": (
            ((found["next_member"] > 0) & (found["next_member"] < 1)).all(),
            "probabilities in (0, 1)",
        ),
        "tau_s": ((found["tau_s"] > 0).all(), "times > 0"),
        "covariance": (
            symmetric and (np.linalg.eigvalsh(covariance) > -1e-6).all(),
            "symmetric, positive semidefinite matrices",
        ),
    }
    for name, (holds, expected) in rules.items():
        if not holds:
            raise WeightsError(f"{where}.{name}", got="invalid values", expected=expected, hint=how)
