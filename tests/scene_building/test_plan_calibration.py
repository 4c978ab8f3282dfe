"""Samples of plans have as many companions as the recording, by the rule that finds both."""

from dataclasses import replace

import numpy as np
import pytest

from crowdbench.registry import FITTED, recording_of
from crowdbench.scene import load_scene
from crowdbench.scene_building import plan_calibration
from crowdbench.scene_building.plan_calibration import (
    adjustment,
    calibrated,
    straight_walks,
)
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import SpawnEvents, blocks_of, entering
from crowdbench.spawn.links import Adjustment
from crowdbench.spawn.plan_fitting import fit_plans, marks_of
from crowdbench.spawn.planned import PlannedAreas
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.companions import groups_of
from crowdbench.trajectories.table import Trajectories

PLAZA = load_scene("plaza-v0")


def walker(**of: object) -> SpawnEvents:
    """A person who walks 8 m to the right at 1 m/s."""
    values = {
        "time_s": np.array([0.3]),
        "start": np.array([[4.0, 10.0]]),
        "goal": np.array([[12.0, 10.0]]),
        "spawn_area": np.zeros(1, np.int64),
        "goal_area": np.zeros(1, np.int64),
        "speed": np.ones(1),
    }
    return entering(**{**values, **of})  # type: ignore[arg-type]


def test_people_walk_straight_to_their_goals() -> None:
    crowd = straight_walks(walker(), PLAZA)
    dt_s = PLAZA.dt_s
    assert crowd.first.tolist() == [np.ceil(0.3 / dt_s)]
    steps = np.arange(len(crowd.xy))
    np.testing.assert_allclose(crowd.xy[:-1, 0], 4.0 + steps[:-1] * dt_s, atol=1e-5)
    np.testing.assert_allclose(crowd.xy[:, 1], 10.0, atol=1e-5)
    end = 12.0 - PLAZA.motion.goal_radius_m
    assert crowd.xy[-1, 0] == pytest.approx(end, abs=1e-5)


def test_people_wait_at_their_stops() -> None:
    via, wait_s = np.array([[8.0, 13.0]]), np.array([4.0])
    crowd = straight_walks(walker(via=via, wait_s=wait_s), PLAZA)
    at_stop = np.linalg.norm(crowd.xy - via, axis=1) < 1e-4
    assert at_stop.sum() * PLAZA.dt_s == pytest.approx(4.0, abs=PLAZA.dt_s)
    assert len(crowd.xy) * PLAZA.dt_s == pytest.approx(10.0 + 4.0, abs=2 * PLAZA.dt_s)
    speed = np.linalg.norm(np.diff(crowd.xy, axis=0), axis=1) / PLAZA.dt_s
    assert speed.max() <= 1.0 + 1e-4


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return recording_of(PLAZA)


@pytest.fixture(scope="module")
def blocks(crowd: Trajectories) -> TimeBlocks:
    return blocks_of(crowd, PLAZA)


@pytest.fixture(scope="module")
def fitted(crowd: Trajectories, blocks: TimeBlocks) -> PlannedAreas:
    return fit_plans(crowd, blocks, read_areas(PLAZA))


@pytest.fixture(scope="module")
def made(fitted: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks) -> PlannedAreas:
    return calibrated(fitted, crowd, blocks, PLAZA)


def found(areas: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks) -> tuple[float, float]:
    """Share of people with a companion, and that of three or more among them; of ten samples."""
    marks, rng = marks_of(crowd, blocks), np.random.default_rng(7)
    groups = [
        groups_of(straight_walks(areas.draw(marks.time_s, marks.area, PLAZA, rng), PLAZA))
        for _ in range(10)
    ]
    each = np.array([numbers(group) for group in groups])
    share, larger = each.mean(axis=0).tolist()
    return share, larger


def numbers(group: np.ndarray) -> tuple[float, float]:
    together = group[group >= 0]
    return len(together) / len(group), float((np.bincount(together)[together] >= 3).mean())


