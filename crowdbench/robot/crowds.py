"""The people of robot worlds: they enter, walk and leave, frame by frame, whatever robots do.

The people of a world go on from one episode of its robot to the next. When too little of their time
is left for an episode, a new crowd takes their place.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator, SeedSequence, default_rng

from crowdbench.errors import SettingError
from crowdbench.policies import Policy, Straight
from crowdbench.policies.walkers import ReplayPolicy
from crowdbench.registry import policy, spawn_model
from crowdbench.robot.config import LONGEST_CROWD_S, REPLAY, RobotConfig
from crowdbench.robot.robots import Robot, robot_of
from crowdbench.run.acting import Actor, settings_for
from crowdbench.run.episode import World, draw
from crowdbench.scene import Scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.state import DROPPED
from crowdbench.spawn import SpawnEvents, SpawnModel

LONG_AGO = -(2**30)
"""The frame before which nobody enters."""
_CROWD_KEY = 2**20  # of the generators that choose where a recorded crowd begins
_SPARE_SLOTS = 16


@dataclass
class Poses:
    """Where the robots of W worlds are, for the people."""

    position: Float[np.ndarray, "W 2"]
    heading: Float[np.ndarray, " W"]
    velocity: Float[np.ndarray, "W 2"]
    goal: Float[np.ndarray, "W 2"]


class Crowds:
    """The people of W robot worlds, and of W twins of these without a robot if costs are measured.

    The last slot of a world is the robot's: it is alive if people see the robot, and the policy of
    the people does not move it. Its spawn event is one that is never due.
    """

    def __init__(self, scene: Scene, worlds: int, config: RobotConfig) -> None:
        """Worlds without people; `begin` lets them enter.

        Raises:
            SettingError, WeightsError, RecordingError: a policy, spawn model or recording does not
                exist or does not fit.
        """
        self.scene, self.worlds, self.config = scene, worlds, config
        self.robot: Robot = robot_of(config.robot)
        self.replayed = config.walkers == REPLAY
        self.walker: Policy = policy(config.walkers, scene)
        self.spawn: SpawnModel = spawn_model(REPLAY if self.replayed else config.spawn, scene)
        self.react = config.visible and not isinstance(self.walker, ReplayPolicy)
        """Whether people see robots, and can react to them."""
        self.recorded = self.spawn.start == "recorded"
        horizon_s = config.horizon_s
        if horizon_s is None:
            horizon_s = scene.horizon_s if self.recorded else LONGEST_CROWD_S
            horizon_s = max(min(horizon_s, scene.horizon_s), config.time_limit_s)
        if self.recorded and horizon_s > scene.horizon_s:
            raise SettingError(
                "time_limit_s" if config.horizon_s is None else "horizon_s",
                got=f"{horizon_s:g}",
                expected=f"at most {scene.horizon_s:g} s, the length of the recording",
            )
        self.episode_frames = scene.frames(config.time_limit_s) + 1
        self.frames = max(scene.frames(horizon_s), self.episode_frames) + 1
        self.people = config.max_alive or _most_at_once(self.spawn, scene, horizon_s)
        shown = settings_for(self.walker, Settings(max_alive=self.people + 1))
        rows = 2 * worlds if config.costs else worlds
        self.simulation = Simulation(scene, worlds=rows, settings=shown)
        self._people = np.ones(self.simulation.slots.alive.shape, bool)
        self._people[:, -1] = False
        self._own_frame = np.zeros(self._people.shape, bool)
        self._actor = Actor(self.walker, self.simulation)
        self._own_frame[self._people] = self._actor.own_frame
        self._seed = np.zeros(worlds, np.int64)
        self._number = np.zeros(worlds, np.int64)
        self.before = self.simulation.slots.position[:, :-1].copy()
        self.was_there = np.zeros((rows, self.people), bool)

    @property
    def reach_m(self) -> float:
        """Distance of the centres at which a robot touches a person, metres."""
        return self.robot.radius_m + self.person_radius_m

    @property
    def person_radius_m(self) -> float:
        """Radius of a person: that of its body or, without bodies, of its disc. In metres."""
        motion = self.scene.motion
        return motion.body_radius_m or motion.person_radius_m

    def begin(self, worlds: Int[np.ndarray, " n"], seeds: Int[np.ndarray, " n"]) -> None:
        """Let new crowds enter some worlds; those that follow are drawn from the same seeds."""
        self._seed[worlds], self._number[worlds] = seeds, 0
        if len(worlds) == self.worlds:  # what policies draw themselves, they draw for all worlds
            rows = self.simulation.worlds
            seed = int(seeds[0])
            self._actor.reset(
                *(World(self.spawn, seed, k).generator("policy") for k in range(rows))
            )
        self._enter(worlds)

    def renew(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Replace the crowds of those of the worlds in which no whole episode is left."""
        left = self.frames - self.simulation.clock.frame[worlds]
        over = worlds[left <= self.episode_frames]
        if len(over):
            self._number[over] += 1
            self._enter(over)

    def _enter(self, worlds: Int[np.ndarray, " n"]) -> None:
        drawn_for = [
            World(self.spawn, int(self._seed[w]), int(self._number[w])) for w in worlds.tolist()
        ]
        drawn = draw(self.scene, drawn_for, frames=self.frames, start=None, scripted=self.replayed)
        settings = Settings(max_alive=self.people)
        alone = Simulation(self.scene, worlds=len(worlds), settings=settings)
        if self.recorded:
            self._start_within(alone, drawn_for, drawn.events)
        else:
            drawn.begin(alone, Straight())
        simulation = self.simulation
        simulation.copy_worlds(worlds, alone, np.arange(len(worlds)))
        # The robot's event is one of padding, which is never due.
        simulation.queue = simulation.queue.widened(1 + max(map(len, simulation.events)))
        simulation.slots.event[:, -1] = simulation.queue.due.shape[1] - 1
        self._actor.begin_anew(worlds, [world.generator("policy") for world in drawn_for])
        self._stand(worlds)

    def _start_within(
        self, simulation: Simulation, worlds: list[World], events: list[SpawnEvents]
    ) -> None:
        """Begin recorded crowds at random frames, with the people who were there then.

        They start where they were recorded in that frame.
        """
        crowd = self.spawn.recording  # type: ignore[attr-defined]  # it is a Replay
        simulation.reset(events, horizon=self.frames, first_frame=LONG_AGO)
        queue, clock = simulation.queue, simulation.clock
        for w, world in enumerate(worlds):
            rng = crowd_generator(world.seed, world.number)
            frame = int(rng.integers(max(1, self.frames - self.episode_frames)))
            size = len(events[w])
            first, last = crowd.first[:size], crowd.last[:size]
            queue.status[w, :size][last <= frame] = DROPPED
            there = np.flatnonzero((first < frame) & (frame < last))
            row = crowd.offsets[there] + frame - first[there]
            queue.start[w, there] = crowd.xy[row]
            queue.velocity[w, there] = (crowd.xy[row + 1] - crowd.xy[row]) / self.scene.dt_s
            queue.may_wait[w, there] = False
            clock.frame[w] = frame - 1
        simulation.step(np.zeros(simulation.slots.position.shape, np.float32))

    def _stand(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Let people stand where they are until the next frame begins."""
        slots = self.simulation.slots
        self.before[worlds] = slots.position[worlds, :-1]
        self.was_there[worlds] = slots.alive[worlds, :-1]

    def fork(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Let the twins of some worlds go on from their present state, without the robot."""
        twins = worlds + self.worlds
        self.simulation.copy_worlds(twins, self.simulation, worlds)
        self._actor.copy_worlds(twins, worlds)
        self.simulation.slots.alive[twins, -1] = False

    def place(self, worlds: Int[np.ndarray, " n"], poses: Poses) -> None:
        """Put the robots of some worlds where they begin an episode."""
        slots = self.simulation.slots
        slots.alive[worlds, -1] = self.react
        slots.scripted[worlds, -1] = True
        slots.leave[worlds, -1] = -1
        slots.born[worlds, -1] = LONG_AGO
        slots.speed[worlds, -1] = self.robot.max_speed_mps
        slots.goal[worlds, -1] = slots.target[worlds, -1] = poses.goal[worlds]
        slots.wider[worlds, -1] = max(0.0, self.robot.radius_m - self.person_radius_m)
        self.show(poses, worlds)

    def show(self, poses: Poses, worlds: Int[np.ndarray, " n"] | slice = slice(None)) -> None:
        """Let people see where the robots of some worlds are, after a frame."""
        slots = self.simulation.slots
        at = (np.arange(self.worlds)[worlds], -1)
        slots.position[at] = poses.position[worlds]
        slots.velocity[at] = poses.velocity[worlds]
        slots.heading[at] = np.stack(
            [np.cos(poses.heading[worlds]), np.sin(poses.heading[worlds])], axis=1
        )

    def advance(self) -> None:
        """Let everyone walk for a frame; robots go on with their present velocities meanwhile."""
        simulation, slots = self.simulation, self.simulation.slots
        np.copyto(self.before, slots.position[:, :-1])
        np.copyto(self.was_there, slots.alive[:, :-1])
        actions = self._actor.actions(self._people)
        robots = slots.velocity[:, -1] / np.float32(self.scene.motion.max_speed_mps)
        actions[:, -1] = robots
        simulation.step(actions, own_frame=self._own_frame)


def crowd_generator(seed: int, number: int) -> Generator:
    """Random generator for the choice of the frame in which a recorded crowd begins."""
    return default_rng(SeedSequence(seed, spawn_key=(number, _CROWD_KEY)))


def _most_at_once(spawn: SpawnModel, scene: Scene, horizon_s: float) -> int:
    """Twice the number of people present at most if all walk straight, and a few more."""
    events = spawn.sample(horizon_s, scene, default_rng(0))
    via = np.where(np.isnan(events.via), events.start, events.via)
    way = np.linalg.norm(via - events.start, axis=1) + np.linalg.norm(events.goal - via, axis=1)
    stay_s = np.minimum(way / np.maximum(events.speed, 0.1) + events.wait_s, scene.timeout_s)
    gone_s = np.sort(events.time_s + stay_s)
    entered = np.arange(1, len(events) + 1)
    most = int((entered - np.searchsorted(gone_s, events.time_s)).max(initial=0))
    return 2 * most + _SPARE_SLOTS
