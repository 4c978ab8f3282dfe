"""Start and recording of episodes, shared by rollouts and environments."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Int
from numpy.random import Generator, SeedSequence, default_rng

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import CapacityError, SettingError
from crowdbench.policies import Policy
from crowdbench.run.acting import Actor
from crowdbench.scene import Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.state import EXIT, GOAL, HORIZON, RECORDED, TIMEOUT
from crowdbench.spawn import SpawnEvents, SpawnModel, Steered
from crowdbench.spawn.events import check_events
from crowdbench.spawn.model import Start

PURPOSES = ("spawn", "policy", "warm-up")
WARM_UP_S = 60.0
LONGEST_S = 1e7
"""Longest episode, four months: longer ones exceed memory."""
LEAST_SLOTS = Settings.max_alive


def generator(seed: int, world: int, purpose: str) -> Generator:
    """Random generator of one world for one of `PURPOSES`, independent of all other generators."""
    key = (world, PURPOSES.index(purpose))
    return default_rng(SeedSequence(seed, spawn_key=key))


def warm_up_s(scene: Scene) -> float:
    """Length in seconds of the warm-up of a stationary crowd."""
    return max(WARM_UP_S, scene.recording.dwell_p99_s)


def begin(
    simulation: Simulation,
    spawn: SpawnModel,
    *,
    seed: int,
    frames: int,
    start: Start | None,
    walker: Policy,
    scripted: bool = False,
    first_world: int = 0,
) -> Actor:
    """Begin an episode of `frames` frames in all worlds of a simulation; return its actor.

    World k draws its arrivals with the random generator of the world `first_world` + k. See `draw`
    for the start and errors, and `EpisodeArrivals.begin` for the actor.
    """
    worlds = [World(spawn, seed, first_world + k) for k in range(simulation.worlds)]
    drawn = draw(simulation.scene, worlds, frames=frames, start=start, scripted=scripted)
    return drawn.begin(simulation, walker)


@dataclass(frozen=True)
class World:
    """The spawn model of a world, and what its random generators are made of."""

    spawn: SpawnModel
    seed: int
    number: int = 0

    def generator(self, purpose: str) -> Generator:
        """Its random generator for one of `PURPOSES`."""
        return generator(self.seed, self.number, purpose)


@dataclass(frozen=True)
class EpisodeArrivals:
    """The arrivals of an episode in all its worlds."""

    worlds: Sequence[World]
    events: list[SpawnEvents]
    warm_up: int
    """Number of frames of the warm-up, which come before the `frames` of the episode."""
    frames: int

    def begin(self, simulation: Simulation, walker: Policy) -> Actor:
        """Begin the episode in a simulation with as many worlds, after the warm-up.

        The actor that is returned has the policy `walker`, and remembers whom it walked in the
        warm-up.
        """
        simulation.reset(self.events, horizon=self.frames, first_frame=-self.warm_up)
        actor = Actor(walker, simulation)
        actor.reset(*(world.generator("warm-up") for world in self.worlds))
        for _ in range(self.warm_up):
            actor.step()
        if self.warm_up:
            simulation.number_anew()
        return actor


def draw(
    scene: Scene,
    worlds: Sequence[World],
    *,
    frames: int,
    start: Start | None,
    scripted: bool = False,
) -> EpisodeArrivals:
    """Draw the arrivals of an episode of `frames` frames in each of several worlds.

    `start` defaults to that of the spawn models. `stationary`: after a discarded warm-up of 60 s or
    the 99th percentile of dwell times, whichever is longer. `recorded`: with the recorded initial
    population (replay only). `empty`: with nobody. If `scripted`, people leave when they left in
    the recording (replay only).

    Raises:
        SettingError: `recorded` without recorded arrivals, `stationary` with them, or people start
            outside the bounds.
    """
    spawn = worlds[0].spawn
    start = start or spawn.start
    allowed = ("recorded" if spawn.start == "recorded" else "stationary", "empty")
    if start not in allowed:
        raise SettingError(
            f"start of {spawn.name}",
            got=repr(start),
            expected=" or ".join(allowed),
            hint="Only replayed arrivals have a recorded initial population.",
        )
    warm_up = scene.frames(warm_up_s(scene)) if start == "stationary" else 0
    events = []
    for world in worlds:
        spawn = world.spawn
        sample = arrivals(
            spawn, scene, seed=world.seed, world=world.number, warm_up=warm_up, frames=frames
        )
        outside = sample.entered & ~scene.inside(sample.start.astype(np.float64))
        if outside.any():
            raise SettingError(
                f"events of the spawn model {spawn.name}",
                got=f"{int(outside.sum())} persons who start outside the bounds of {scene.id}",
                expected="starts in metres, in the scene's coordinates",
            )
        if scripted:
            sample = spawn.scripted(sample)  # type: ignore[attr-defined]  # spawn is a Replay
        if start == "empty":
            sample = sample[sample.entered]
        events.append(sample)
    return EpisodeArrivals(worlds, events, warm_up, frames)


def arrivals(
    spawn: SpawnModel, scene: Scene, *, seed: int, world: int, warm_up: int, frames: int
) -> SpawnEvents:
    """Spawn events of a world in the `warm_up` frames before time 0 and the `frames` after it.

    Raises:
        SettingError: the spawn model returned invalid events.
    """
    if isinstance(spawn, Steered):  # scenarios count time from the start of the episode
        spawn = replace(spawn, warm_up_s=warm_up * scene.dt_s)
    horizon_s = (warm_up + frames) * scene.dt_s
    events = spawn.sample(horizon_s, scene, generator(seed, world, "spawn"))
    return check_events(events, spawn.name).shifted(-warm_up * scene.dt_s)


@dataclass
class Recorder:
    """Records the trajectories in all worlds of a simulation, frame by frame.

    The clocks of all worlds show the same frame.
    """

    simulation: Simulation
    _frame: list[int] = field(default_factory=list)
    _who: list[tuple[np.ndarray, ...]] = field(default_factory=list)
    """World, person, event, birth and end of those recorded in each frame."""
    _xy: list[np.ndarray] = field(default_factory=list)
    _there: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    _some_ended: bool = False

    def write(self) -> None:
        """Record everyone present or just ended. The horizon's frame is dropped later."""
        slots, clock = self.simulation.slots, self.simulation.clock
        if not self._frame or self._some_ended or clock.changed.any():
            self._there = np.flatnonzero(slots.alive | (slots.ended != 0))
            world = self._there // slots.alive.shape[1]
            columns = (slots.person, slots.event, slots.born, slots.ended)
            who = [column.take(self._there) for column in columns]
            self._some_ended = bool(who[-1].any())
            self._who.append((world.astype(np.int16), *who))  # as long as all rows, but never large
        else:  # the same people as in the previous frame
            self._who.append(self._who[-1])
        self._xy.append(slots.position.reshape(-1, 2).take(self._there, axis=0))
        self._frame.append(int(clock.frame[0]))

    def latest(self, frames: int) -> list[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]:
        """Ids and positions of the people in each of the last `frames` recorded frames, in order.

        Of a simulation with one world. Empty frames may be missing.
        """
        people = [person for _, person, *_ in self._who[-frames:]]
        return list(zip(people, self._xy[-frames:], strict=True))

    def trajectories(self, provenance: dict[str, Any]) -> Trajectories:
        """Trajectories in the first world in the frames recorded so far.

        Raises:
            RecordingError: nobody has entered.
        """
        return self.all_trajectories([provenance])[0]

    def all_trajectories(self, provenance: Sequence[dict[str, Any]]) -> list[Trajectories]:
        """Trajectories in each of the first worlds in the frames recorded so far.

        Raises:
            RecordingError: nobody has entered one of the worlds.
        """
        frame = np.repeat(np.array(self._frame), [len(xy) for xy in self._xy])
        world, *columns = map(np.concatenate, zip(*self._who, strict=True))
        rows = (frame, *columns, np.concatenate(self._xy))
        return [
            self._trajectories(k, asked, *(of[world == k] for of in rows))
            for k, asked in enumerate(provenance)
        ]

    def _trajectories(
        self, world: int, provenance: dict[str, Any], *rows: np.ndarray
    ) -> Trajectories:
        frame, person, event, born, ended, xy = rows
        scene = self.simulation.scene
        events = self.simulation.events[world]
        horizon = int(self.simulation.clock.horizon[world])
        outcome = np.zeros(int(person.max(initial=-1)) + 1, np.int8)
        inside = frame < horizon
        # The horizon's frame is not part of the table. Trips that end in it therefore have the
        # outcome `horizon`, whichever rule ended them.
        final = ended != 0
        outcome[person[final]] = np.where(inside[final], ended[final], HORIZON)
        how = outcome[person]
        left = np.isin(how, (GOAL, EXIT, TIMEOUT, RECORDED)) & ~events.censored[event]
        waited_s = self.simulation.waited(world, event, born) * scene.dt_s
        requested_s = events.time_s[event]
        persons = {
            "spawn_area": events.spawn_area[event],
            "goal_area": events.goal_area[event],
            "group": events.group[event],
            "goal_x": events.goal[event, 0],
            "goal_y": events.goal[event, 1],
            "entered": events.entered[event] & (born > 0),
            "left": left,
            "requested_s": requested_s,
            "spawn_s": requested_s + waited_s,
            "outcome": how,
        }
        return from_rows(
            scene=scene.id,
            dt_s=scene.dt_s,
            grid_s=scene.grid_s,
            frames=horizon,
            person_id=person[inside].astype(np.int64),
            frame=frame[inside],
            xy=xy[inside],
            persons={name: values[inside] for name, values in persons.items()},
            provenance=provenance,
            where=" × ".join(str(provenance.get(k, "")) for k in ("spawn", "policy"))
            + f", seed {provenance.get('seed', '')}",
        )


