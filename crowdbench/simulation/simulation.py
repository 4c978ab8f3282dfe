"""`Simulation`: the class that runs the compiled kernels."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.data.table import Indices
from crowdbench.errors import ActionError, SettingError
from crowdbench.scene import Scene
from crowdbench.simulation import observations
from crowdbench.simulation.cells import Cells
from crowdbench.simulation.contact import Bodies
from crowdbench.simulation.free_space import FreeSpace, free_space
from crowdbench.simulation.routes import NO_ROUTES, Routes, RouteTables
from crowdbench.simulation.social import RANGE_M, observe_social
from crowdbench.simulation.state import Clock, Constants, Queue, Slots
from crowdbench.simulation.step import advance
from crowdbench.simulation.walls import WallTable, wall_table
from crowdbench.spawn.events import SpawnEvents, no_events

GIVE_UP_S = 30.0
"""Seconds without progress after which a person no longer walks to its via point."""


def check_count(name: str, value: object) -> None:
    """Check a number of worlds, persons, rays or frames.

    Raises:
        SettingError: it is not a whole number of at least 1.
    """
    if not isinstance(value, int | np.integer) or value < 1:
        raise SettingError(name, got=repr(value), expected="a whole number, 1 or more")


class Shown(NamedTuple):
    """What a simulation shows to policies that see observations."""

    observation: str = observations.OBSERVATION
    rays: int = 32
    ray_range_m: float = 10.0

    @property
    def version(self) -> observations.Version:
        """The built-in version of the observation."""
        return observations.version_of(self.observation)


@dataclass(frozen=True)
class Settings:
    """Capacity of a simulation, and its observation.

    `rays`, `ray_range_m` and `observation` are None if nobody has chosen them. Rollouts then use
    what the policy needs, see `crowdbench.run.acting`; otherwise the values of `Shown` apply.
    """

    max_alive: int = 256
    """Number of slots N: maximum number of people at the same time per world."""
    max_persons: int = 1_000_000
    """Maximum number of people per world and episode."""
    rays: int | None = None
    """Number of rays of an observation, by default 32; `social-1` has none."""
    ray_range_m: float | None = None
    """Range of the rays in metres, by default 10."""
    observation: str | None = None
    """Version of the observation, `lidar-1` to `lidar-3`, `social-1`, `lidar-2-contact`,
    `social-1-contact` or a registered one; by default `lidar-2`."""

    def __post_init__(self) -> None:
        shown = self.shown
        check_count("max_alive", self.max_alive)
        check_count("max_persons", self.max_persons)
        check_count("rays", shown.rays)
        if not 0.1 <= shown.ray_range_m <= 1000:
            raise SettingError(
                "ray_range_m", got=str(shown.ray_range_m), expected="0.1 to 1000 metres"
            )
        observations.observation_of(shown.observation)  # raises an error if it does not exist

    @property
    def shown(self) -> Shown:
        """The observation, with defaults for what nobody has chosen."""
        chosen = {name: getattr(self, name) for name in Shown._fields}
        return Shown(**{name: value for name, value in chosen.items() if value is not None})

    @property
    def own_frame(self) -> bool:
        """Whether observations and actions are in each person's own frame, see `Version`."""
        return self.shown.version.own_frame


class Tables(NamedTuple):
    """What a simulation looks up, and the working memory of bodies."""

    walls: WallTable
    bodies: Bodies | None
    free: FreeSpace | None
    """Where walls and bounds are, of observations without rays."""
    routes: RouteTables