def test_as_many_companions_are_found_as_in_the_recording(
    fitted: PlannedAreas, made: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks
) -> None:
    recorded = numbers(groups_of(crowd)[marks_of(crowd, blocks).persons])
    np.testing.assert_allclose(found(made, crowd, blocks), recorded, atol=0.04)
    # From far away, too.
    links = replace(fitted.links, log_weight=fitted.links.log_weight + 1.5)
    far = replace(fitted, links=links)
    assert found(far, crowd, blocks)[0] > recorded[0] + 0.05
    again = found(calibrated(far, crowd, blocks, PLAZA), crowd, blocks)
    np.testing.assert_allclose(again, recorded, atol=0.04)


def test_samples_of_a_model_have_companions_like_those_recorded(
    made: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks
) -> None:
    model = FITTED["cox-gmm"].read(PLAZA, made, "full", 0)
    by = adjustment(model, made, crowd, blocks, PLAZA)
    horizon_s = 10 * blocks.exposure_s()
    whole = replace(blocks, frames=np.array([[0, PLAZA.frames(horizon_s)]]), since=np.zeros(1, int))

    def companions(areas: PlannedAreas) -> plan_calibration._Company:
        events = replace(model, areas=areas).sample(horizon_s, PLAZA, np.random.default_rng(9))
        return plan_calibration._company(straight_walks(events, PLAZA), whole, PLAZA)

    recorded = plan_calibration._company(crowd, blocks, PLAZA)
    found = companions(replace(made, links=made.links.adjusted(by)))
    assert found.log_odds == pytest.approx(recorded.log_odds, abs=0.25)
    assert found.mean_size == pytest.approx(recorded.mean_size, abs=0.25)
    assert found.along_m == pytest.approx(recorded.along_m, rel=0.15)
    assert found.across_m == pytest.approx(recorded.across_m, rel=0.1)
    # From far away, too.
    off = Adjustment(more=-1.0, larger=1.0, along=1.5, across=0.6)
    far = replace(made, links=made.links.adjusted(off))
    assert companions(far).log_odds < recorded.log_odds - 0.3
    back = adjustment(model, far, crowd, blocks, PLAZA)
    again = companions(replace(far, links=far.links.adjusted(back)))
    assert again.log_odds == pytest.approx(recorded.log_odds, abs=0.25)
    assert again.mean_size == pytest.approx(recorded.mean_size, abs=0.25)
    assert again.across_m == pytest.approx(recorded.across_m, rel=0.1)


def test_companions_by_accident_do_not_teach_how_companions_walk() -> None:
    """Recorded pairs are half deliberate, 0.6 m abreast, and half accidental, behind each other."""
    rng = np.random.default_rng(0)

    def pairs(along_m: float, across_m: float, number: int) -> np.ndarray:
        found = np.array([along_m, across_m, along_m, across_m, 0.0])
        return found + 0.1 * rng.standard_normal((number, 5))

    recorded = np.concatenate([pairs(0.0, 0.6, 150), pairs(-1.5, 0.3, 150)])
    weight = plan_calibration._unlikely_by_accident(recorded, pairs(-1.5, 0.3, 200), 0.5)
    assert weight[:150].min() > 0.9
    assert weight[150:].mean() < 0.25
    few = plan_calibration._unlikely_by_accident(recorded, pairs(-1.5, 0.3, 39), 0.5)
    assert (few == 1).all()


def test_the_same_seed_gives_the_same_links(
    fitted: PlannedAreas, made: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks
) -> None:
    one, other = made.links, calibrated(fitted, crowd, blocks, PLAZA).links
    np.testing.assert_array_equal(one.log_weight, other.log_weight)
    np.testing.assert_array_equal(one.larger, other.larger)


def test_where_nobody_has_a_companion_nothing_changes(fitted: PlannedAreas) -> None:
    ones = np.ones(50)
    alone = straight_walks(
        walker(
            time_s=30.0 * np.arange(1, 51),
            start=np.outer(ones, [4.0, 10.0]),
            goal=np.outer(ones, [12.0, 10.0]),
            spawn_area=np.zeros(50, np.int64),
            goal_area=np.zeros(50, np.int64),
            speed=ones,
        ),
        PLAZA,
    )
    alone = replace(alone, spawn_area=np.zeros(50, np.int32))
    blocks = blocks_of(alone, PLAZA)
    assert calibrated(fitted, alone, blocks, PLAZA) is fitted
    model = FITTED["cox-gmm"].read(PLAZA, fitted, "full", 0)
    assert adjustment(model, fitted, alone, blocks, PLAZA) == Adjustment()
