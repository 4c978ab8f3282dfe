"""How the cost of a simulation grows with people, worlds, threads, space, walls and rollouts."""

import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar

import msgspec
import numpy as np

from crowdbench.compilation import THREADS
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.policies import Policy, SocialForce, Straight
from crowdbench.registry import spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import Bounds, Scene, Wall, load_scene
from crowdbench.scoring.reference import Reference, read_reference, summarise
from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import Areas, SpawnEvents
from crowdbench.spawn.areas import Gaussians
from crowdbench.spawn.events import entering
from crowdbench.spawn.model import Start
from studies.open_square import PERSONS_PER_M2, crowd_at_once, open_square, to_and_fro

PEOPLE = (20, 50, 100, 200, 500, 1000, 2000, 5000)
WORLDS = (1, 4, 16, 64, 256, 1024, 4096)
PER_WORLD = 50
SIDES = (1, 2, 4, 8)
"""Sides of the scene, as multiples of that of the first row."""
IN_SCENE = 200
BOXES = (0, 10, 100, 1000)
ROLLOUTS = (5, 10, 20, 40)
MEASURE_S = 1.0
OBSERVATION = "social-1"
CITY = 10_000
"""Number of people of the city."""
STREETS = 11
"""Streets of the city in each direction."""
BLOCK_M = 60.0
STREET_M = 14.0
CITY_S = 60.0
"""Length of the rollouts of the city, seconds."""
CITY_TITLE = "A made-up city"


@dataclass(frozen=True)
class Row:
    """A measurement: a size, and figures by the names of columns."""

    size: str
    figures: dict[str, float]


@dataclass(frozen=True)
class Table:
    """How figures change with one size."""

    title: str
    size: str
    """What the first column counts."""
    rows: Sequence[Row]


def tables(people: Sequence[int] = PEOPLE, worlds: Sequence[int] = WORLDS) -> Iterator[Table]:
    """Measure one table after the other."""
    # These two first, because memory is the most that the process has used so far.
    yield Table("Rollouts of the plaza, simulated and scored", "rollouts", list(_rollouts()))
    yield Table(CITY_TITLE, "walker", list(of_city()))
    yield Table(
        f"People in one world, at {PERSONS_PER_M2} persons/m²", "people",
        [Row(f"{n:,}", _with_and_without_walls(n)) for n in people],
    )  # fmt: skip
    yield Table(
        f"Worlds of {PER_WORLD} people", "worlds",
        [Row(f"{w:,}", _speed(open_square(PER_WORLD), w, PER_WORLD)) for w in worlds],
    )  # fmt: skip
    yield Table(
        f"Threads, 64 worlds of {PER_WORLD} people", "threads",
        [Row(str(n), _in_threads(n)) for n in _threads()],
    )  # fmt: skip
    yield Table(
        f"Size of the scene, {IN_SCENE} people", "side in metres",
        [Row(f"{side:.0f}", _speed(scene, 1, IN_SCENE)) for side, scene in _wider()],
    )  # fmt: skip
    yield Table(
        f"Walls, {IN_SCENE} people in the same square", "boxes of four walls",
        [Row(f"{n:,}", _speed(_walled(n), 1, IN_SCENE)) for n in BOXES],
    )  # fmt: skip


def _with_and_without_walls(persons: int) -> dict[str, float]:
    scene = open_square(persons)
    empty = _speed(replace(scene, walls=()), 1, persons)
    return {
        "boxes": float(len(scene.walls)),
        **_speed(scene, 1, persons),
        **{f"{name}, without boxes": value for name, value in empty.items()},
    }


