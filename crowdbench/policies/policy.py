"""The protocol behind which every policy stands, and what model-based walkers see."""

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.routes import Routes


@dataclass(frozen=True, eq=False)
class StateView:
    """The `A` persons who are there, all worlds in one list: privileged state, not observation."""

    world: Int[np.ndarray, " A"]
    slot: Int[np.ndarray, " A"]
    person: Int[np.ndarray, " A"]
    event: Int[np.ndarray, " A"]
    """Index of each person's spawn event."""
    frame: Int[np.ndarray, " A"]
    """Present frame of each person's world."""
    position: Float32[np.ndarray, "A 2"]
    """Metres."""
    velocity: Float32[np.ndarray, "A 2"]
    """m/s."""
    goal: Float32[np.ndarray, "A 2"]
    """Metres."""
    speed: Float32[np.ndarray, " A"]
    """Preferred walking speed, m/s."""

    @classmethod
    def of(cls, simulation: Simulation) -> "StateView":
        """Everyone alive, ordered by world, then slot."""
        slots = simulation.slots
        at = np.flatnonzero(slots.alive)  # one index is looked up faster than two
        world, slot = np.divmod(at, slots.alive.shape[1])
        return cls(
            world=world,
            slot=slot,
            person=slots.person.ravel().take(at),
            event=slots.event.ravel().take(at),
            frame=simulation.clock.frame.take(world),
            position=slots.position.reshape(-1, 2).take(at, axis=0),
            velocity=slots.velocity.reshape(-1, 2).take(at, axis=0),
            goal=slots.goal.reshape(-1, 2).take(at, axis=0),
            speed=slots.speed.ravel().take(at),
        )

    def towards(self, routes: Routes) -> Float[np.ndarray, "A 2"]:
        """Where each person is to walk next so as to take the shortest way around the walls."""
        return routes.next_of(self.world, self.slot, self.person, self.position, self.goal)[0]


class _Named(Protocol):
    @property
    def name(self) -> str:
        """Under which tables show it."""
        ...

    def reset(self, scene: Scene, rng: Generator) -> None:
        """An episode begins."""
        ...


@runtime_checkable  # tests check annotations at run time
class ObservationPolicy(_Named, Protocol):
    """Sees what agents in an environment see."""

    sees: ClassVar[Literal["observation"]]

    def act(self, seen: Float32[np.ndarray, "A obs"]) -> Float32[np.ndarray, "A 2"]:
        """Actions of the persons whose observations these are."""
        ...


@runtime_checkable
class StatePolicy(_Named, Protocol):
    """Sees the state itself; a leaderboard shows it as privileged."""

    sees: ClassVar[Literal["state"]]

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions of everyone present, in the order of the view."""
        ...


Policy = ObservationPolicy | StatePolicy
"""What walks the persons: a batch of what they see in, a batch of actions out.

A policy that leaves nothing to chance may say so by `deterministic = True`: under recorded
arrivals one rollout of it is as good as many.

An action is a velocity in units of the scene's `max_speed_mps`, both components in [−1, 1]; what is
beyond is clipped, as in the environment.
"""
