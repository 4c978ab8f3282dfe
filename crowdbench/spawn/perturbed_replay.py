"""`perturbed-replay`: people like the recorded ones, a little earlier, later and elsewhere.

Policies are ranked under these arrivals. All recordings are public, so a policy can know recorded
paths by heart, and recognise by start, goal and speed whose path it is to walk. People who never
came have no recorded path. Whoever walks by what is there walks as well among them.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy.random import Generator, SeedSequence, default_rng

from crowdbench.data.table import Trajectories
from crowdbench.files import sha256
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.names import PERTURBED
from crowdbench.spawn.replay import Replay

TIME_S = 2.0
"""Entries are moved by up to this time, uniformly."""
START_M, GOAL_M = 0.3, 0.5
"""Standard deviations of each coordinate by which starts (and via points), and goals, are moved."""
SPEED = 0.05
"""Standard deviation of the factors of speeds and waits, about 1."""
ROOM_M = 0.5
"""Nobody is moved nearer to a wall than this, because honest walkers would bump into it."""
HALVINGS = 4
"""How often a displacement through a wall or out of the bounds is halved before it is left out."""


@dataclass(frozen=True, eq=False)
class PerturbedReplay:
    """The arrivals of `Replay`, with random changes of times, places and speeds.

    Companions are changed alike, so they stay together: the time of entry by up to 2 s; each
    coordinate of the start by 0.3 m and of the goal by 0.5 m (standard deviations), as far as no
    wall is between; the speed and the time of waiting by 5 %. The velocity at entry is turned and
    scaled with the way to the target. People who are there at the beginning keep their places.

    The changes follow from `key` and the random generator. Nobody can prepare for a secret key.
    """

    recording: Trajectories
    key: str = ""
    start: ClassVar[Start] = "recorded"

    @property
    def name(self) -> str:
        """Name of the model in tables, without its key."""
        return PERTURBED

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """The changed events in [0, `horizon_s`)."""
        words = np.frombuffer(bytes.fromhex(sha256(self.key.encode())), np.uint32)
        rng = default_rng(SeedSequence([*words.tolist(), int(rng.integers(2**62))]))
        events = Replay(self.recording).sample(scene.horizon_s, scene, rng)
        found = perturbed(events, scene, rng)
        return found[found.time_s < horizon_s - 1e-9]


def perturbed(events: SpawnEvents, scene: Scene, rng: Generator) -> SpawnEvents:
    """The events with random changes, in the order of their new times."""
    alone = events.group < 0
    who = np.where(alone, events.group.max(initial=-1) + 1 + np.arange(len(events)), events.group)
    _, group = np.unique(who, return_inverse=True)
    number = int(group.max(initial=-1)) + 1
    delay_s = rng.uniform(-TIME_S, TIME_S, number)[group]
    from_start = rng.normal(0.0, START_M, (number, 2))[group] * events.entered[:, None]
    from_goal = rng.normal(0.0, GOAL_M, (number, 2))[group]
    at_via = rng.normal(0.0, START_M, (number, 2))[group]
    speed = np.exp(rng.normal(0.0, SPEED, number))[group]
    wait = np.exp(rng.normal(0.0, SPEED, number))[group]
    start = moved(events.start, from_start, group, scene)
    goal = moved(events.goal, from_goal, group, scene)
    via, stops = events.via.astype(np.float64), ~np.isnan(events.via[:, 0])
    via[stops] = moved(via[stops], at_via[stops], group[stops], scene)
    target = np.where(stops[:, None], events.via, events.goal)
    turned = turn(
        events.velocity, target - events.start, np.where(stops[:, None], via, goal) - start
    )
    time_s = events.time_s + np.where(events.entered, delay_s, 0.0)
    whole = (time_s >= 0.0) & (time_s < scene.horizon_s - scene.dt_s)
    time_s = np.where(whole, time_s, events.time_s)
    late = np.rint((time_s - events.time_s) / scene.dt_s).astype(np.int64)
    leave = np.where(events.leave_frame < 0, -1, events.leave_frame + late)
    fastest = scene.motion.max_speed_mps
    found = replace(
        events,
        time_s=time_s,
        start=start.astype(np.float32),
        goal=goal.astype(np.float32),
        via=via.astype(np.float32),
        wait_s=events.wait_s * wait,
        speed=np.minimum(events.speed * speed, fastest).astype(np.float32),
        velocity=(turned * speed[:, None]).astype(np.float32),
        leave_frame=leave,
    )
    return found[np.argsort(time_s, kind="stable")]


def moved(
    points: Float[np.ndarray, "n 2"],
    by: Float[np.ndarray, "n 2"],
    group: Int[np.ndarray, " n"],
    scene: Scene,
) -> Float[np.ndarray, "n 2"]:
    """The points, moved as far as no wall is between; the points of a group are moved alike.

    `group` are numbers from 0.
    """
    from_m, by = points.astype(np.float64), by.copy()
    for _ in range(HALVINGS):
        blocked = np.zeros(int(group.max(initial=-1)) + 1, dtype=bool)
        blocked[group[_blocked(from_m, from_m + by, scene)]] = True
        if not blocked.any():
            return from_m + by
        by[blocked[group]] /= 2
    blocked[group[_blocked(from_m, from_m + by, scene)]] = True
    by[blocked[group]] = 0.0
    return from_m + by


def _blocked(
    a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"], scene: Scene
) -> Bool[np.ndarray, " n"]:
    """Which ways from a to b lead through a wall, nearer to one, or to where nobody can walk."""
    walls = scene.obstacles
    through = shapely.intersects(shapely.linestrings(np.stack([a, b], axis=1)), walls)
    room, left = (
        np.nan_to_num(shapely.distance(shapely.points(p), walls), nan=np.inf) for p in (a, b)
    )
    nearer = left < np.minimum(room, ROOM_M)
    return np.asarray((a != b).any(axis=1) & (through | nearer | ~scene.walkable(b)))


def turn(
    velocity: Float[np.ndarray, "n 2"],
    before: Float[np.ndarray, "n 2"],
    now: Float[np.ndarray, "n 2"],
) -> Float[np.ndarray, "n 2"]:
    """The velocities, turned as the way `before` has to be turned into the direction of `now`."""
    was, new = (way[:, 0] + 1j * way[:, 1] for way in (before, now))
    far = (np.abs(was) > 0) & (np.abs(new) > 0)
    angle = np.where(far, np.angle(new * np.conj(was)), 0.0)
    z = (velocity[:, 0] + 1j * velocity[:, 1]) * np.exp(1j * angle)
    return np.stack([z.real, z.imag], axis=1)
