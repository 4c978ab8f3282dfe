"""`replay`: the recorded people enter when and where they did."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.trajectories.table import Trajectories


@dataclass(frozen=True, eq=False)
class Replay:
    """The arrivals of a recording, each person walking to where its record ends.

    People whose record was cut off (`left` is False) are taken away at its last frame.
    """

    recording: Trajectories
    name: str = "replay"
    start: ClassVar[Start] = "recorded"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """The recorded events in [0, `horizon_s`); `rng` is not used."""
        crowd = self.recording
        if not np.isclose(crowd.dt_s, scene.dt_s):
            raise SettingError(
                "replay",
                got=f"a recording of {crowd.scene} with frames of {crowd.dt_s:g} s",
                expected=f"frames of {scene.dt_s:g} s, as in {scene.id}",
            )
        first_row = crowd.offsets[:-1]
        second_row = np.minimum(first_row + 1, crowd.offsets[1:] - 1)
        velocity = (crowd.xy[second_row] - crowd.xy[first_row]) / scene.dt_s
        speed = np.nan_to_num(crowd.mean_speeds(), nan=0.0)
        events = SpawnEvents(
            time_s=crowd.requested_s,
            start=_walkable(crowd.start, scene),
            goal=_walkable(crowd.end, scene),
            spawn_area=crowd.spawn_area,
            goal_area=crowd.goal_area,
            speed=speed.astype(np.float32),
            velocity=velocity.astype(np.float32),
            entered=crowd.entered,
            leave_frame=np.where(crowd.left, -1, crowd.last),
            scripted=np.zeros(len(crowd), dtype=bool),
            censored=~crowd.left,
        )
        return events[events.time_s < horizon_s - 1e-9]

    def scripted(self, events: SpawnEvents) -> SpawnEvents:
        """The events of `sample`, everyone leaving at its recorded last frame and no earlier."""
        return replace(
            events,
            start=self.recording.start[: len(events)],
            leave_frame=self.recording.last[: len(events)],
            scripted=np.ones(len(events), dtype=bool),
        )

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Replay is no distribution.

        Raises:
            SettingError: always.
        """
        raise SettingError(
            "replay", got="a request for a likelihood", expected="a model that has one"
        )


def _walkable(points: Float32[np.ndarray, "P 2"], scene: Scene) -> Float32[np.ndarray, "P 2"]:
    """Where someone was recorded in a wall, the nearest place where a policy can walk."""
    return scene.nearest_walkable(points.astype(np.float64)).astype(np.float32)