def sample_of(spawn: SpawnModel, scene: Scene, horizon_s: float) -> SpawnEvents:
    """Arrivals of an episode and its warm-up, from which capacities are chosen."""
    return spawn.sample(warm_up_s(scene) + horizon_s, scene, default_rng(0))


def slots_for(events: SpawnEvents, scene: Scene) -> int:
    """Default number of slots of the environments, for episodes with arrivals like these.

    Twice as many as suffice for these people if nobody reaches a goal, and at least 256.
    """
    return max(LEAST_SLOTS, 2 * most_at_once(events, scene))


def most_at_once(events: SpawnEvents, scene: Scene) -> int:
    """Number of slots that suffices for these people, even if nobody reaches a goal."""
    dt_s = scene.dt_s
    last_s = events.time_s + events.wait_s + scene.spawning.patience_s + scene.timeout_s
    last_s = np.where(events.scripted, events.leave_frame * dt_s, last_s)
    gone_s = np.sort(last_s + 4 * dt_s)  # times are rounded to frames, and slots are freed later
    entered = np.arange(1, len(events) + 1)
    return int((entered - np.searchsorted(gone_s, events.time_s)).max(initial=0))


def check_horizon(horizon_s: float) -> None:
    """Check the length of an episode.

    Raises:
        SettingError: it is not a positive number of seconds, or more than `LONGEST_S`.
    """
    if not 0 < horizon_s <= LONGEST_S:
        expected = f"a positive number of seconds, at most {LONGEST_S:g}"
        raise SettingError("horizon_s", got=str(horizon_s), expected=expected)


def check_capacity(simulation: Simulation) -> None:
    """Check that everyone could enter.

    Raises:
        CapacityError: people could not enter for lack of slots or ids.
    """
    clock, settings = simulation.clock, simulation.settings
    for count, name, size in (
        (int(clock.no_slot.sum()), "max_alive", settings.max_alive),
        (int(clock.no_id.sum()), "max_persons", settings.max_persons),
    ):
        if count:
            raise CapacityError(
                f"{simulation.scene.id}, frame {int(clock.frame[0])}",
                got=f"{count} persons more than {name} = {size} allows",
                expected="enough capacity for everyone who enters",
                hint=f"Raise {name}, or let an environment omit people with on_full='drop'.",
            )
