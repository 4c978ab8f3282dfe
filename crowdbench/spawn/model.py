"""The protocol behind which every spawn model stands."""

from typing import ClassVar, Literal, Protocol, runtime_checkable

from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.events import Arrivals, SpawnEvents

Start = Literal["stationary", "recorded", "empty"]
"""How an episode begins: with a crowd that walked in during a discarded warm-up, with the
recorded initial population, or with nobody."""


@runtime_checkable  # tests check annotations at run time
class SpawnModel(Protocol):
    """When, where and with which goal people enter.

    Likelihoods are comparable between models because all mean the same thing: the probability
    of the *number of persons that each area lets in at each point of the annotation grid*, in
    nats per person. Several persons at one grid point are thus no special case, and the time
    without arrivals (the survival term) counts.
    """

    start: ClassVar[Start]
    """How an episode of this model begins unless told otherwise."""

    @property
    def name(self) -> str:
        """Under which tables show it."""
        ...

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Events in [0, `horizon_s`)."""
        ...

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Log-probability of the arrivals in their windows, nats per person."""
        ...
