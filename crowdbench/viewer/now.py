"""What an environment shows at this moment: who is there, on which trail, who just ended."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.simulation import Simulation

Past = Sequence[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]
"""Ids and positions of those who were there, frame by frame, the present one last."""


@dataclass(frozen=True, eq=False)
class Now:
    """`n` persons of a one-world simulation, those who have just ended included."""

    frame: int
    person_id: Int[np.ndarray, " n"]
    goal_area: Int[np.ndarray, " n"]
    xy: Float32[np.ndarray, "n 2"]
    """Positions, metres."""
    goal: Float32[np.ndarray, "n 2"]
    """Where each walks to, metres."""
    trail: Float32[np.ndarray, "n k 2"]
    """The positions of the last frames, the present one last; before its first frame a person's
    first position."""
    born: Int[np.ndarray, " n"]
    """Frame of entry."""
    spawned: Bool[np.ndarray, " n"]
    """Who entered in this frame."""
    ended: Int[np.ndarray, " n"]
    """How the life ended that ended in this frame (an index into `OUTCOMES`), 0 for none."""

    @classmethod
    def of(cls, simulation: Simulation, past: Past) -> "Now":
        """Look at a simulation; nothing in it changes."""
        slots = simulation.slots
        there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
        person, xy = slots.person[0, there], slots.position[0, there]
        return cls(
            frame=int(simulation.clock.frame[0]),
            person_id=person,
            goal_area=simulation.events[0].goal_area[slots.event[0, there]],
            xy=xy,
            goal=slots.goal[0, there],
            trail=_trails(person, xy, past),
            born=slots.born[0, there],
            spawned=slots.spawned[0, there],
            ended=slots.ended[0, there],
        )


def _trails(
    person: Int[np.ndarray, " n"], xy: Float32[np.ndarray, "n 2"], past: Past
) -> Float32[np.ndarray, "n k 2"]:
    trail = np.repeat(xy[:, None], max(1, len(past)), axis=1)
    earlier = xy
    for k in range(len(past) - 2, -1, -1):  # backwards: who was not there stays where it began
        where = {int(p): i for i, p in enumerate(past[k][0])}
        at = np.array([where.get(p, -1) for p in person.tolist()], dtype=np.int64)
        known = np.where((at < 0)[:, None], earlier, past[k][1][at] if len(where) else earlier)
        trail[:, k] = earlier = known
    return trail
