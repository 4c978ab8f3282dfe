"""Policies that do not walk like people, but that a weak metric takes for people."""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench.policies import StateView, Straight
from crowdbench.scene import Scene

RUNNING = 1.7
"""Speed of runners as a multiple of the preferred speed."""
CREEPING_MPS = 0.2
NEAR_M = 2.0
WANDER_MPS = 0.25
"""Standard deviation of each component of a wanderer's velocity."""
MEMORY = 0.8
"""Autocorrelation of a wanderer's velocity from one frame to the next."""


class Runner(Straight):
    """Straight walkers at 1.7 times their preferred speed."""

    name = "runner"

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) of straight walkers, but faster."""
        way = seen.towards(self._routes).astype(np.float32) - seen.position
        distance = np.sqrt((way * way).sum(axis=1))
        speed = np.minimum(RUNNING * seen.speed, distance / np.float32(self._scene.dt_s))
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        return way * scale[:, None] / np.float32(self._scene.motion.max_speed_mps)


class Creeper(Straight):
    """Straight walkers who creep at 0.2 m/s while somebody is within 2 m, friend or stranger."""

    name = "creeper"

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) of straight walkers, slower near others."""
        actions = super().act(seen)
        gap = np.hypot(*(seen.position[:, None] - seen.position).transpose(2, 0, 1))
        gap[seen.world[:, None] != seen.world] = np.inf
        np.fill_diagonal(gap, np.inf)
        near = gap.min(axis=1, initial=np.inf) < NEAR_M
        speed = np.hypot(*actions.T) * self._scene.motion.max_speed_mps
        limit = np.divide(CREEPING_MPS, speed, out=np.ones_like(speed), where=speed > 0)
        return np.where(near, np.minimum(1, limit), 1)[:, None].astype(np.float32) * actions


class Wanderer(Straight):
    """Straight walkers with a random velocity in addition, an AR(1) process per person.

    With a `memory` of 0 it is white noise. People who stand are left alone.
    """

    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = False

    def __init__(self, name: str, sd_mps: tuple[float, float], memory: float = 0.0) -> None:
        self.name = name
        self._sd = np.array(sd_mps)
        self._memory = memory

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode whose noise is drawn from `rng`."""
        super().reset(scene, rng)
        self._rng = rng
        self._person: Int[np.ndarray, " _"] = np.empty(0, np.int64)
        self._offset: Float[np.ndarray, "_ 2"] = np.empty((0, 2))

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) of straight walkers plus noise along and across them."""
        most = self._scene.motion.max_speed_mps
        velocity = super().act(seen).astype(np.float64) * most
        size = max(len(self._person), int(seen.slot.max(initial=-1)) + 1)
        person, offset = np.full(size, -1, np.int64), np.zeros((size, 2))
        person[: len(self._person)], offset[: len(self._person)] = self._person, self._offset
        noise = self._rng.standard_normal((len(seen.slot), 2))
        known = (person[seen.slot] == seen.person)[:, None]
        kept = self._memory * offset[seen.slot] + np.sqrt(1 - self._memory**2) * noise
        offset[seen.slot] = np.where(known, kept, noise)
        person[seen.slot] = seen.person
        self._person, self._offset = person, offset
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        along = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 0)
        across = np.stack([-along[:, 1], along[:, 0]], axis=1)
        wander = offset[seen.slot] * self._sd
        velocity += wander[:, :1] * along + wander[:, 1:] * across
        return (velocity / most).astype(np.float32)