class Simulation:
    """`W` worlds of one scene with `N` slots each, all stepped together.

    After `reset` and each `step`, the arrays in `slots` hold the state of everyone present;
    `observe` fills `observation`. A step consists of these parts, in this order:

    1. Free the slots of people whose trips ended in the previous step.
    2. Advance the clock by one frame and move everyone by the commanded velocity (clipped to
       [−1, 1]² and to `max_speed`). People stop at walls and slide along them. Everyone
       remembers its heading, the distance walked and the number of steps in which it stood.
    3. End trips: `goal` if the path walked in this step came within the goal radius, else `exit`
       outside the bounds, else `timeout`. People whose recording is cut off leave in its last
       frame. At the horizon all trips end.

       The *target* of a person is its via point until it has been visited, then its goal. A visit
       begins on entry within 1 m of the via point, or when the path walked in a step comes within 1
       m of it, or within 3 m of it and ends beyond it, as seen from the start. It lasts for the
       person's wait; nobody is forced to stand still. If a person has not come closer to the via
       point (by 0.5 m) for 30 s, it cannot be reached, and the goal is the target. Trips end at the
       goal only while it is the target, and the timeout is extended by the wait.
    4. Let people enter who are due. A person waits while someone who was already present is too
       close, but not for people who enter in the same frame. Nobody enters at the horizon.
    """

    def __init__(self, scene: Scene, *, worlds: int = 1, settings: Settings | None = None) -> None:
        self.scene = scene
        self.settings = settings or Settings()
        self.worlds = worlds
        motion, bounds, s = scene.motion, scene.bounds, self.settings
        self._shown = shown = s.shown
        self._version = shown.version
        rays = self._version.rays
        step_m = motion.max_speed_mps * scene.dt_s
        radius_m = motion.body_radius_m
        lower = np.array([bounds.x_min_m, bounds.y_min_m]) - step_m
        upper = np.array([bounds.x_max_m, bounds.y_max_m]) + step_m
        self._walls = wall_table(
            scene.wall_segments.tobytes(),
            lower=tuple(lower),
            upper=tuple(upper),
            rays=shown.rays if rays else 0,
            ray_range_m=shown.ray_range_m,
            step_m=step_m + radius_m,
        )
        self._free = None if rays else free_space(scene.walls, bounds)
        range_m = shown.ray_range_m if rays else RANGE_M
        self._cells = Cells.between(worlds, s.max_alive, lower, upper, range_m / 2)
        self.constants = Constants(
            dt=scene.dt_s,
            max_speed=motion.max_speed_mps,
            goal_radius=motion.goal_radius_m,
            clearance=scene.spawning.clearance_m,
            patience=scene.frames(scene.spawning.patience_s),
            timeout=scene.frames(scene.timeout_s),
            patience_via=scene.frames(GIVE_UP_S),
            max_persons=s.max_persons,
            x_min=bounds.x_min_m,
            x_max=bounds.x_max_m,
            y_min=bounds.y_min_m,
            y_max=bounds.y_max_m,
        )
        self._more = observations.observation_of(shown.observation)
        shape = (worlds, s.max_alive)
        numbers = observations.size_of(shown.observation, shown.rays)
        self.observation: Float32[np.ndarray, "W N obs"] = np.zeros((*shape, numbers), np.float32)
        self._seen = self.observation
        if self._more is not None:  # kernels write contiguous arrays
            self._seen = np.zeros(
                (*shape, observations.size_of(self._more.base, shown.rays)), np.float32
            )
        self._own = np.full(shape, self._version.own_frame)
        self.nearest: Float32[np.ndarray, "W N"] = np.full(shape, np.inf, np.float32)
        self.remaining: Float32[np.ndarray, "W N"] = np.zeros(shape, np.float32)
        self.remaining_before: Float32[np.ndarray, "W N"] = np.zeros(shape, np.float32)
        self._routes = Routes.on(scene) if self._version.around_walls else None
        self.towards: Float32[np.ndarray, "W N 2"] = np.zeros((*shape, 2), np.float32)
        self._target = np.zeros((*shape, 2), np.float32)
        self._beyond = np.zeros(shape)
        self.slots = Slots.empty(worlds, s.max_alive)
        self.clock = Clock.at(worlds, 0, 0)
        self.events: list[SpawnEvents] = [no_events()] * worlds
        self.episode: Int[np.ndarray, " W"] = np.zeros(worlds, np.int64)
        self.queue = Queue.of(self.events, scene.dt_s)
        self._bodies = Bodies.of(worlds, s.max_alive, radius_m, scene.dt_s)
        self._advance = advance.fresh()
        self._observe = (observations.observe if rays else observe_social).fresh()

    def reset(self, events: Sequence[SpawnEvents], *, horizon: int, first_frame: int = 0) -> None:
        """Begin an episode with the spawn events of each world.

        The clock starts at frame `first_frame` (negative for a warm-up), and the episode ends at
        frame `horizon`.
        """
        self.events = list(events)
        self.queue = Queue.of(self.events, self.scene.dt_s)
        self.slots = Slots.empty(self.worlds, self.settings.max_alive)
        self.clock = Clock.at(self.worlds, first_frame - 1, horizon)
        self.episode += 1
        self._go(1, np.zeros(self.slots.position.shape, np.float32), self._own)  # people enter

    def showing(self, shown: Shown) -> "Simulation":
        """The same people with another observation.

        Both share everyone's state until this simulation is reset. Only this one may step.
        """
        other = Simulation(
            self.scene, worlds=self.worlds, settings=replace(self.settings, **shown._asdict())
        )
        other.events, other.queue = self.events, self.queue
        other.slots, other.clock, other.episode = self.slots, self.clock, self.episode
        return other

    def copy_world(self, world: int, alone: "Simulation") -> None:
        """Let a world go on from the state of `alone`, and all other worlds from their own.

        `alone` has one world of the same scene, with as many slots.
        """
        self.copy_worlds(np.array([world]), alone, np.array([0]))

    def copy_worlds(
        self, mine: Int[np.ndarray, " n"], other: "Simulation", theirs: Int[np.ndarray, " n"]
    ) -> None:
        """Let the worlds `mine` go on from the state of the worlds `theirs` of `other`.

        `other` has the same scene, and may have fewer slots; further ones stay as they are. It may
        be this simulation.
        """
        size = other.slots.alive.shape[1]
        for to, of in zip(self.slots, other.slots, strict=True):
            to[mine, :size] = of[theirs]
        for to, of in zip(self.clock, other.clock, strict=True):
            to[mine] = of[theirs]
        for world, of_world in zip(mine.tolist(), theirs.tolist(), strict=True):
            self.events[world] = other.events[of_world]
        self.episode[mine] += 1
        wide = other.queue.due.shape[1]
        self.queue = self.queue.widened(wide)
        for to, of in zip(self.queue, other.queue.widened(self.queue.due.shape[1]), strict=True):
            to[mine] = of[theirs]

    def step(
        self,
        actions: Float32[np.ndarray, "W N 2"],
        *,
        own_frame: bool | Bool[np.ndarray, "W N"] | None = None,
    ) -> None:
        """Advance every world by one frame; call `observe` for new observations.

        `own_frame` says whose actions are in the own frame, relative to the headings that `observe`
        shows, and whose are in the world frame, such as those of policies that see the state.
        By default, all actions are in the frame of the observation. In either frame, actions are
        clipped before they are turned.

        Raises:
            ActionError: `actions` have another shape.
        """
        # The compiled kernel does not check the types of its arguments, so they are ensured here.
        if actions.dtype != np.float32 or not actions.flags.c_contiguous:
            actions = np.ascontiguousarray(actions, dtype=np.float32)
        if actions.shape != self.slots.position.shape:
            got = f"actions of shape {actions.shape}"
            expected = f"one velocity command per world and slot, {self.slots.position.shape}"
            raise ActionError("Simulation.step", got=got, expected=expected)
        np.copyto(self.remaining_before, self.remaining)
        own = self._own if own_frame is None else np.full(self._own.shape, own_frame)
        # People of one world interact when they enter, so threads run different worlds.
        self._go(self.slots.alive.size if self.worlds > 1 else 1, actions, own)

    def _go(
        self, persons: int, actions: Float32[np.ndarray, "W N 2"], own: Bool[np.ndarray, "W N"]
    ) -> None:
        bundles = (self.slots, self.queue, self.clock, self.constants, self._walls, self._bodies)
        self._advance(persons, actions, own, *bundles)

    def observe(self) -> Float32[np.ndarray, "W N obs"]:
        """Update and return `observation` for everyone present or just ended.

        Also updates `nearest`, the distance to the nearest visible person, less by how much it is
        wider, `towards`, the next point on the path to the target, and `remaining`, the length of
        that path, which is the one that the observation uses: straight in `lidar-1`, around walls
        in the other versions. `remaining_before` is the value of `remaining` before the last step,
        if `observe` was called then. All lengths are in metres.
        """
        self.towards = target = self._towards()
        slots, beyond = self.slots, self._beyond
        what: tuple[object, ...]
        if self._version.rays:
            radius_m, range_m = self.scene.motion.person_radius_m, self._shown.ray_range_m
            what = (slots, target, beyond, self._version.head, self._cells, self._walls,
                    self.constants, radius_m, range_m)  # fmt: skip
        else:
            what = (slots, self.queue, self.clock, target, beyond, self._cells, self._free,
                    self.constants)  # fmt: skip
        results = (self.remaining, self.nearest, self._seen)
        self._observe(int(np.count_nonzero(slots.alive)), *what, *results)
        if self._more is not None:
            size = self._seen.shape[-1]
            self.observation[..., :size] = self._seen
            self._more.observe(self, self.observation[..., size:])
        return self.observation

    def _towards(self) -> Float32[np.ndarray, "W N 2"]:
        """Next point on everyone's path; writes the path length from there to `_beyond`."""
        slots = self.slots
        if self._routes is None:
            return slots.target
        at = np.flatnonzero(slots.alive | (slots.ended != 0))
        target, beyond = self._routes.next_of(
            *np.divmod(at, slots.alive.shape[1]),
            slots.position.reshape(-1, 2).take(at, axis=0),
            slots.target.reshape(-1, 2).take(at, axis=0),
        )
        self._target.reshape(-1, 2)[at], self._beyond.reshape(-1)[at] = target, beyond
        return self._target

    @property
    def tables(self) -> Tables:
        """What it looks up; to be read only."""
        routes = NO_ROUTES if self._routes is None else self._routes.tables
        return Tables(self._walls, self._bodies, self._free, routes)

    def number_anew(self) -> None:
        """Renumber the people present from 0; called at the end of a warm-up.

        People who could not enter in the warm-up remain counted, because they are missing from
        the initial crowd.
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
        """Frame of the first pending spawn event of a world, None if there is none."""
        at = int(self.clock.cursor[world])
        if at >= len(self.events[world]):
            return None
        return int(self.queue.due[world, at])

    def skip_to(self, frame: int) -> None:
        """Set the clock to the frame before `frame`; all worlds must be empty until then."""
        np.maximum(self.clock.frame, frame - 1, out=self.clock.frame)

    def waited(self, world: int, event: Indices, born: Indices) -> Indices:
        """Number of frames that the persons of `event` waited before they entered in `born`."""
        return born - self.queue.due[world, event]
