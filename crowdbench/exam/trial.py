"""What a verification test is: rooms, what is measured in them, and limits of that."""

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.random import Generator, default_rng

from crowdbench.data.table import Trajectories
from crowdbench.exam.rooms import Room
from crowdbench.policies import Policy
from crowdbench.scene import Scene

Values = dict[str, float]
"""Measured values by name; the unit is part of the name."""


@dataclass
class Run:
    """One run of a test: a policy with the random numbers of a seed."""

    place: Scene
    """The scene whose time step, limits of motion and bodies the rooms have."""
    policy: Policy
    seed: int
    walked: list[tuple[Room, Trajectories]] = field(default_factory=list)
    """Rooms and what happened in them, in order; a picture shows the last one."""

    @property
    def rng(self) -> Generator:
        """A new generator with the seed: the same people for each policy."""
        return default_rng(self.seed)

    def walk(self, room: Room) -> Trajectories:
        """Walk the people of a room."""
        crowd = room.walk(self.policy, self.seed)
        self.walked.append((room, crowd))
        return crowd


@dataclass(frozen=True)
class Limit:
    """Where a measured value must lie, its mean over the seeds."""

    low: float | int = -np.inf
    high: float | int = np.inf

    def holds(self, value: float) -> bool:
        """Whether a value lies within; NaN does not."""
        return self.low <= value <= self.high

    def __str__(self) -> str:
        if self.low == self.high:
            return f"{self.low:g}"
        if np.isinf(self.high):
            return f"{self.low:g} or more"
        if np.isinf(self.low):
            return f"{self.high:g} or less"
        return f"{self.low:g} to {self.high:g}"


@dataclass(frozen=True)
class Trial:
    """A verification test."""

    id: str
    title: str
    guidelines: tuple[str, ...]
    """The tests of guidelines that it is, such as `RiMEA 1`."""
    task: str
    """What the room is and who walks there."""
    limits: Mapping[str, Limit]
    """Limits by the name of the measured value; other values are for information."""
    source: str
    """Where the limits come from."""
    seeds: int
    run: Callable[[Run], Values]


TRIALS: dict[str, Trial] = {}
"""All tests by id, in order."""


def trial(
    name: str,
    title: str,
    *guidelines: str,
    limits: Mapping[str, Limit],
    source: str,
    seeds: int = 3,
) -> Callable[[Callable[[Run], Values]], Callable[[Run], Values]]:
    """Decorator: the function that runs a test and measures it.

    Its docstring says what the room is and who walks there.
    """

    def add(run: Callable[[Run], Values]) -> Callable[[Run], Values]:
        task = " ".join((inspect.getdoc(run) or "").split())
        TRIALS[name] = Trial(name, title, guidelines, task, limits, source, seeds, run)
        return run

    return add


NOT_APPLICABLE = {
    "RiMEA 2, 3, 13, IMO 2, 3, 11, ISO 20414 3, 10, 12": "there are no stairs",
    "RiMEA 11, 14, ISO 20414 9, 15–17": "people have goals, they do not choose exits or routes",
    "ISO 20414 14": "groups are scored against recordings, by the metrics of companions",
}
"""Tests of the guidelines that do not apply, and why."""
