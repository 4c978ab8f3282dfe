"""Simple policies: `straight`, `random` and `replay`."""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.policies.policy import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes


class Straight:
    """Walks on the shortest path to the target at the preferred speed and ignores other people.

    At a via point it stands still until the wait is over.
    """

    name = "straight"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True
    many_worlds: ClassVar[bool] = True

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`; there are no random draws."""
        self._scene = scene
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) along the shortest path, at most up to the next corner or the target."""
        way = seen.towards(self._routes).astype(np.float32) - seen.position
        distance = np.sqrt(way[:, 0] * way[:, 0] + way[:, 1] * way[:, 1])
        speed = np.minimum(seen.speed, distance / np.float32(self._scene.dt_s))
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        return way * scale[:, None] / np.float32(self._scene.motion.max_speed_mps)


class Random:
    """Draws each action uniformly from the action space."""

    name = "random"
    sees: ClassVar[Literal["state"]] = "state"  # unused, but avoids the computation of rays

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode whose actions are drawn from `rng`."""
        self._rng = rng

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Random actions (A, 2)."""
        return self._rng.uniform(-1, 1, (len(seen.slot), 2)).astype(np.float32)


class ReplayPolicy:
    """Moves each recorded person along its recorded path; needs the spawn model `replay`."""

    name = "replay"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True

    def __init__(self, recording: Trajectories) -> None:
        self.recording = recording

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode; there are no random draws."""
        self._scene = scene

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) to the recorded positions in the next frame.

        Raises:
            SettingError: the arrivals are not those of the recording.
        """
        crowd = self.recording
        if len(seen.event) and seen.event.max() >= len(crowd):
            got = "arrivals of another model"
            raise SettingError(f"policy {self.name}", got=got, expected="the spawn model replay")
        row = crowd.offsets[seen.event] + (seen.frame + 1 - crowd.first[seen.event])
        row = np.clip(row, crowd.offsets[seen.event], crowd.offsets[seen.event + 1] - 1)
        step = (crowd.xy[row].astype(np.float64) - seen.position) / self._scene.dt_s
        return (step / self._scene.motion.max_speed_mps).astype(np.float32)


class RecordedPaths(ReplayPolicy):
    """Moves people along their recorded paths, but their trips end as with all other policies.

    It shows what a perfect walker scores under the rules of the simulation. People whose recorded
    path leads through a wall walk around it. Needs the spawn model `replay`.
    """

    name = "recorded-paths"

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`; there are no random draws."""
        super().reset(scene, rng)
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) to the recorded positions in the next frame, or to the goal after the end.

        Raises:
            SettingError: the arrivals are not those of the recording.
        """
        step_m = super().act(seen) * np.float64(self._scene.motion.max_speed_mps * self._scene.dt_s)
        over = seen.frame >= self.recording.last[seen.event]
        point = np.where(over[:, None], seen.goal, seen.position + step_m)
        point = self._routes.next_of(seen.world, seen.slot, seen.position, point)[0]
        way = (point - seen.position) / self._scene.dt_s
        return (way / self._scene.motion.max_speed_mps).astype(np.float32)
