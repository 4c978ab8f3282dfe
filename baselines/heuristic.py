"""A policy with simple rules, as an example of a custom policy.

It uses only the observations of an agent: `crowdbench evaluate eth-v0 --policy
crowdbench.baselines.heuristic:Heuristic`. The rules are those of Moussaïd, Helbing & Theraulaz
(2011), How simple rules determine pedestrian behavior, PNAS 108, 6884: walk in the direction that
leads closest to the goal without a collision, and only so fast that there is time to stop.
"""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.simulation.observations import (
    GOAL_DISTANCE,
    GOAL_RANGE_M,
    OBSERVATION,
    PREFERRED_SPEED,
    head_of,
)

HEAD = head_of(OBSERVATION)
STOPPING_S = 0.5  # τ, eq. 2


class Heuristic:
    """Chooses the best of the ray directions and the goal direction."""

    name = "heuristic"
    observation = OBSERVATION
    sees: ClassVar[Literal["observation"]] = "observation"

    def __init__(self, ray_range_m: float = 10.0) -> None:
        self.ray_range_m = ray_range_m

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the constants of the scene; there are no random draws."""
        self._max_speed = scene.motion.max_speed_mps
        self._radius = scene.motion.person_radius_m

    def act(self, seen: Float32[np.ndarray, "A obs"]) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2), one per observation."""
        to_goal = seen[:, GOAL_DISTANCE] * GOAL_RANGE_M
        goal_angle = np.arctan2(seen[:, 4:5], seen[:, 3:4])
        rays = seen[:, HEAD:] * self.ray_range_m
        spacing = 2 * np.pi / rays.shape[1]

        # People have a width, so a direction is only free as far as its shortest adjacent ray.
        free = np.minimum(rays, np.minimum(np.roll(rays, 1, axis=1), np.roll(rays, -1, axis=1)))
        free = np.maximum(free - self._radius, 0)
        ahead = np.round(goal_angle / spacing).astype(int) % rays.shape[1]
        angle = np.concatenate(
            [goal_angle, np.tile(np.arange(rays.shape[1]), (len(seen), 1)) * spacing], axis=1
        )
        free = np.concatenate([np.take_along_axis(free, ahead, axis=1), free], axis=1)

        # Eq. 1: squared distance to a point in goal direction after walking the free distance.
        horizon = np.minimum(to_goal, self.ray_range_m)
        free = np.minimum(free, horizon)
        missed = horizon**2 + free**2 - 2 * horizon * free * np.cos(goal_angle - angle)
        best = np.argmin(missed, axis=1)[:, None]
        angle = np.take_along_axis(angle, best, axis=1)
        preferred = seen[:, PREFERRED_SPEED] * self._max_speed
        speed = np.minimum(preferred, np.take_along_axis(free, best, axis=1) / STOPPING_S)
        heading = np.concatenate([np.cos(angle), np.sin(angle)], axis=1)
        return (speed * heading / self._max_speed).astype(np.float32)
