"""The protocols that policies implement, and the state that model-based policies see."""

from dataclasses import dataclass
from typing import ClassVar, Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench.policies.memory import Memory
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.routes import Routes


@dataclass(frozen=True, eq=False)
class StateView:
    """State of the `A` people present, all worlds in one list. Observations do not contain it."""

    world: Int[np.ndarray, " A"]
    """World of each person."""
    slot: Int[np.ndarray, " A"]
    """Slot of each person in its world."""
    person: Int[np.ndarray, " A"]
    """Id of each person in its world."""
    event: Int[np.ndarray, " A"]
    """Index of each person's spawn event."""
    frame: Int[np.ndarray, " A"]
    """Current frame of each person's world."""
    position: Float32[np.ndarray, "A 2"]
    """Positions in metres."""
    velocity: Float32[np.ndarray, "A 2"]
    """Velocities in m/s."""
    goal: Float32[np.ndarray, "A 2"]
    """Goal positions in metres."""
    target: Float32[np.ndarray, "A 2"]
    """Where each person walks to now, in metres: its via point, if not yet visited, or its goal."""
    speed: Float32[np.ndarray, " A"]
    """Preferred speeds in m/s."""
    group: Int[np.ndarray, " A"]
    """Group in its world that each person walks with; −1 if alone."""
    wider: Float32[np.ndarray, " A"]
    """By how much each radius exceeds that of a person, in metres: 0 for people, more for a robot
    in the crowd."""

    @classmethod
    def of(cls, simulation: Simulation) -> "StateView":
        """View of everyone present, ordered by world, then slot."""
        slots = simulation.slots
        at = np.flatnonzero(slots.alive)  # indexing by one array is faster than by two
        world, slot = np.divmod(at, slots.alive.shape[1])
        numbers = ("person", "event", "speed", "wider")
        points = ("position", "velocity", "goal", "target")
        event = slots.event.ravel().take(at)
        return cls(
            world=world,
            slot=slot,
            frame=simulation.clock.frame.take(world),
            group=simulation.queue.group[world, event],
            **{name: getattr(slots, name).ravel().take(at) for name in numbers},
            **{name: getattr(slots, name).reshape(-1, 2).take(at, axis=0) for name in points},
        )

    def towards(self, routes: Routes) -> Float[np.ndarray, "A 2"]:
        """Next point on each person's shortest path to its target around walls, in metres."""
        return routes.next_of(self.world, self.slot, self.position, self.target)[0]

    def wanted_mps(self, dt_s: float) -> Float[np.ndarray, " A"]:
        """Preferred speeds; people who go to a via point stay there until their wait is over."""
        speed = self.speed.astype(np.float64)
        visits = (self.target != self.goal).any(axis=1)
        rest = np.linalg.norm(self.target - self.position, axis=1) / dt_s
        speed[visits] = np.minimum(speed, rest)[visits]
        return speed


class _Named(Protocol):
    @property
    def name(self) -> str:
        """Name of the policy in tables."""
        ...

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode; all random draws must use `rng`."""
        ...


@runtime_checkable  # tests check annotations at run time
class ObservationPolicy(_Named, Protocol):
    """A policy that sees the observations of the environments."""

    sees: ClassVar[Literal["observation"]]

    def act(self, seen: Float32[np.ndarray, "A obs"]) -> Float32[np.ndarray, "A 2"]:
        """Actions for the given observations, one per person."""
        ...


@runtime_checkable
class RememberingPolicy(_Named, Protocol):
    """A policy that remembers people or is given random numbers.

    It has one of the attributes `memory`, the size of a person's state, `style`, the number of
    random numbers that are drawn once per person, and `noise`, the number of those that are drawn
    for each decision; they are 0 if missing.
    """

    sees: ClassVar[Literal["observation"]]

    def act(self, seen: Float32[np.ndarray, "A obs"], memory: Memory) -> Float32[np.ndarray, "A 2"]:
        """Actions for the given observations; the next states are written to `memory.state`."""
        ...


@runtime_checkable
class StatePolicy(_Named, Protocol):
    """A policy that sees the state; the leaderboard marks it as privileged."""

    sees: ClassVar[Literal["state"]]

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions for everyone present, in the order of the view."""
        ...


Policy = ObservationPolicy | RememberingPolicy | StatePolicy
"""A policy maps a batch of observations, or the state, to a batch of actions.

An action is a velocity in units of the scene's `max_speed_mps`. Components outside [−1, 1] are
clipped, as in the environments. The actions of a policy that sees observations are in the frame of
its observation, those of a policy that sees the state in the world frame.

A policy without random draws may have the attribute `deterministic = True`. With recorded arrivals,
a single rollout of it is then sufficient. A policy with the attribute `interval = k` decides in
each k-th frame of a person's trip; in between, the person keeps its velocity.

A class with the attribute `many_worlds = True`, which subclasses do not inherit, treats all persons
alike, whatever their world, and draws no random numbers itself. Several rollouts then call it
together, which is faster.
"""
