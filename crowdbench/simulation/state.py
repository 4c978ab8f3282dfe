"""State of a simulation: named tuples of arrays, which are passed to the compiled kernels."""

from collections.abc import Sequence
from typing import NamedTuple, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents, no_events

GOAL, EXIT, TIMEOUT, RECORDED, HORIZON = 1, 2, 3, 4, 5  # indices into trajectories.OUTCOMES
TERMINAL = (GOAL, EXIT, RECORDED)
"""Outcomes that terminate a trip; a timeout and the horizon truncate it."""
PENDING, ENTERED, DROPPED = 0, 1, 2  # states of a spawn event
TO_GOAL, TO_VIA, WAITING = 0, 1, 2  # stages of a trip


class Slots(NamedTuple):
    """State per slot, each array (W, N) or (W, N, 2)."""

    alive: np.ndarray
    """Whether the slot is occupied after this step."""
    ended: np.ndarray
    """Outcome of the trip that ended in this step, 0 for none; the next step frees the slot."""
    spawned: np.ndarray
    """Whether the person entered in this step."""
    hit_wall: np.ndarray
    """Whether the person met a wall in this step."""
    position: np.ndarray
    """Position in metres."""
    velocity: np.ndarray
    """Displacement in this step divided by dt, in m/s."""
    commanded: np.ndarray
    """Commanded velocity in this step in the world frame, in m/s; at entry that of the entry."""
    blocked: np.ndarray
    """Seconds for which bodies or walls have been blocking the person, up to 2; see `contact`."""
    held: np.ndarray
    """0 to 1: share of the commanded way of this step that other people's bodies took away."""
    aside: np.ndarray
    """Seconds for which the person still keeps to the right after it met somebody."""
    heading: np.ndarray
    """Remembered heading: unit vector of the last velocity at which the person did not stand. At
    entry that of the entry velocity or, if that is too slow, of the way to the target."""
    walked: np.ndarray
    """Distance walked since entry, in metres."""
    stood: np.ndarray
    """Number of steps since entry in which the person stood, that is, was slower than 0.3 m/s."""
    goal: np.ndarray
    """Position of the goal in metres."""
    target: np.ndarray
    """Where the person walks to now, in metres: the via point, if it still has one, or the goal."""
    stage: np.ndarray
    """TO_GOAL, TO_VIA or WAITING."""
    stage_before: np.ndarray
    """Stage before this step, of people who were present then."""
    until: np.ndarray
    """Frame in which a waiting person's target becomes the goal."""
    closest: np.ndarray
    """Smallest distance to the via point so far, in metres."""
    nearer: np.ndarray
    """Frame in which the person last came closer to its via point."""
    speed: np.ndarray
    """Preferred speed in m/s."""
    person: np.ndarray
    """Id of the present or last person, −1 if the slot has never been occupied."""
    event: np.ndarray
    """Index of the person's spawn event."""
    born: np.ndarray
    """Frame in which the person entered."""
    leave: np.ndarray
    """Frame in which the person is removed, −1 for never."""
    scripted: np.ndarray
    """Whether the person leaves in the frame `leave` only, regardless of its position."""
    wider: np.ndarray
    """By how much the radius of whoever is in the slot exceeds that of a person, in metres: 0 for
    people, more for a robot."""

    @property
    def acted(self) -> Bool[np.ndarray, "W N"]:
        """Who acted in this step: those present who did not enter in it, and those who ended."""
        acted: np.ndarray = (self.alive & ~self.spawned) | (self.ended != 0)
        return acted

    @classmethod
    def empty(cls, worlds: int, size: int) -> "Slots":
        """Slots of `worlds` worlds with `size` slots each, all empty."""
        pairs = ("position", "velocity", "commanded", "heading", "goal", "target")
        kinds: dict[str, type] = dict.fromkeys(cls._fields, np.int32)
        kinds |= dict.fromkeys(("alive", "spawned", "hit_wall", "scripted"), np.bool_)
        kinds |= dict.fromkeys(("ended", "stage", "stage_before"), np.int8)
        kinds |= dict.fromkeys(
            (*pairs, "blocked", "held", "aside", "walked", "closest", "speed", "wider"), np.float32
        )
        slots = cls(
            **{
                name: np.zeros((worlds, size, 2) if name in pairs else (worlds, size), kind)
                for name, kind in kinds.items()
            }
        )
        slots.heading[..., 0] = 1.0
        for nobody in (slots.person, slots.event, slots.leave):
            nobody[:] = -1
        return slots


