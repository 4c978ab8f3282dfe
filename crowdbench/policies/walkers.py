"""The plain walkers: `straight`, `random` and `replay`."""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.errors import SettingError
from crowdbench.policies.policy import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes
from crowdbench.trajectories.table import Trajectories


class Straight:
    """Walks to the goal at the preferred speed, through everyone; straight, or around walls."""

    name = "straight"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Nothing to draw."""
        self._scene = scene
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Along the shortest way, and no further than its next corner or the goal."""
        way = seen.towards(self._routes).astype(np.float32) - seen.position
        distance = np.sqrt(way[:, 0] * way[:, 0] + way[:, 1] * way[:, 1])
        speed = np.minimum(seen.speed, distance / np.float32(self._scene.dt_s))
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        return way * scale[:, None] / np.float32(self._scene.motion.max_speed_mps)


class Random:
    """Draws each action evenly from the action space, and looks at nothing."""

    name = "random"
    sees: ClassVar[Literal["state"]] = "state"  # which costs nothing: rays are cast to be seen

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Draw from `rng` from now on."""
        self._rng = rng

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Independent of what is there."""
        return self._rng.uniform(-1, 1, (len(seen.slot), 2)).astype(np.float32)


class ReplayPolicy:
    """Walks each recorded person along its recorded path; needs recorded arrivals."""

    name = "replay"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True

    def __init__(self, recording: Trajectories) -> None:
        self.recording = recording

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Nothing to draw."""
        self._scene = scene

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """To the position that the record holds for the next frame.

        Raises:
            SettingError: the arrivals are not the recording's.
        """
        crowd = self.recording
        if len(seen.event) and seen.event.max() >= len(crowd):
            raise SettingError(
                "policy replay", got="arrivals of another model", expected="the spawn model replay"
            )
        row = crowd.offsets[seen.event] + (seen.frame + 1 - crowd.first[seen.event])
        row = np.clip(row, crowd.offsets[seen.event], crowd.offsets[seen.event + 1] - 1)
        step = (crowd.xy[row].astype(np.float64) - seen.position) / self._scene.dt_s
        return (step / self._scene.motion.max_speed_mps).astype(np.float32)
