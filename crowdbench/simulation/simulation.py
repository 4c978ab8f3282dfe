"""`Simulation`: the object around the kernels."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Int

from crowdbench.errors import ActionError, SettingError
from crowdbench.scene import Scene
from crowdbench.simulation.observations import (
    OBSERVATION,
    OBSERVATIONS,
    Cells,
    observation_of,
    observe,
    size_of,
)
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.state import Clock, Limits, Queue, Slots
from crowdbench.simulation.step import advance, populate
from crowdbench.simulation.walls import wall_table
from crowdbench.spawn.events import SpawnEvents, no_events

TIMEOUT_DWELLS = 2.0
"""A life is cut off at this many times the 99th percentile of the recorded dwell times."""


@dataclass(frozen=True)
class Settings:
    """Sizes of a simulation and of what persons see."""

    max_alive: int = 256
    """N: persons there at once, per world."""
    max_persons: int = 1_000_000
    """Persons ever, per world and episode."""
    rays: int = 32
    ray_range_m: float = 10.0
    observation: str = OBSERVATION
    """Version of what they see, `lidar-1` to `lidar-3`; see `simulation.observations`."""

    def __post_init__(self) -> None:
        for name in ("max_alive", "max_persons", "rays"):
            value = getattr(self, name)
            if not isinstance(value, int | np.integer) or value < 1:
                raise SettingError(name, got=repr(value), expected="a whole number, 1 or more")
        if not (np.isfinite(self.ray_range_m) and self.ray_range_m > 0):
            raise SettingError(
                "ray_range_m", got=str(self.ray_range_m), expected="a positive number of metres"
            )
        observation_of(self.observation)  # whether there is one


class Simulation:
    """`W` worlds of one scene, `N` slots each, all stepped together.

    After `reset` and after each `step` the arrays in `slots` and `observation` say who is
    there. A step does, in this order:

    1. free the slots of those whose life ended in the step before;
    2. move everyone by the commanded velocity (clipped to [−1, 1]² and to `max_speed`), stopping
       at walls and sliding along them; a frame goes by;
    3. end lives: `goal` where the way walked came within the goal radius, else `exit` outside
       the bounds, else `timeout`; people cut off in the recording leave at its last frame;
       at the horizon everyone does;
    4. let in who is due: a person waits for someone already there and too close, never for
       people who enter in the same frame; nobody enters at the horizon;
    5. observe.
    """

    def __init__(self, scene: Scene, *, worlds: int = 1, settings: Settings | None = None) -> None:
        self.scene = scene
        self.settings = settings or Settings()
        self.worlds = worlds
        motion, bounds, s = scene.motion, scene.bounds, self.settings
        step_m = motion.max_speed_mps * scene.dt_s
        lower = np.array([bounds.x_min_m, bounds.y_min_m]) - step_m
        upper = np.array([bounds.x_max_m, bounds.y_max_m]) + step_m
        self._walls = wall_table(
            scene.wall_segments,
            lower=tuple(lower),
            upper=tuple(upper),
            rays=s.rays,
            ray_range_m=s.ray_range_m,
            step_m=step_m,
        )
        self._cells = Cells.between(worlds, s.max_alive, lower, upper, s.ray_range_m / 2)
        timeout_s = TIMEOUT_DWELLS * scene.recording.dwell_p99_s
        self._limits = Limits(
            dt=scene.dt_s,
            max_speed=motion.max_speed_mps,
            goal_radius=motion.goal_radius_m,
            clearance=scene.spawning.clearance_m,
            patience=scene.frames(scene.spawning.patience_s),
            timeout=scene.frames(timeout_s),
            max_persons=s.max_persons,
            x_min=bounds.x_min_m,
            x_max=bounds.x_max_m,
            y_min=bounds.y_min_m,
            y_max=bounds.y_max_m,
        )
        self._more = observation_of(s.observation)
        base = s.observation if self._more is None else self._more.base
        self._head = OBSERVATIONS[base]
        self._bounds = np.array([bounds.x_min_m, bounds.x_max_m, bounds.y_min_m, bounds.y_max_m])
        self.observation: Float32[np.ndarray, "W N obs"] = np.zeros(
            (worlds, s.max_alive, size_of(s.observation, s.rays)), np.float32
        )
        self._seen = self.observation
        if self._more is not None:
            shape = (worlds, s.max_alive, self._head + s.rays)
            self._seen = np.zeros(shape, np.float32)  # kernels write whole arrays
        self.nearest: Float32[np.ndarray, "W N"] = np.full(
            (worlds, s.max_alive), np.inf, np.float32
        )
        self.remaining: Float32[np.ndarray, "W N"] = np.zeros((worlds, s.max_alive), np.float32)
        self.remaining_before: Float32[np.ndarray, "W N"] = np.zeros_like(self.remaining)
        self._routes = Routes.on(scene) if base != "lidar-1" else None
        self._target = np.zeros((worlds, s.max_alive, 2), np.float32)
        self._beyond = np.zeros((worlds, s.max_alive))
        self.slots = Slots.empty(worlds, s.max_alive)
        self.clock = Clock.at(worlds, 0, 0)
        self.events: list[SpawnEvents] = []
        self._queue = Queue.of([no_events()] * worlds, scene.dt_s)
        self._advance, self._populate, self._observe = (
            kernel.fresh() for kernel in (advance, populate, observe)
        )

    def reset(self, events: Sequence[SpawnEvents], *, horizon: int, first_frame: int = 0) -> None:
        """Begin an episode with one sequence of events per world.

        The clock starts at `first_frame` (negative for a warm-up) and the episode ends at frame
        `horizon`.
        """
        self.events = list(events)
        self._queue = Queue.of(self.events, self.scene.dt_s)
        self.slots = Slots.empty(self.worlds, self.settings.max_alive)
        self.clock = Clock.at(self.worlds, first_frame, horizon)
        self._populate(1, self.slots, self._queue, self.clock, self._limits)

    def step(self, actions: Float32[np.ndarray, "W N 2"]) -> None:
        """Advance every world by one frame, without observing.

        Raises:
            ActionError: actions of another shape.
        """
        # The compiled kernel trusts its arguments' types, so they are made sure of here.
        if actions.dtype != np.float32 or not actions.flags.c_contiguous:
            actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != self.slots.position.shape:
            raise ActionError(
                "Simulation.step",
                got=f"actions of shape {actions.shape}",
                expected=f"one velocity command per world and slot, {self.slots.position.shape}",
            )
        np.copyto(self.remaining_before, self.remaining)
        arguments = (actions, self.slots, self._queue, self.clock, self._limits, self._walls)
        # Persons of one world interact at entries: threads share worlds, not persons.
        self._advance(self.slots.alive.size if self.worlds > 1 else 1, *arguments)

    def observe(self) -> Float32[np.ndarray, "W N obs"]:
        """Fill `observation` for everyone alive or just ended, and return it.

        `nearest` then holds how far it is to the nearest person that each of them sees, and
        `remaining` how far to the goal, along the way that the observation points to: straight in
        `lidar-1`, around walls in later versions. `remaining_before` holds what `remaining` was
        before the last step, if that had been observed. All in metres.
        """
        arguments = (
            self.slots,
            self._towards(),
            self._beyond,
            self._head,
            self._bounds,
            self._cells,
            self._walls,
            self._limits.max_speed,
            self.scene.motion.person_radius_m,
            self.settings.ray_range_m,
            self.remaining,
            self.nearest,
            self._seen,
        )
        self._observe(int(np.count_nonzero(self.slots.alive)), *arguments)
        if self._more is not None:
            size = self._seen.shape[-1]
            self.observation[..., :size] = self._seen
            self._more.observe(self, self.observation[..., size:])
        return self.observation

    def _towards(self) -> Float32[np.ndarray, "W N 2"]:
        """Where everyone is to walk; how far it is from there goes into `_beyond`."""
        slots = self.slots
        if self._routes is None:
            return slots.goal
        at = np.flatnonzero(slots.alive | (slots.ended != 0))
        target, beyond = self._routes.next_of(
            *np.divmod(at, slots.alive.shape[1]),
            slots.person.ravel().take(at),
            slots.position.reshape(-1, 2).take(at, axis=0),
            slots.goal.reshape(-1, 2).take(at, axis=0),
        )
        self._target.reshape(-1, 2)[at], self._beyond.reshape(-1)[at] = target, beyond
        return self._target

    def number_anew(self) -> None:
        """Give those present the ids from 0 on: the end of a warm-up.

        Who was turned away in the warm-up stays counted: the crowd lacks them from the start.
        """
        slots, clock = self.slots, self.clock
        for w in range(self.worlds):
            present = np.flatnonzero(slots.alive[w])
            present = present[np.argsort(slots.person[w, present])]
            slots.person[w, present] = np.arange(len(present))
            clock.ids[w] = len(present)
        slots.spawned[:] = False
        slots.ended[:] = 0

    def next_due(self, world: int = 0) -> int | None:
        """Frame of the first event that is still to come, None if there is none."""
        at = int(self.clock.cursor[world])
        if at >= len(self.events[world]):
            return None
        return int(self._queue.due[world, at])

    def skip_to(self, frame: int) -> None:
        """Advance empty worlds to the frame before `frame` at once: nothing happens in them."""
        np.maximum(self.clock.frame, frame - 1, out=self.clock.frame)

    def waited(
        self, world: int, event: Int[np.ndarray, " n"], born: Int[np.ndarray, " n"]
    ) -> Int[np.ndarray, " n"]:
        """Frames that the persons of these events, born in these frames, waited to enter."""
        return born - self._queue.due[world, event]
