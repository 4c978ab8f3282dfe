"""`PeerPolicy`: lets another simulator walk the people of crowdbench.

crowdbench keeps the rules that are the same for everyone: who enters when and where, via points
and waits, when a trip ends, and what the time of a frame is. The other simulator (a `Crowd`) moves
people from one frame to the next, in steps of its own. Its positions become crowdbench's; what
could not be done as asked is counted in `PeerPolicy.counts`, by the names in `COUNTED`.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil
from typing import ClassVar, Literal, Protocol

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench.policies import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes

COUNTED = {
    "entered": "people whom the simulator took in",
    "moved": "people whom it took in at another place, because a wall or others are too near",
    "waited": "people who stood at their start until it took them in, because others were too near",
    "refused": "people whom it never took in",
    "stood": "frames in which somebody stood who was taken out and could not be put in again",
    "put back": "times that somebody was taken out and put in again, because walls, bodies or the "
    "highest speed of the scene did not allow the simulator's position",
    "escaped": "times that somebody was taken out, because the simulator had lost its way: it "
    "stopped with an error, or its position was no number",
}
"""What is counted, by name."""
APART_M = 0.02
"""Difference of positions above which a person is put back."""


@dataclass(frozen=True)
class Newcomer:
    """A person who is to enter, at a position with a velocity; see `Crowd.enter`."""

    person: int
    position: tuple[float, float]
    velocity: tuple[float, float]
    target: tuple[float, float]
    speed_mps: float
    """Preferred speed."""
    group: int
    """Number of its companions' group; −1 if alone."""
    beside: bool
    """Whether it may enter beside its position, because it has waited as long as people wait."""


class Crowd(Protocol):
    """The people of one world in another simulator. Lengths are in metres, times in seconds."""

    def enter(self, newcomer: Newcomer) -> Literal["entered", "moved", "refused"]:
        """Take a person in, if need be at another place; or refuse it for now."""
        ...

    def leave(self, person: int) -> None:
        """Take a person out."""
        ...

    def steer(
        self,
        persons: Sequence[int],
        target: Float[np.ndarray, "n 2"],
        speed_mps: Float[np.ndarray, " n"],
    ) -> None:
        """Tell people where they walk to now, around walls, and how fast; 0 is to stand."""
        ...

    def advance(self) -> Sequence[int]:
        """Simulate a frame; returns those who escaped, who are no longer inside."""
        ...

    def positions(self, persons: Sequence[int]) -> Float[np.ndarray, "n 2"]:
        """Where people are."""
        ...


class PeerPolicy:
    """A policy that walks people with another simulator.

    A subclass has a `name` and makes an empty `crowd` for a scene.
    """

    name: str
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True

    def crowd(self, scene: Scene) -> Crowd:
        """An empty crowd on a scene."""
        raise NotImplementedError

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin with empty worlds; there are no random draws."""
        self._scene = scene
        self._routes = Routes.on(scene)
        self._worlds: dict[int, _World] = {}

    @property
    def counts(self) -> dict[str, int]:
        """How often each of `COUNTED` occurred since `reset`."""
        total = sum((world.counts for world in self._worlds.values()), Counter())
        for world in self._worlds.values():
            total["refused"] += len(world.waiting.keys() - world.known)
        return {name: total[name] for name in COUNTED}

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocities (A, 2) over the frame, in units of the maximum speed."""
        motion, dt_s = self._scene.motion, self._scene.dt_s
        target, speed = seen.towards(self._routes), seen.wanted_mps(dt_s)
        moved = np.zeros((len(speed), 2))
        for world in np.unique(seen.world).tolist():
            here = np.flatnonzero(seen.world == world)
            if world not in self._worlds:
                patience = self._scene.frames(self._scene.spawning.patience_s)
                self._worlds[world] = _World(self.crowd(self._scene), patience)
            moved[here] = self._worlds[world].walk(
                seen.event[here].tolist(),
                seen.position[here].astype(np.float64),
                seen.velocity[here].astype(np.float64),
                target[here].astype(np.float64),
                speed[here],
                seen.speed[here].astype(np.float64),
                seen.group[here],
            )
        # Components are clipped to [−1, 1] one by one, so a longer step is shortened as a whole.
        most_m = motion.max_speed_mps * dt_s
        length = np.linalg.norm(moved, axis=1, keepdims=True)
        return (moved / np.maximum(length, most_m)).astype(np.float32)


class _World:
    """One world: who is inside the other simulator, and who waits to be taken in."""

    def __init__(self, crowd: Crowd, patience: int) -> None:
        self.crowd, self.patience = crowd, patience
        self.counts: Counter[str] = Counter()
        self.inside: set[int] = set()
        self.waiting: Counter[int] = Counter()
        """Number of frames that people have waited."""
        self.known: set[int] = set()
        """Those who were taken in before."""

    def walk(
        self,
        persons: list[int],
        position: Float[np.ndarray, "n 2"],
        velocity: Float[np.ndarray, "n 2"],
        target: Float[np.ndarray, "n 2"],
        speed: Float[np.ndarray, " n"],
        preferred: Float[np.ndarray, " n"],
        group: Int[np.ndarray, " n"],
    ) -> Float[np.ndarray, "n 2"]:
        """Displacements in a frame, metres; people who were not taken in stand."""
        crowd, present = self.crowd, set(persons)
        left = sorted(self.inside - present)
        for person in left:
            crowd.leave(person)
        self.inside &= present
        for person in self.waiting.keys() - present:
            self.counts["refused"] += person not in self.known
            del self.waiting[person]
        self._put_back(persons, position)
        for k, person in enumerate(persons):
            if person not in self.inside:
                where, going = tuple(position[k].tolist()), tuple(velocity[k].tolist())
                to = tuple(target[k].tolist())
                fast, of = float(preferred[k]), int(group[k])
                beside = self.waiting[person] >= self.patience
                self._take_in(Newcomer(person, where, going, to, fast, of, beside))
        moved = np.zeros_like(position)
        walking = [k for k, person in enumerate(persons) if person in self.inside]
        if not walking and not left:
            return moved
        if walking:
            crowd.steer([persons[k] for k in walking], target[walking], speed[walking])
        # Even if nobody is inside: some simulators take people out when they go on.
        escaped = set(crowd.advance())
        self.counts["escaped"] += len(escaped)
        self.inside -= escaped
        walking = [k for k in walking if persons[k] in self.inside]
        if walking:
            moved[walking] = crowd.positions([persons[k] for k in walking]) - position[walking]
        return moved

    def _put_back(self, persons: list[int], position: Float[np.ndarray, "n 2"]) -> None:
        walking = [k for k, person in enumerate(persons) if person in self.inside]
        if not walking:
            return
        theirs = self.crowd.positions([persons[k] for k in walking])
        off = np.linalg.norm(theirs - position[walking], axis=1) > APART_M
        for k in np.asarray(walking)[off].tolist():
            self.crowd.leave(persons[k])
            self.inside.discard(persons[k])
            self.counts["put back"] += 1

    def _take_in(self, newcomer: Newcomer) -> None:
        person = newcomer.person
        answer = self.crowd.enter(newcomer)
        if answer == "refused":
            self.waiting[person] += 1
            self.counts["stood"] += person in self.known
            return
        self.inside.add(person)
        if person not in self.known:  # who is put back is counted
            self.counts[answer] += 1
            self.counts["waited"] += person in self.waiting
        self.known.add(person)
        del self.waiting[person]


def steps_of(dt_s: float, longest_s: float) -> int:
    """The smallest number of equal steps in a frame that are no longer than `longest_s`."""
    return max(1, ceil(dt_s / longest_s - 1e-9))
