"""A crowd in PySocialForce, whose extended social force model knows companions.

It follows Moussaïd et al. (2010), The walking behaviour of pedestrian social groups and its impact
on crowd dynamics.
"""

import logging
import math
import tempfile
from collections.abc import Mapping, Sequence
from contextlib import chdir
from typing import Literal

import numpy as np
from jaxtyping import Float

from crowdbench.scene import Scene

from .adapter import Newcomer, steps_of

_root = logging.getLogger()
_level, _handlers = _root.level, list(_root.handlers)
# On import, it lets every library print its debugging messages, and write them into file.log here.
logging.disable()
with tempfile.TemporaryDirectory() as _elsewhere, chdir(_elsewhere):
    import pysocialforce
    from pysocialforce.forces import camel_to_snake
logging.disable(logging.NOTSET)
for _added in [handler for handler in _root.handlers if handler not in _handlers]:
    _root.removeHandler(_added)
    _added.close()
_root.setLevel(_level)

LONGEST_STEP_S = 0.1
"""Longest step. The one of PySocialForce, 0.4 s, is nearly its relaxation time of 0.5 s."""
AHEAD_M = 5.0
"""PySocialForce stops people 0.5 m before their targets, so theirs are at least this far ahead."""
TAU_S = 0.5
SHORTEST_M = 0.1
SAME_M, BESIDE_M = 0.01, 0.05
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class PySocialForceCrowd:
    """One world in PySocialForce."""

    def __init__(self, scene: Scene, parameters: Mapping[str, float]) -> None:
        # PySocialForce represents walls by points 0.1 m apart, shorter ones by none.
        long = [
            of for of in scene.wall_segments.tolist() if math.dist(of[:2], of[2:]) >= SHORTEST_M
        ]
        walls = [(a, c, b, d) for a, b, c, d in long]
        self._simulator = pysocialforce.Simulator(np.zeros((1, 6)), obstacles=walls)
        self._steps = steps_of(scene.dt_s, LONGEST_STEP_S)
        self._simulator.peds.step_width = scene.dt_s / self._steps
        for name, value in parameters.items():
            self._set(name, value)
        self._persons: list[int] = []
        self._group: dict[int, int] = {}
        self._state = np.zeros((0, 7))  # position, velocity, target, relaxation time
        self._speed = np.zeros(0)

    def enter(self, newcomer: Newcomer) -> Literal["entered", "moved", "refused"]:
        """Take a person in; nobody is refused.

        The forces between people at the same place are no numbers, so a person enters beside.
        """
        place = np.array(newcomer.position)
        same = np.linalg.norm(self._state[:, :2] - place, axis=1) < SAME_M
        if same.any():
            angle = GOLDEN_ANGLE * newcomer.person
            place += BESIDE_M * np.array([np.cos(angle), np.sin(angle)])
        row = [*place, *newcomer.velocity, *newcomer.target, TAU_S]
        self._state = np.vstack([self._state, row])
        self._speed = np.append(self._speed, newcomer.speed_mps)
        self._persons.append(newcomer.person)
        self._group[newcomer.person] = newcomer.group
        return "moved" if same.any() else "entered"

    def leave(self, person: int) -> None:
        """Take a person out."""
        at = self._persons.index(person)
        del self._persons[at], self._group[person]
        self._state, self._speed = np.delete(self._state, at, 0), np.delete(self._speed, at)

    def steer(
        self,
        persons: Sequence[int],
        target: Float[np.ndarray, "n 2"],
        speed_mps: Float[np.ndarray, " n"],
    ) -> None:
        """Set the targets and the desired speeds."""
        at = self._at(persons)
        way = target - self._state[at, :2]
        length = np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
        self._state[at, 4:6] = self._state[at, :2] + way * np.maximum(1.0, AHEAD_M / length)
        self._speed[at] = speed_mps

    def advance(self) -> Sequence[int]:
        """Simulate a frame."""
        if not self._persons:
            return []
        people = self._simulator.peds
        people.ped_states, people.group_states = [], []
        # The desired speed of PySocialForce is a multiple of the initial speed.
        people.initial_speeds = self._speed / people.max_speed_multiplier
        people.update(self._state, self._companions())
        with np.errstate(divide="ignore", invalid="ignore"):  # of people who stand
            self._simulator.step(self._steps)
        self._state = people.state.copy()
        lost = np.flatnonzero(~np.isfinite(self._state[:, :4]).all(axis=1))
        escaped = [self._persons[k] for k in lost.tolist()]
        for person in escaped:
            self.leave(person)
        return escaped

    def positions(self, persons: Sequence[int]) -> Float[np.ndarray, "n 2"]:
        """Where people are."""
        return self._state[self._at(persons), :2]

    def _at(self, persons: Sequence[int]) -> list[int]:
        at = {person: k for k, person in enumerate(self._persons)}
        return [at[person] for person in persons]

    def _companions(self) -> list[list[int]]:
        groups: dict[int, list[int]] = {}
        for k, person in enumerate(self._persons):
            if self._group[person] >= 0:
                groups.setdefault(self._group[person], []).append(k)
        return [group for group in groups.values() if len(group) > 1]

    def _set(self, name: str, value: float) -> None:
        """Set a parameter of a force, such as `social_force.factor`."""
        section, _, key = name.partition(".")
        (force,) = (
            of for of in self._simulator.forces if camel_to_snake(type(of).__name__) == section
        )
        force.config.config[key] = value
        if key == "factor":
            force.factor = value
