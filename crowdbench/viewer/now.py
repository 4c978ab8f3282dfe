"""The present state of an environment, as it is drawn: people, trails and ended trips."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.run.episode import Recorder

TRAIL_S = 2.0
"""Length of a trail, seconds."""
Past = Sequence[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]
"""Ids and positions of the people present, frame by frame; the present frame is the last."""


@dataclass(frozen=True, eq=False)
class Now:
    """`n` persons of a simulation with one world, including those whose trips have just ended."""

    frame: int
    person_id: Int[np.ndarray, " n"]
    goal_area: Int[np.ndarray, " n"]
    group: Int[np.ndarray, " n"]
    """Group of each person, −1 for people who are alone."""
    xy: Float32[np.ndarray, "n 2"]
    """Positions, metres."""
    target: Float32[np.ndarray, "n 2"]
    """Where each person walks to now, its via point or its goal, metres."""
    trail: Float32[np.ndarray, "n k 2"]
    """Positions in the last frames, metres; the present frame is the last. Frames before a
    person's first one have the person's first position."""
    born: Int[np.ndarray, " n"]
    """Frame in which each person entered."""
    spawned: Bool[np.ndarray, " n"]
    """Whether each person entered in this frame."""
    ended: Int[np.ndarray, " n"]
    """Outcome of trips that ended in this frame, as an index into `OUTCOMES`; 0 for others."""

    @classmethod
    def of(cls, recorder: Recorder, dt_s: float) -> "Now":
        """Read the present state of a recorder's simulation, without changing it."""
        simulation = recorder.simulation
        slots, past = simulation.slots, recorder.latest(trail_steps(dt_s) + 1)
        there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
        person, xy = slots.person[0, there], slots.position[0, there]
        return cls(
            frame=int(simulation.clock.frame[0]),
            person_id=person,
            goal_area=simulation.events[0].goal_area[slots.event[0, there]],
            group=simulation.events[0].group[slots.event[0, there]],
            xy=xy,
            target=slots.target[0, there],
            trail=_trails(person, xy, past),
            born=slots.born[0, there],
            spawned=slots.spawned[0, there],
            ended=slots.ended[0, there],
        )


def trail_steps(dt_s: float) -> int:
    """Length of a trail in steps."""
    return max(1, round(TRAIL_S / dt_s))


def _trails(
    person: Int[np.ndarray, " n"], xy: Float32[np.ndarray, "n 2"], past: Past
) -> Float32[np.ndarray, "n k 2"]:
    trail = np.repeat(xy[:, None], max(1, len(past)), axis=1)
    for k in range(len(past) - 2, -1, -1):  # backwards, to repeat first positions
        ids, there = past[k]
        _, mine, its = np.intersect1d(person, ids, assume_unique=True, return_indices=True)
        trail[:, k] = trail[:, k + 1]
        trail[mine, k] = there[its]
    return trail
