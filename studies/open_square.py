"""A made-up scene and crowd on which the speed of the core is measured."""

from dataclasses import replace
from typing import ClassVar

import msgspec
import numpy as np

from crowdbench.scene import Bounds, Scene, Wall, load_scene
from crowdbench.spawn import SpawnEvents
from crowdbench.spawn.events import entering
from crowdbench.spawn.model import Start

PERSONS_PER_M2 = 0.07
M2_PER_BOX = 300.0
MARGIN_M = 1.5  # so that nobody leaves the scene during a measurement


def open_square(persons: int, body_radius_m: float = 0.0) -> Scene:
    """A square scene with 0.07 persons/m² and a box of 2 m per 300 m², in which no trip ends."""
    eth = load_scene("eth-v0")
    side_m = (persons / PERSONS_PER_M2) ** 0.5
    rng = np.random.default_rng(persons)
    corners = rng.random((max(2, round(side_m**2 / M2_PER_BOX)), 2)) * (side_m - 3)
    walls = tuple(
        Wall(f"box {k}", ((x, y), (x + 2, y), (x + 2, y + 2), (x, y + 2)))
        for k, (x, y) in enumerate(corners.tolist())
    )
    return replace(
        eth,
        bounds=Bounds(0.0, side_m, 0.0, side_m),
        walls=walls,
        motion=msgspec.structs.replace(eth.motion, body_radius_m=body_radius_m),
        recording=msgspec.structs.replace(eth.recording, dwell_p99_s=1e6),
    )


def crowd_at_once(scene: Scene, persons: int, seed: int) -> SpawnEvents:
    """Events of `persons` people who enter in the first frame, with goals far away."""
    rng = np.random.default_rng(seed)
    b = scene.bounds
    lower = np.array([b.x_min_m, b.y_min_m]) + MARGIN_M
    upper = np.array([b.x_max_m, b.y_max_m]) - MARGIN_M
    places = np.empty((0, 2))
    while len(places) < persons:
        draws = rng.uniform(lower, upper, (persons, 2))
        places = np.concatenate([places, draws[scene.walkable(draws)]])
    nowhere = np.zeros(persons, np.int32)
    return entering(
        time_s=np.zeros(persons),
        start=places[:persons],
        goal=np.full((persons, 2), 1e4),
        spawn_area=nowhere,
        goal_area=nowhere,
        speed=np.ones(persons),
    )


class AtOnce:
    """A spawn model in which everyone enters in the first frame."""

    name = "at-once"
    start: ClassVar[Start] = "empty"

    def __init__(self, persons: int) -> None:
        self.persons = persons

    def sample(self, horizon_s: float, scene: Scene, rng: np.random.Generator) -> SpawnEvents:
        """Everyone, whatever the horizon."""
        return crowd_at_once(scene, self.persons, 0)


def to_and_fro(shape: tuple[int, ...]) -> list[np.ndarray]:
    """Random actions, each followed by its opposite, so that the density stays constant."""
    rng = np.random.default_rng(0)
    there = [(rng.standard_normal(shape) * 0.1).astype(np.float32) for _ in range(20)]
    return [action for a in there for action in (a, -a)]
