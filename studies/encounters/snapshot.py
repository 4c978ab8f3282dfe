"""The people of a recording from a moment on, as a spawn model."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Int
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.recorded_plans import plans_of


@dataclass(frozen=True, eq=False)
class Snapshot:
    """People who are there in a frame, and those who enter after it, with what they still plan.

    People who are there begin at their recorded position and velocity. Stops that are over are left
    out, and the one that somebody stands in has its remaining time.
    """

    events: SpawnEvents
    person: Int[np.ndarray, " E"]
    """Index of the person in the recording."""
    name: str = "snapshot"
    start: ClassVar[Start] = "recorded"

    @classmethod
    def of(
        cls, scene: Scene, crowd: Trajectories, events: SpawnEvents, first: int, stop: int
    ) -> "Snapshot":
        """The people of a recording in frames [first, stop).

        `events` are those of its replay, one per person and in the same order. People who are
        recorded in a wall begin at the nearest place where they can walk.
        """
        person = np.flatnonzero((crowd.first < stop) & (crowd.last >= first))
        here = crowd.first[person] <= first
        chosen = events[person]
        row = crowd.offsets[person] + np.maximum(first - crowd.first[person], 0)
        after = np.minimum(row + 1, crowd.offsets[person + 1] - 1)
        velocity = (crowd.xy[after] - crowd.xy[row]) / crowd.dt_s
        begins = scene.nearest_walkable(crowd.xy[row].astype(np.float64))
        resumed = plans_of(crowd).resumed[person] - row  # in frames from now on
        over = here & (resumed <= 0)
        left_s = np.maximum(resumed, 0) * crowd.dt_s
        wait_s = np.where(here, np.minimum(chosen.wait_s, left_s), chosen.wait_s)
        found = replace(
            chosen,
            time_s=np.where(here, 0.0, chosen.time_s - first * crowd.dt_s),
            start=np.where(here[:, None], begins, chosen.start).astype(np.float32),
            velocity=np.where(here[:, None], velocity, chosen.velocity).astype(np.float32),
            entered=~here,
            leave_frame=np.where(chosen.leave_frame < 0, -1, chosen.leave_frame - first),
            via=np.where(over[:, None], np.nan, chosen.via).astype(np.float32),
            wait_s=np.where(over, 0.0, wait_s),
        )
        order = np.argsort(found.time_s, kind="stable")
        return cls(found[order], person[order])

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """The people who are there or enter in [0, `horizon_s`); `rng` is not used."""
        return self.events[self.events.time_s < horizon_s]
