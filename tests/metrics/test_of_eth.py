"""What the metrics say of the ETH recording: known facts, and what a broken crowd looks like."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from comparisons import sample

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Metric, MetricResult, Place, distance, metrics_for
from crowdbench.metrics.arrivals import InterSpawn
from crowdbench.metrics.interaction import Avoidance, OverlapRate, WallClearance
from crowdbench.metrics.motion import Speed
from crowdbench.metrics.presence import AgentsOverTime
from crowdbench.metrics.trips import GoalShare
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import fit_areas


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("eth-v0")


@pytest.fixture(scope="module")
def fitted(opentraj: Path, scene: Scene) -> tuple[Trajectories, Place]:
    """The recording, its people in their areas, and its place."""
    crowd = read_published(SOURCES["eth"], opentraj)
    areas, crowd = fit_areas(crowd, scene, scene.clustering["default"])
    b = scene.bounds
    place = Place(
        spawn_areas=len(areas.spawn),
        goal_areas=len(areas.goal),
        bounds_m=(b.x_min_m, b.x_max_m, b.y_min_m, b.y_max_m),
        radius_m=scene.motion.person_radius_m,
        walls=tuple(wall.corners_m for wall in scene.walls),
    )
    return crowd, place


@pytest.fixture(scope="module")
def eth(fitted: tuple[Trajectories, Place]) -> Trajectories:
    return fitted[0]


@pytest.fixture(scope="module")
def place(fitted: tuple[Trajectories, Place]) -> Place:
    return fitted[1]


@pytest.fixture(scope="module")
def blocks(eth: Trajectories) -> TimeBlocks:
    return cut(eth.observed, block_s=60.0, dt_s=eth.dt_s, grid_s=eth.grid_s)


def time_shifted(crowd: Trajectories, seed: int) -> Trajectories:
    """Everyone's life begins up to 30 s earlier or later: nobody keeps clear of anybody."""
    shift = np.random.default_rng(seed).integers(-75, 76, len(crowd))
    first = np.maximum(crowd.first + shift, 0)
    frames = int((first + np.diff(crowd.offsets)).max())
    return replace(crowd, first=first, frames=frames)


def avoids(crowd: Trajectories, blocks: TimeBlocks, place: Place) -> float:
    """By how much strangers keep away from each other, m."""
    return -distance(Avoidance(), crowd, crowd, blocks, place).recorded


def test_all_metrics_but_that_of_long_blocks_see_something(eth, blocks, place):
    metrics = metrics_for(blocks)
    assert len(metrics) == 28
    for metric in metrics:
        result = distance(metric, eth, eth, blocks, place)
        assert result.distance == 0
        assert result.n >= 100


@pytest.mark.parametrize(
    ("metric", "value", "tolerance"),
    [
        (AgentsOverTime(), 6.05, 0.02),
        (InterSpawn(), 1.54, 0.01),
        (OverlapRate(), 0.0485, 0.002),
        (Speed(), 1.352, 0.005),
        (GoalShare(), 1.0, 0.0),
        (WallClearance(), 1.955, 0.002),
    ],
    ids=lambda value: value.name if isinstance(value, Metric) else "",
)
def test_typical_values_are_known(eth, blocks, place, metric, value, tolerance):
    result: MetricResult = distance(metric, eth, eth, blocks, place)
    assert result.recorded == pytest.approx(value, abs=tolerance)


def test_311_people_enter_in_the_blocks(eth, blocks):
    entered = blocks.of_arrivals(eth)[0]
    assert len(entered) == eth.entered.sum() == 311
    assert sum(map(len, sample(InterSpawn(), eth, blocks))) == 311 - 15  # one fewer a block


def test_strangers_keep_clear_of_each_other(eth, blocks, place):
    assert avoids(eth, blocks, place) == pytest.approx(0.306, abs=0.002)


@pytest.mark.parametrize("seed", range(3))
def test_strangers_in_a_time_shifted_crowd_do_not(eth, blocks, place, seed):
    assert abs(avoids(time_shifted(eth, seed), blocks, place)) < 0.08