class Queue(NamedTuple):
    """Spawn events of each world, padded to (W, E), and their states."""

    due: np.ndarray
    """(W, E) first frame at or after the event's time; padding is never due."""
    start: np.ndarray
    """(W, E, 2) position of entry in metres."""
    goal: np.ndarray
    """(W, E, 2) position of the goal in metres."""
    via: np.ndarray
    """(W, E, 2) position of the via point in metres, NaN for none."""
    wait: np.ndarray
    """(W, E) number of frames for which the via point remains the target once it is reached."""
    speed: np.ndarray
    """(W, E) preferred speed in m/s."""
    velocity: np.ndarray
    """(W, E, 2) velocity at entry in m/s."""
    group: np.ndarray
    """(W, E) group that the person walks with, −1 if alone."""
    may_wait: np.ndarray
    """(W, E) whether the person waits for free space."""
    leave: np.ndarray
    """(W, E) frame in which the person is removed, −1 for never."""
    scripted: np.ndarray
    """(W, E) whether the person leaves in the frame `leave` only."""
    status: np.ndarray
    """(W, E) PENDING, ENTERED or DROPPED."""

    @classmethod
    def of(cls, events: Sequence[SpawnEvents], dt_s: float) -> "Queue":
        """Queue of the given events, padded and stacked."""
        size = max(1, *(len(e) for e in events))

        def stacked(arrays: list[np.ndarray], fill: int | float, kind: type) -> np.ndarray:
            out = np.full((len(arrays), size, *arrays[0].shape[1:]), fill, dtype=kind)
            for w, array in enumerate(arrays):
                out[w, : len(array)] = array
            return out

        def frames(seconds: np.ndarray) -> np.ndarray:
            return np.ceil(seconds / dt_s - 1e-6)

        never = np.iinfo(np.int32).max
        due = [frames(e.time_s).clip(-never, never) for e in events]
        wait = [frames(e.wait_s).clip(0, never // 4) for e in events]
        copied = {"start": 0, "goal": 0, "via": np.nan, "speed": 0, "velocity": 0}
        return cls(
            **{
                name: stacked([getattr(e, name) for e in events], fill, np.float32)
                for name, fill in copied.items()
            },
            due=stacked(due, never, np.int32),
            wait=stacked(wait, 0, np.int32),
            group=stacked([e.group for e in events], -1, np.int32),
            may_wait=stacked([e.entered & ~e.scripted for e in events], 0, np.bool_),
            leave=stacked([e.leave_frame for e in events], -1, np.int32),
            scripted=stacked([e.scripted for e in events], 0, np.bool_),
            status=np.zeros((len(events), size), np.int8),
        )

    def widened(self, size: int) -> "Queue":
        """The same queue with room for `size` events per world, or itself if it has more."""
        worlds, most = self.due.shape
        if size <= most:
            return self
        padding = Queue.of([no_events()] * worlds, 1.0)  # of one event
        return Queue(
            *(
                np.concatenate([of, np.repeat(pad, size - most, axis=1)], axis=1)
                for of, pad in zip(self, padding, strict=True)
            )
        )


class Clock(NamedTuple):
    """Counters per world, each (W,)."""

    frame: np.ndarray
    """Current frame."""
    horizon: np.ndarray
    """Frame in which the episode ends; nobody enters in it."""
    cursor: np.ndarray
    """Index of the first pending event."""
    changed: np.ndarray
    """Whether anyone entered, ended or was dropped in this step (0 or 1)."""
    ids: np.ndarray
    """Number of person ids in use."""
    no_slot: np.ndarray
    """Number of events dropped because all slots were occupied."""
    no_id: np.ndarray
    """Number of events dropped because all ids were in use."""

    @classmethod
    def at(cls, worlds: int, frame: int, horizon: int) -> "Clock":
        """Clock with all worlds at `frame` and all counters at zero."""
        zeros = [np.zeros(worlds, np.int32) for _ in range(5)]
        first = np.full(worlds, frame, np.int32)
        return cls(first, np.full(worlds, horizon, np.int32), *zeros)


class Constants(NamedTuple):
    """Constants of a simulation, in metres, seconds and m/s unless stated otherwise."""

    dt: float
    max_speed: float
    goal_radius: float
    clearance: float
    """A person waits to enter while someone is closer than this."""
    patience: int
    """Number of frames after which a waiting person enters anyway."""
    timeout: int
    """Number of frames after which a trip ends, in addition to the wait at its via point."""
    patience_via: int
    """Number of frames without progress after which a person gives up its via point."""
    max_persons: int
    x_min: float
    x_max: float
    y_min: float
    y_max: float


@runtime_checkable  # tests check annotations at run time
class CrowdState(Protocol):
    """What observations and rewards of one's own read: a `Simulation` of W worlds of N slots."""

    scene: Scene
    slots: Slots
    """The state of everyone after the step, by world and slot."""
    queue: Queue
    """The spawn events; those of a person are at `slots.event`."""
    clock: Clock
    observation: Float32[np.ndarray, "W N obs"]
    """What everyone present or just ended sees after the step."""
    nearest: Float32[np.ndarray, "W N"]
    """Distance to the nearest visible person in metres, less by how much it is wider; infinite if
    there is none."""
    towards: Float32[np.ndarray, "W N 2"]
    """Next point in metres on the path to the target: a corner that it leads around, or its end."""
    remaining: Float32[np.ndarray, "W N"]
    """Length of the path to the target in metres: straight in `lidar-1`, else around walls."""
    remaining_before: Float32[np.ndarray, "W N"]
    """`remaining` before the step."""
    episode: Int[np.ndarray, " W"]
    """Number of episodes that have begun in each world."""
