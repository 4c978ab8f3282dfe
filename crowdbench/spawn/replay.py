"""`replay`: people enter at the recorded times and places."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.recorded_plans import places_of, plans_of


@dataclass(frozen=True, eq=False)
class Replay:
    """The arrivals of a recording, with the recorded goals, companions, stops and speeds.

    `recording` is one of `recording_of`. A person's via point is the place of its longest stop, and
    its preferred speed does not contain standing; see `plans_of`. People whose record was cut off
    (`left` is False) are removed at its last frame.
    """

    recording: Trajectories
    name: str = "replay"
    start: ClassVar[Start] = "recorded"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """The recorded events in [0, `horizon_s`); `rng` is not used."""
        crowd = self.recording
        if not np.isclose(crowd.dt_s, scene.dt_s):
            got = f"a recording of {crowd.scene} with frames of {crowd.dt_s:g} s"
            expected = f"frames of {scene.dt_s:g} s, as in {scene.id}"
            raise SettingError("replay", got=got, expected=expected)
        first_row = crowd.offsets[:-1]
        second_row = np.minimum(first_row + 1, crowd.offsets[1:] - 1)
        velocity = (crowd.xy[second_row] - crowd.xy[first_row]) / scene.dt_s
        plans = plans_of(crowd)
        walking = plans.speed[np.isfinite(plans.speed)]
        usual = float(np.median(walking)) if len(walking) else 0.0
        start, goal, via = places_of(crowd, scene)
        speed = np.minimum(np.nan_to_num(plans.speed, nan=usual), scene.motion.max_speed_mps)
        events = SpawnEvents(
            time_s=crowd.requested_s,
            start=start.astype(np.float32),
            goal=goal.astype(np.float32),
            spawn_area=crowd.spawn_area,
            goal_area=crowd.goal_area,
            speed=speed.astype(np.float32),
            velocity=velocity.astype(np.float32),
            entered=crowd.entered,
            leave_frame=np.where(crowd.left, -1, crowd.last),
            scripted=np.zeros(len(crowd), dtype=bool),
            censored=~crowd.left,
            group=crowd.group,
            via=via.astype(np.float32),
            wait_s=plans.wait_s,
        )
        return events[events.time_s < horizon_s - 1e-9]

    def scripted(self, events: SpawnEvents) -> SpawnEvents:
        """The events of `sample`, but everyone starts at the recorded place, even in a wall.

        Everyone leaves exactly at the last recorded frame.
        """
        return replace(
            events,
            start=self.recording.start[: len(events)],
            leave_frame=self.recording.last[: len(events)],
            scripted=np.ones(len(events), dtype=bool),
        )
