"""Held-out likelihoods of spawn models, and statistics of their long samples."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.metrics.presence import lagged
from crowdbench.registry import policy, recording_of, spawn_model
from crowdbench.run.jobs import BATCH
from crowdbench.run.rollout import rollouts
from crowdbench.scene import Scene
from crowdbench.scene_building.fit import NEURAL
from crowdbench.spawn import Arrivals, FittedModel, arrivals_of
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of

PERIODS_S = (10.0, 60.0, 120.0, 300.0)
"""Lengths of the periods in which arrivals are counted for Fano factors."""
LAGS_S = (60.0, 120.0)


def held_out(scene: Scene, models: Sequence[str]) -> dict[str, list[float]]:
    """Nats per held-out person, all folds together, for each fit of each model.

    Raises:
        WeightsError: the scene lacks fits.
        RecordingError: its recording has not been imported.
    """
    crowd, areas = recording_of(scene), len(read_areas(scene).spawn)
    blocks = blocks_of(crowd, scene)
    folds = {split: arrivals_of(crowd, blocks.scored(split), areas) for split in SPLITS[1:]}
    people = sum(len(of.tick) for of in folds.values())

    def nats(model: str, split: str, fit: int, arrivals: Arrivals) -> float:
        fitted = spawn_model(model, scene, split, fit)
        assert isinstance(fitted, FittedModel)
        return fitted.log_likelihood(arrivals) * len(arrivals.tick)

    return {
        model: [
            sum(nats(model, split, fit, of) for split, of in folds.items()) / people
            for fit in range(scene.protocol.fits if model in NEURAL else 1)
        ]
        for model in models
    }


@dataclass(frozen=True)
class LongSample:
    """Statistics of one sample, or of the recording."""

    people_per_s: float
    present_sd: float
    """Standard deviation of the number of people present."""
    autocorrelation: list[float]
    """Of the number of people present, at `LAGS_S`."""
    fano: list[float]
    """Variance over mean of the number of arrivals in `PERIODS_S`."""

    def numbers(self) -> list[float]:
        """All of them."""
        return [self.people_per_s, self.present_sd, *self.autocorrelation, *self.fano]


NAMES = (
    "people per s",
    "sd of people present",
    *(f"its autocorrelation at {lag:g} s" for lag in LAGS_S),
    *(f"Fano factor of arrivals in {period:g} s" for period in PERIODS_S),
)
"""What the numbers of a long sample are."""


def long_samples(scene: Scene, models: Sequence[str], samples: int) -> dict[str, list[LongSample]]:
    """Statistics of samples as long as the recording, with straight walkers; also "recorded".

    Raises:
        WeightsError: the scene lacks fits.
        RecordingError: its recording has not been imported.
    """
    recorded = recording_of(scene)
    found = {"recorded": [_statistics(recorded, scene)]}
    for name in models:
        fitted = [spawn_model(name, scene, fit=k % scene.protocol.fits) for k in range(samples)]
        found[name] = []
        for k in range(0, samples, BATCH):
            some = fitted[k : k + BATCH]
            seeds = range(k, k + len(some))
            crowds = rollouts(scene, some, policy("straight", scene), seeds=seeds)
            found[name] += [_statistics(crowd, scene) for crowd in crowds]
    return found


def _statistics(crowd: Trajectories, scene: Scene) -> LongSample:
    blocks = blocks_of(crowd, scene)
    correlations = []
    for n, x, y, xy, xx, yy in lagged(crowd, blocks, LAGS_S, across=True).sum(axis=1):
        covariance = xy / n - x * y / n**2
        correlations.append(covariance / np.sqrt((xx / n - (x / n) ** 2) * (yy / n - (y / n) ** 2)))
    entered = crowd.spawn_s[crowd.entered]
    length_s = crowd.frames * crowd.dt_s
    fano = []
    for period in PERIODS_S:
        counts, _ = np.histogram(entered, np.arange(0, length_s + 1e-6, period))
        fano.append(float(counts.var(ddof=1) / counts.mean()))
    return LongSample(
        float(len(entered) / length_s),
        float(crowd.present().std()),
        [float(of) for of in correlations],
        fano,
    )
