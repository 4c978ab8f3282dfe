"""The interface of spawn models."""

from typing import ClassVar, Literal, Protocol, runtime_checkable

from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.events import Arrivals, SpawnEvents

Start = Literal["stationary", "recorded", "empty"]
"""How an episode begins: with the crowd at the end of a discarded warm-up, with the recorded
initial population, or with an empty scene."""


@runtime_checkable  # tests check annotations at run time
class SpawnModel(Protocol):
    """A model of when, where and with which goal people enter."""

    start: ClassVar[Start]
    """How an episode with this model begins by default."""

    @property
    def name(self) -> str:
        """Name of the model in tables."""
        ...

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds."""
        ...


@runtime_checkable
class FittedModel(SpawnModel, Protocol):
    """A spawn model with a likelihood.

    Likelihoods are comparable between models because they have the same definition: the
    probability of the *number of persons who enter at each area at each point of the annotation
    grid*, in nats per person. Several persons at one grid point are therefore not a special case,
    and time without arrivals (the survival term) is included.
    """

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Log-probability of the arrivals in their windows, nats per person."""
        ...
