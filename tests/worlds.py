"""Small scenes, people and crowds made in code, for tests of the simulation."""

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace

import numpy as np
from msgspec import structs

from crowdbench.policies import Policy
from crowdbench.run.acting import Actor
from crowdbench.scene import Bounds, Scene, Wall, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import Areas, PoissonGMM, SpawnEvents
from crowdbench.spawn.areas import Gaussians

Point = tuple[float, float]
FAR = 1000  # a horizon that no short test reaches


def square(
    half_m: float = 10.0, *polygons: tuple[Point, ...], dwell_p99_s: float = 60.0, **motion: float
) -> Scene:
    """A square scene around the origin with frames of 0.4 s and the polygons as walls.

    People have bodies only if `motion` says so.
    """
    eth = load_scene("eth-v0")
    return replace(
        eth,
        id="square-v0",
        bounds=Bounds(-half_m, half_m, -half_m, half_m),
        walls=tuple(Wall(f"wall {k}", corners) for k, corners in enumerate(polygons)),
        motion=structs.replace(eth.motion, **{"body_radius_m": 0.0} | motion),
        recording=structs.replace(eth.recording, dwell_p99_s=dwell_p99_s),
    )


BODY_M = 0.15


def with_bodies(scene: Scene, radius_m: float = BODY_M) -> Scene:
    """The same scene, in which people have bodies."""
    return replace(scene, motion=structs.replace(scene.motion, body_radius_m=radius_m))


def box(x0: float, y0: float, x1: float, y1: float) -> tuple[Point, ...]:
    """Corners of a rectangle."""
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


@dataclass(frozen=True)
class Person:
    """One spawn event, by default of someone who walks along the x axis."""

    time_s: float = 0.0
    start: Point = (0.0, 0.0)
    goal: Point = (8.0, 0.0)
    speed: float = 1.0
    velocity: Point = (0.0, 0.0)
    entered: bool = True
    leave_frame: int = -1
    scripted: bool = False
    censored: bool = False
    group: int = -1
    via: Point = (np.nan, np.nan)
    wait_s: float = 0.0
    spawn_area: int = 0
    goal_area: int = 0


def events(*people: Person) -> SpawnEvents:
    """The events of people who come by ascending time."""
    kinds = dict.fromkeys(("start", "goal", "speed", "velocity", "via"), np.float32)
    columns = {}
    for f in fields(SpawnEvents):
        column = np.array([getattr(person, f.name) for person in people])
        columns[f.name] = column.astype(kinds.get(f.name, column.dtype))
    return SpawnEvents(**columns)


def simulate(
    scene: Scene, *people: Person, horizon: int = FAR, settings: Settings | None = None
) -> Simulation:
    """A simulation of one world that has just begun."""
    simulation = Simulation(scene, settings=settings or Settings(max_alive=16))
    simulation.reset([events(*people)], horizon=horizon)
    return simulation


def step(simulation: Simulation, velocities: Mapping[int, Point] | None = None) -> None:
    """One step of world 0: persons by id walk at these velocities (m/s), the others stand."""
    slots = simulation.slots
    actions = np.zeros(slots.position.shape, np.float32)
    for person, velocity in (velocities or {}).items():
        at = (slots.person[0] == person) & slots.alive[0]
        actions[0, at] = np.array(velocity) / simulation.scene.motion.max_speed_mps
    simulation.step(actions)


def alive(simulation: Simulation, world: int = 0) -> list[int]:
    """Ids of those who are there, ascending."""
    slots = simulation.slots
    return sorted(slots.person[world, slots.alive[world]].tolist())


def ended(simulation: Simulation, world: int = 0) -> dict[int, int]:
    """Outcome by id of those whose life ended in this step."""
    slots = simulation.slots
    over = slots.ended[world] != 0
    return dict(
        zip(slots.person[world, over].tolist(), slots.ended[world, over].tolist(), strict=True)
    )


def slot_of(simulation: Simulation, person: int) -> int:
    """The slot of a person who is there, in world 0."""
    slots = simulation.slots
    return int(np.flatnonzero((slots.person[0] == person) & slots.alive[0])[0])


def place(simulation: Simulation, xy: np.ndarray) -> None:
    """Put the persons in the first slots of world 0 elsewhere."""
    simulation.slots.position[0, : len(xy)] = xy


