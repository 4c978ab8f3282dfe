"""What recorded people do next, as an action in the simulation."""

from dataclasses import dataclass
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32, Int
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.policies import StateView
from crowdbench.scene import Scene


@dataclass(frozen=True, eq=False)
class RecordedContinuation:
    """Leads people straight to their recorded positions at their next decisions.

    A person decides in its first frame and in each `interval`-th frame after it. Where its record
    ends in between, the person is led to its last position in the frames that are left.

    It is also the policy that moves everyone along the recorded paths; like `ReplayPolicy`, it
    needs the spawn model `replay`.
    """

    recording: Trajectories
    max_speed_mps: float
    interval: int = 1
    """Number of frames between two decisions."""
    name: ClassVar[str] = "recorded-continuation"
    sees: ClassVar[Literal["state"]] = "state"

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Begin an episode; there are no random draws."""

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Actions (A, 2) with which everyone is at its recorded position at its next decision."""
        return self.action(seen.event, seen.frame, seen.position)

    def row(
        self, person: Int[np.ndarray, " n"], frame: int | Int[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """Row of `recording.xy` of each person in a frame; its last row after its end."""
        return self._at(person, frame - self.recording.first[person])

    def following(
        self, person: Int[np.ndarray, " n"], frame: int | Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Row of each person at its next decision after a frame, and the frames until then.

        After the end of its record, these are its last row and 1.
        """
        age = frame - self.recording.first[person]
        row = self._at(person, (age // self.interval + 1) * self.interval)
        return row, np.maximum(row - self._at(person, age), 1)

    def action(
        self,
        person: Int[np.ndarray, " n"],
        frame: int | Int[np.ndarray, " n"],
        position: Float[np.ndarray, "n 2"],
        aside: Float[np.ndarray, "n 2"] | float = 0.0,
    ) -> Float32[np.ndarray, "n 2"]:
        """Action in the world frame that leads from a position to that at the next decision.

        `aside` is added to the recorded position, metres. Actions are not clipped: those of people
        who are too far away to get there in time are beyond the maximum speed.
        """
        row, frames = self.following(person, frame)
        way = self.recording.xy[row].astype(np.float64) + aside - position
        way /= self.recording.dt_s * frames[:, None]
        return (way / self.max_speed_mps).astype(np.float32)

    def deviation_m(
        self,
        person: Int[np.ndarray, " n"],
        frame: int | Int[np.ndarray, " n"],
        position: Float[np.ndarray, "n 2"],
    ) -> Float32[np.ndarray, " n"]:
        """Distance of positions from the recorded ones, in metres."""
        off = position - self.recording.xy[self.row(person, frame)]
        return np.hypot(*off.T).astype(np.float32)

    def _at(
        self, person: Int[np.ndarray, " n"], age: Int[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        offsets = self.recording.offsets
        return np.minimum(offsets[person] + age, offsets[person + 1] - 1)