def _speed(scene: Scene, worlds: int, persons: int) -> dict[str, float]:
    simulation = Simulation(
        scene, worlds=worlds, settings=Settings(max_alive=persons, observation=OBSERVATION)
    )
    simulation.reset([crowd_at_once(scene, persons, w) for w in range(worlds)], horizon=10**9)
    actions = to_and_fro((worlds, persons, 2))

    def chunk() -> int:
        steps = 0
        for action in actions[: max(2, min(40, 200_000 // (worlds * persons)))]:
            simulation.step(action, own_frame=False)
            simulation.observe()
            steps += int(simulation.slots.alive.sum())
        return steps

    rate = _best_rate(chunk)
    return {
        "agent-steps/s, million": rate / 1e6,
        "ms per step": 1e3 * worlds * persons / rate,
    }


def _best_rate(chunk: Callable[[], int]) -> float:
    """The highest speed of all calls of `chunk` after the first, which compiles."""
    chunk()
    best, ends = 0.0, time.perf_counter() + MEASURE_S
    while time.perf_counter() < ends:
        began = time.perf_counter()
        done = chunk()
        best = max(best, done / (time.perf_counter() - began))
    return best


def _threads() -> list[int]:
    cores = os.cpu_count() or 1
    return sorted({1, 2, *(n for n in (4, 8, 16, 32, 64) if n <= cores)})


def _in_threads(threads: int) -> dict[str, float]:
    """The speed in a new process, because the number of threads is fixed when one starts."""
    code = (
        "from studies.growth import _speed, open_square, PER_WORLD; import msgspec, sys;"
        "sys.stdout.buffer.write(msgspec.json.encode("
        "_speed(open_square(PER_WORLD), 64, PER_WORLD)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {THREADS: str(threads)},
        capture_output=True,
        check=True,
    )
    return msgspec.json.decode(done.stdout, type=dict[str, float])


def _wider() -> Iterator[tuple[float, Scene]]:
    """The same walls and people in larger and larger squares."""
    scene = open_square(IN_SCENE)
    for times in SIDES:
        side = scene.bounds.x_max_m * times
        yield side, replace(scene, bounds=Bounds(0.0, side, 0.0, side))


def _walled(boxes: int) -> Scene:
    scene = open_square(IN_SCENE)
    side = scene.bounds.x_max_m
    corners = np.random.default_rng(boxes).random((boxes, 2)) * (side - 1)
    walls = tuple(
        Wall(f"box {k}", ((x, y), (x + 0.3, y), (x + 0.3, y + 0.3), (x, y + 0.3)))
        for k, (x, y) in enumerate(corners.tolist())
    )
    return replace(scene, walls=walls)


def _rollouts() -> Iterator[Row]:
    scene = load_scene("plaza-v0")
    reference, spawn = read_reference(scene), spawn_model("poisson-gmm", scene)
    reference.score(rollout(scene, spawn, SocialForce(), seed=0))  # compiles
    for number in ROLLOUTS:
        began, size = time.perf_counter(), 0
        for seed in range(number):
            crowd = rollout(scene, spawn, SocialForce(), seed=seed)
            summarise(crowd, reference.blocks, reference.place)
            size += _stored(crowd)
        took_s = time.perf_counter() - began
        yield Row(
            str(number),
            {
                "seconds": took_s,
                "seconds per rollout": took_s / number,
                "MB stored per rollout": size / number / 1e6,
                "most memory of the process, MB": _memory_mb(),
            },
        )


def _stored(crowd: Trajectories) -> int:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "crowd.parquet"
        write_parquet(crowd, path)
        return path.stat().st_size


def _memory_mb() -> float:
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most / (1e6 if sys.platform == "darwin" else 1e3)


def city() -> Scene:
    """A made-up city of square blocks of houses, with streets between and around them."""
    eth = load_scene("eth-v0")
    pitch = BLOCK_M + STREET_M
    side = (STREETS - 1) * pitch + STREET_M
    low = [STREET_M + k * pitch for k in range(STREETS - 1)]
    blocks = []
    for i, x in enumerate(low):
        for j, y in enumerate(low):
            x2, y2 = x + BLOCK_M, y + BLOCK_M
            blocks.append(Wall(f"block {i}-{j}", ((x, y), (x2, y), (x2, y2), (x, y2))))
    return replace(
        eth,
        id="city-v0",
        bounds=Bounds(0.0, side, 0.0, side),
        walls=tuple(blocks),
        recording=msgspec.structs.replace(
            eth.recording, name="city", frames=eth.frames(CITY_S), dwell_p99_s=600.0
        ),
        protocol=msgspec.structs.replace(eth.protocol, block_s=CITY_S / 6),
    )


class Citizens:
    """People who are there from the start, on their ways along streets; nobody enters later."""

    name = "citizens"
    start: ClassVar[Start] = "empty"

    def sample(self, horizon_s: float, scene: Scene, rng: np.random.Generator) -> SpawnEvents:
        """10,000 people with goals 100 to 300 m along their streets."""
        pitch, side = BLOCK_M + STREET_M, scene.bounds.x_max_m
        street = rng.integers(STREETS, size=CITY) * pitch + rng.uniform(1, STREET_M - 1, CITY)
        along = rng.uniform(1, side - 1, CITY)
        far = rng.uniform(100, 300, CITY) * np.where(along < side / 2, 1, -1)
        start, goal = np.stack([along, street], axis=1), np.stack([along + far, street], axis=1)
        turned = rng.random(CITY) < 0.5
        start[turned], goal[turned] = start[turned, ::-1], goal[turned, ::-1]
        nowhere = np.zeros(CITY, np.int32)
        return entering(
            time_s=rng.uniform(0, 5, CITY), start=start, goal=goal, spawn_area=nowhere,
            goal_area=nowhere, speed=rng.normal(1.3, 0.2, CITY).clip(0.5, 2.0),
        )  # fmt: skip


def of_city(policies: Sequence[Policy] = (Straight(), SocialForce())) -> Iterator[Row]:
    """Rollouts of the city, and their scoring against another one by social forces."""
    scene, spawn = city(), Citizens()
    sizes = Settings(max_alive=CITY, observation=OBSERVATION)
    Simulation(load_scene("plaza-v0"), settings=sizes).observe()  # compiles
    began = time.perf_counter()
    Simulation(scene, settings=sizes)
    set_up_s = time.perf_counter() - began
    for policy in policies:  # compiles
        rollout(scene, spawn, policy, seed=0, horizon_s=2.0)
    recorded = rollout(scene, spawn, SocialForce(), seed=0)
    reference = Reference.of(recorded, scene, _areas_of(scene))
    for policy in policies:
        began = time.perf_counter()
        crowd = rollout(scene, spawn, policy, seed=1)
        rolled_s = time.perf_counter() - began
        began = time.perf_counter()
        results = reference.score(crowd)
        yield Row(
            policy.name,
            {
                "people": float(len(crowd)),
                "seconds to set up": set_up_s,
                "agent-steps/s, million": len(crowd.xy) / rolled_s / 1e6,
                "seconds to simulate": rolled_s,
                "seconds to score": time.perf_counter() - began,
                "metrics": float(len(results)),
                "most memory of the process, MB": _memory_mb(),
            },
        )


def _areas_of(scene: Scene) -> Areas:
    """One broad spawn area and one broad goal area."""
    middle, width = scene.bounds.x_max_m / 2, scene.bounds.x_max_m / 4
    everywhere = Gaussians(np.full((1, 2), middle), np.eye(2)[None] * width**2)
    return Areas(scene.id, everywhere, everywhere, np.ones((1, 1)), np.full(101, 1.3), (0.0, 0.0))