def standing(scene: Scene, xy: np.ndarray, **settings: float) -> Simulation:
    """A simulation in which people stand at these points."""
    people = [Person(start=tuple(point), goal=(0.0, 0.0)) for point in xy.tolist()]
    sizes = Settings(max_alive=max(1, len(people)), **settings)
    return simulate(scene, *people, settings=sizes)


def poisson(scene: Scene, rate_per_s: float = 0.5) -> PoissonGMM:
    """People who cross the scene from its left to its right and back."""
    b = scene.bounds
    middle = (b.y_min_m + b.y_max_m) / 2
    width = b.x_max_m - b.x_min_m
    means = np.array(
        [[b.x_min_m + width / 10, middle], [b.x_max_m - width / 10, middle]], dtype=np.float64
    )
    areas = Areas(
        scene=scene.id,
        spawn=Gaussians(means, np.stack([0.25 * np.eye(2)] * 2)),
        goal=Gaussians(means, np.stack([0.25 * np.eye(2)] * 2)),
        flow=np.array([[0.0, 1.0], [1.0, 0.0]]),
        speed_quantiles=np.linspace(0.8, 1.6, 101),
        left_out=(0.0, 0.0),
    )
    return PoissonGMM(areas, np.full(2, rate_per_s / 2))


def directions(rays: int) -> np.ndarray:
    """(R, 2) unit vectors of the rays."""
    angle = 2 * np.pi * np.arange(rays) / rays
    return np.stack([np.cos(angle), np.sin(angle)], axis=1)


def wall_distances(scene: Scene, xy: np.ndarray, rays: int, range_m: float) -> np.ndarray:
    """(n, R) distance along each ray to the nearest of all wall segments, by Cramer's rule."""
    a, b = scene.wall_segments[:, :2], scene.wall_segments[:, 2:]
    way, to_a, edge = directions(rays)[:, None], a - xy[:, None, None], b - a
    cross = way[..., 0] * edge[:, 1] - way[..., 1] * edge[:, 0]
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (to_a[..., 0] * edge[:, 1] - to_a[..., 1] * edge[:, 0]) / cross
        u = (to_a[..., 0] * way[..., 1] - to_a[..., 1] * way[..., 0]) / cross
    t = np.where((t >= 0) & (u >= 0) & (u <= 1), t, np.inf)
    return np.minimum(t.min(axis=2, initial=np.inf), range_m)


def disc_distances(xy: np.ndarray, rays: int, radius_m: float) -> np.ndarray:
    """(n, R) distance along each ray to the nearest disc of another person, infinite for none."""
    to_centre = xy[None, :, None].astype(np.float64) - xy[:, None, None]
    along = (to_centre * directions(rays)).sum(axis=3)
    beside = np.linalg.norm(to_centre - along[..., None] * directions(rays), axis=3)
    half_chord = np.sqrt(np.maximum(0, radius_m**2 - beside**2))
    t = np.where((beside <= radius_m) & (along >= 0), np.maximum(0, along - half_chord), np.inf)
    t[np.arange(len(xy)), np.arange(len(xy))] = np.inf  # nobody sees itself
    return t.min(axis=1)


def ready(policy: Policy, scene: Scene, seed: int = 0) -> Policy:
    """The policy, about to act in the scene."""
    policy.reset(scene, np.random.default_rng(seed))
    return policy


def actions_of(policy: Policy, simulation: Simulation, who: np.ndarray | None = None) -> np.ndarray:
    """(W, N, 2) actions of a policy that remembers nobody, for everyone or for those in `who`."""
    return Actor(policy, simulation).actions(who)


def walked(policy: Policy, scene: Scene, *people: Person, frames: int) -> np.ndarray:
    """(frames + 1, N, 2) positions of those whom a policy walks, NaN after the arrival."""
    simulation = simulate(scene, *people, settings=Settings(max_alive=len(people)))
    ready(policy, scene)
    path = [simulation.slots.position[0].copy()]
    for _ in range(frames):
        simulation.step(actions_of(policy, simulation))
        there = simulation.slots.alive[0] | (simulation.slots.ended[0] != 0)
        path.append(np.where(there[:, None], simulation.slots.position[0], np.nan))
    return np.array(path)
