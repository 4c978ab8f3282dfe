"""The arrays of a simulation, in bundles that the compiled kernels take."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from crowdbench.spawn.events import SpawnEvents

GOAL, EXIT, TIMEOUT, RECORDED, HORIZON = 1, 2, 3, 4, 5  # indices into trajectories.OUTCOMES
TERMINAL = (GOAL, EXIT, RECORDED)
"""Outcomes that terminate a life; a timeout and the horizon truncate it."""
PENDING, ENTERED, DROPPED = 0, 1, 2  # what became of an event


class Slots(NamedTuple):
    """State per slot, each array (W, N) or (W, N, 2)."""

    alive: np.ndarray
    """There after this step."""
    ended: np.ndarray
    """How the life ended that ended in this step, 0 for none; the slot is free in the next."""
    spawned: np.ndarray
    """Entered in this step."""
    hit_wall: np.ndarray
    """Met a wall in this step."""
    position: np.ndarray
    velocity: np.ndarray
    """Displacement of this step divided by dt."""
    goal: np.ndarray
    speed: np.ndarray
    """Preferred speed."""
    person: np.ndarray
    """Person id, −1 where nobody has been yet."""
    event: np.ndarray
    """Index of the person's event."""
    born: np.ndarray
    """Frame of entry."""
    leave: np.ndarray
    """Frame at which the person is taken away, −1 for never."""
    scripted: np.ndarray
    """Leaves at that frame and for no other reason."""

    @classmethod
    def empty(cls, worlds: int, size: int) -> "Slots":
        """No one anywhere."""
        shape = (worlds, size)
        return cls(
            alive=np.zeros(shape, np.bool_),
            ended=np.zeros(shape, np.int8),
            spawned=np.zeros(shape, np.bool_),
            hit_wall=np.zeros(shape, np.bool_),
            position=np.zeros((*shape, 2), np.float32),
            velocity=np.zeros((*shape, 2), np.float32),
            goal=np.zeros((*shape, 2), np.float32),
            speed=np.zeros(shape, np.float32),
            person=np.full(shape, -1, np.int32),
            event=np.full(shape, -1, np.int32),
            born=np.zeros(shape, np.int32),
            leave=np.full(shape, -1, np.int32),
            scripted=np.zeros(shape, np.bool_),
        )


class Queue(NamedTuple):
    """The events of each world, padded to (W, E), and what became of them."""

    due: np.ndarray
    """(W, E) first frame at or after the event's time; padding is never due."""
    start: np.ndarray
    goal: np.ndarray
    speed: np.ndarray
    velocity: np.ndarray
    waits: np.ndarray
    """(W, E) whether the event may wait for free space."""
    leave: np.ndarray
    """(W, E) frame at which the person is taken away, −1 for never."""
    scripted: np.ndarray
    status: np.ndarray
    """(W, E) PENDING, ENTERED or DROPPED."""

    @classmethod
    def of(cls, events: Sequence[SpawnEvents], dt_s: float) -> "Queue":
        """Pad and stack the events of each world."""
        size = max(1, *(len(e) for e in events))

        def stacked(arrays: list[np.ndarray], fill: float, kind: type) -> np.ndarray:
            out = np.full((len(arrays), size, *arrays[0].shape[1:]), fill, dtype=kind)
            for w, array in enumerate(arrays):
                out[w, : len(array)] = array
            return out

        never = np.iinfo(np.int32).max
        due = [np.clip(np.ceil(e.time_s / dt_s - 1e-6), -never, never) for e in events]
        return cls(
            due=stacked(due, never, np.int32),
            start=stacked([e.start for e in events], 0, np.float32),
            goal=stacked([e.goal for e in events], 0, np.float32),
            speed=stacked([e.speed for e in events], 0, np.float32),
            velocity=stacked([e.velocity for e in events], 0, np.float32),
            waits=stacked([e.entered & ~e.scripted for e in events], 0, np.bool_),
            leave=stacked([e.leave_frame for e in events], -1, np.int32),
            scripted=stacked([e.scripted for e in events], 0, np.bool_),
            status=np.zeros((len(events), size), np.int8),
        )


class Clock(NamedTuple):
    """Counters per world, each (W,)."""

    frame: np.ndarray
    horizon: np.ndarray
    """Frame at which the episode ends; nobody enters there."""
    cursor: np.ndarray
    """First event that is still pending."""
    changed: np.ndarray
    """Whether anyone entered, ended or was turned away in this step (0 or 1)."""
    ids: np.ndarray
    """Person ids given out."""
    no_slot: np.ndarray
    """Events dropped because every slot was taken."""
    no_id: np.ndarray
    """Events dropped because every id was given out."""

    @classmethod
    def at(cls, worlds: int, frame: int, horizon: int) -> "Clock":
        """All worlds at `frame`, all counts at zero."""
        zeros = [np.zeros(worlds, np.int32) for _ in range(5)]
        first = np.full(worlds, frame, np.int32)
        return cls(first, np.full(worlds, horizon, np.int32), *zeros)


class Limits(NamedTuple):
    """Numbers that hold for the whole simulation."""

    dt: float
    max_speed: float
    goal_radius: float
    clearance: float
    patience: int
    """Frames."""
    timeout: int
    """Frames."""
    max_persons: int
    x_min: float
    x_max: float
    y_min: float
    y_max: float
