"""What is known of a scene: the numbers that the verdicts are based on."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.metrics import MetricResult, Statistics
from crowdbench.scene import Scene
from crowdbench.scoring.energy import Draws
from crowdbench.scoring.reference import Reference
from studies.paper.bursts import Bursts
from studies.paper.fits import (
    CODE,
    LITERAL,
    POISSON,
    POISSON_CODE,
    SHIPPED,
    Configuration,
)
from studies.paper.measures import Numbers
from studies.paper.presence import Presence
from studies.paper.study import Sample

NEURAL = {
    LITERAL: "the paper’s model",
    CODE: "its published code",
    SHIPPED: "crowdbench’s ntpp-gmm",
}
BASELINE = {LITERAL: POISSON, CODE: POISSON_CODE, SHIPPED: POISSON}
"""The Poisson process that each neural model is compared with; the code has one of its own."""
_TAILS = (2.5, 97.5)


@dataclass(frozen=True, eq=False)
class Evidence:
    """The statistics of the recording and of all samples on a scene."""

    scene: Scene
    walker: str
    """Policy of the rollouts."""
    bursts: Bursts
    """Of the recorded arrivals."""
    present: Sequence[Presence]
    """The recorded number of people present, for each of `study.SCHEMES`."""
    samples: Mapping[Configuration, Sequence[Sample]]
    walked: Mapping[tuple[Configuration, str], Sequence[Mapping[str, MetricResult]]]
    """Rollouts compared with the recording, by model and policy: results by name of metric."""
    dwell_noise: float
    """95 % of resamples of the recording have a distance of dwell times of at most this."""

    def numbers(self, of: Configuration, scheme: int) -> Numbers:
        """Statistics of N(t) of a model's samples for one of the schemes (an index)."""
        each = [sample.present[scheme] for sample in self.samples[of]]
        return Numbers.of(each, self.present[scheme])

    def draws(self, of: Configuration) -> list[Bursts]:
        """The statistics of all samples of a model's arrivals."""
        return [bursts for sample in self.samples[of] for bursts in sample.bursts]

    def spread(self, of: Configuration, name: str) -> tuple[float, float]:
        """Central 95 % of an attribute of `Bursts` over a model's samples."""
        values = [getattr(bursts, name) for bursts in self.draws(of)]
        low, high = np.percentile(values, _TAILS)
        return float(low), float(high)

    def distances(self, of: Configuration, policy: str, metric: str) -> list[float]:
        """Distances of a model's rollouts to the recording."""
        return [results[metric].distance for results in self.walked[of, policy]]

    def values(self, of: Configuration, policy: str, metric: str) -> list[float]:
        """Typical values of a model's rollouts."""
        return [results[metric].simulated for results in self.walked[of, policy]]

    def recorded(self, metric: str) -> float:
        """Typical value of the recording."""
        return next(iter(self.walked.values()))[0][metric].recorded


def noise(reference: Reference, metric: str, draws: Draws) -> float:
    """The distance that 95 % of the resamples of a recording's time blocks keep to it."""
    of = next(m for m in reference.metrics if m.name == metric)
    whole = reference.statistics[metric]
    found = []
    for times in draws.blocks:
        index = np.repeat(np.arange(len(times)), times)
        resampled: Statistics = {name: values[index] for name, values in whole.items()}
        found.append(of.compare(whole, resampled, reference.blocks).distance)
    return float(np.percentile(found, 95))
