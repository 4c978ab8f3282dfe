"""Start and recording of episodes, shared by rollouts and environments."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Float32, Int
from numpy.random import Generator, SeedSequence, default_rng

from crowdbench.errors import CapacityError, SettingError
from crowdbench.policies import Policy
from crowdbench.rollouts.acting import Actor
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.state import EXIT, GOAL, HORIZON, RECORDED, TIMEOUT
from crowdbench.spawn import SpawnEvents, SpawnModel, Steered
from crowdbench.spawn.events import check_events
from crowdbench.spawn.model import Start
from crowdbench.trajectories.table import Trajectories, from_rows

PURPOSES = ("spawn", "policy", "warm-up")
WARM_UP_S = 60.0
LEAST_SLOTS = 512


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

    The actor has the policy `walker`, and remembers whom it walked in the warm-up.

    Each world has its own arrivals, drawn with its own random generator: world k of the simulation
    with that of the world `first_world` + k. `start` defaults to that
    of the spawn model. `stationary`: a discarded warm-up of 60 s or the 99th percentile of dwell
    times, whichever is longer, with the policy `walker`. `recorded`: with the recorded initial
    population (replay only). `empty`: with nobody. If `scripted`, people leave when they left in
    the recording (replay only).

    Raises:
        SettingError: `recorded` without recorded arrivals, `stationary` with them, or people start
            outside the bounds.
    """
    scene = simulation.scene
    start = start or spawn.start
    recorded = spawn.start == "recorded"
    if start not in ("stationary", "recorded", "empty"):
        raise SettingError("start", got=repr(start), expected="stationary, recorded or empty")
    if (start == "recorded") != recorded and start != "empty":
        raise SettingError(
            f"start of {spawn.name}",
            got=start,
            expected="recorded or empty" if recorded else "stationary or empty",
            hint="Only replayed arrivals have a recorded initial population.",
        )
    warm_up = 0
    if start == "stationary":
        warm_up = scene.frames(warm_up_s(scene))
    events = []
    for world in range(first_world, first_world + simulation.worlds):
        sample = arrivals(spawn, scene, seed=seed, world=world, warm_up=warm_up, frames=frames)
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
    simulation.reset(events, horizon=frames, first_frame=-warm_up)
    actor = Actor(walker, simulation)
    actor.reset(generator(seed, 0, "warm-up"))
    for _ in range(warm_up):
        actor.step()
    if warm_up:
        simulation.number_anew()
    return actor


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
    """Records the trajectories of a simulation with one world, frame by frame."""

    simulation: Simulation
    _frame: list[int] = field(default_factory=list)
    _person: list[np.ndarray] = field(default_factory=list)
    _xy: list[np.ndarray] = field(default_factory=list)
    _event: list[np.ndarray] = field(default_factory=list)
    _born: list[np.ndarray] = field(default_factory=list)
    _ended: list[np.ndarray] = field(default_factory=list)
    _there: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    _some_ended: bool = False

    def write(self) -> None:
        """Record everyone present or just ended. The horizon's frame is dropped later."""
        slots, clock = self.simulation.slots, self.simulation.clock
        if not self._frame or self._some_ended or clock.changed[0]:
            self._there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
            ended = slots.ended[0, self._there]
            self._some_ended = bool(ended.any())
            self._person.append(slots.person[0, self._there])
            self._event.append(slots.event[0, self._there])
            self._born.append(slots.born[0, self._there])
            self._ended.append(ended)
        else:  # the same people as in the previous frame
            for column in (self._person, self._event, self._born, self._ended):
                column.append(column[-1])
        self._xy.append(slots.position[0].take(self._there, axis=0))
        self._frame.append(int(clock.frame[0]))

    def latest(self, frames: int) -> list[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]:
        """Ids and positions of the people in each of the last `frames` recorded frames, in order.

        Empty frames may be missing.
        """
        return list(zip(self._person[-frames:], self._xy[-frames:], strict=True))

    def trajectories(self, provenance: dict[str, Any]) -> Trajectories:
        """Trajectories of the frames recorded so far.

        Raises:
            RecordingError: nobody has entered.
        """
        scene = self.simulation.scene
        events = self.simulation.events[0]
        horizon = int(self.simulation.clock.horizon[0])
        count = [len(person) for person in self._person]
        frame = np.repeat(np.array(self._frame), count)
        person = np.concatenate(self._person)
        event = np.concatenate(self._event)
        born = np.concatenate(self._born)
        ended = np.concatenate(self._ended)
        outcome = np.zeros(int(person.max(initial=-1)) + 1, np.int8)
        inside = frame < horizon
        # The horizon's frame is not part of the table. Trips that end in it therefore have the
        # outcome `horizon`, whichever rule ended them.
        final = ended != 0
        outcome[person[final]] = np.where(inside[final], ended[final], HORIZON)
        how = outcome[person]
        left = np.isin(how, (GOAL, EXIT, TIMEOUT, RECORDED)) & ~events.censored[event]
        waited_s = self.simulation.waited(0, event, born) * scene.dt_s
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
            xy=np.concatenate(self._xy)[inside],
            persons={name: values[inside] for name, values in persons.items()},
            provenance=provenance,
            where=" × ".join(str(provenance.get(k, "")) for k in ("spawn", "policy"))
            + f", seed {provenance.get('seed', '')}",
        )


def slots_for(events: SpawnEvents, scene: Scene) -> int:
    """Number of slots that suffices for crowds like this one, even if nobody reaches a goal."""
    return max(LEAST_SLOTS, 3 * _most_at_once(events, scene) // 2)


def _most_at_once(events: SpawnEvents, scene: Scene) -> int:
    """Maximum number of people at the same time if all stay until the scene's timeout."""
    gone = np.searchsorted(events.time_s, events.time_s + scene.timeout_s)
    return int((gone - np.arange(len(events))).max(initial=0))


def check_horizon(horizon_s: float) -> None:
    """Check the length of an episode.

    Raises:
        SettingError: it is not a positive, finite number of seconds.
    """
    if not (np.isfinite(horizon_s) and horizon_s > 0):
        raise SettingError("horizon_s", got=str(horizon_s), expected="a positive number of seconds")


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
                hint=f"Raise {name}.",
            )
