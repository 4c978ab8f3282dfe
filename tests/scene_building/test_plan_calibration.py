"""Samples of plans have as many companions as the recording, by the rule that finds both."""

from dataclasses import replace

import numpy as np
import pytest

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.policies import Straight
from crowdbench.registry import FITTED, recording_of
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scene_building import plan_calibration
from crowdbench.scene_building.plan_calibration import adjustment, straight_walks
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import SpawnEvents, blocks_of, entering
from crowdbench.spawn.plans.fitting import fit_plans
from crowdbench.spawn.plans.links import Adjustment
from crowdbench.spawn.plans.planned import PlannedAreas

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


@pytest.mark.nightly
def test_samples_of_a_model_have_companions_like_those_recorded(
    fitted: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks
) -> None:
    model = FITTED["cox-gmm"].read(PLAZA, fitted, "full", 0)
    by = adjustment(model, fitted, crowd, blocks, PLAZA)
    horizon_s = 10 * blocks.exposure_s()
    whole = replace(blocks, frames=np.array([[0, PLAZA.frames(horizon_s)]]), since=np.zeros(1, int))

    def companions(areas: PlannedAreas) -> plan_calibration._Company:
        events = replace(model, areas=areas).sample(horizon_s, PLAZA, np.random.default_rng(9))
        end_s = float(events.time_s.max()) + PLAZA.grid_s
        walked = rollout(
            PLAZA, plan_calibration._These(events), Straight(), seed=0, horizon_s=end_s
        )
        return plan_calibration._company(walked, whole, PLAZA)

    recorded = plan_calibration._company(crowd, blocks, PLAZA)
    found = companions(replace(fitted, links=fitted.links.adjusted(by)))
    assert found.numbers()[0] == pytest.approx(recorded.numbers()[0], abs=0.2)
    assert found.mean_size == pytest.approx(recorded.mean_size, abs=0.2)
    assert found.distance_m == pytest.approx(recorded.distance_m, rel=0.1)
    assert found.across_m == pytest.approx(recorded.across_m, rel=0.1)
    # From far away, too.
    off = Adjustment(more=-1.0, larger=1.0, along=1.5, across=0.6)
    far = replace(fitted, links=fitted.links.adjusted(off))
    assert companions(far).numbers()[0] < recorded.numbers()[0] - 0.3
    back = adjustment(model, far, crowd, blocks, PLAZA)
    again = companions(replace(far, links=far.links.adjusted(back)))
    assert again.numbers()[0] == pytest.approx(recorded.numbers()[0], abs=0.2)
    assert again.mean_size == pytest.approx(recorded.mean_size, abs=0.2)
    assert again.across_m == pytest.approx(recorded.across_m, rel=0.1)


@pytest.mark.long
def test_the_same_seed_gives_the_same_numbers(
    fitted: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks
) -> None:
    model = FITTED["cox-gmm"].read(PLAZA, fitted, "full", 0)
    one, other = (adjustment(model, fitted, crowd, blocks, PLAZA) for _ in range(2))
    assert one == other


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
    model = FITTED["cox-gmm"].read(PLAZA, fitted, "full", 0)
    assert adjustment(model, fitted, alone, blocks, PLAZA) == Adjustment()
