"""Perturbed arrivals: companions stay together, nobody starts in a wall, keys change the draws."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng

from crowdbench.data.table import OUTCOMES
from crowdbench.errors import SettingError
from crowdbench.registry import policy, recording_of, spawn_model
from crowdbench.run.jobs import DRAWS, plan
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn import PerturbedReplay, Replay, SpawnEvents
from crowdbench.spawn.names import replays, with_key
from crowdbench.spawn.perturbed_replay import TIME_S, moved, turn

PLAZA = load_scene("plaza-v0")


def sample(key: str = "", seed: int = 0) -> SpawnEvents:
    model = spawn_model(f"perturbed-replay:{key}" if key else "perturbed-replay", PLAZA)
    return model.sample(PLAZA.horizon_s, PLAZA, default_rng(seed))


@pytest.fixture(scope="module")
def recorded() -> SpawnEvents:
    return Replay(recording_of(PLAZA)).sample(PLAZA.horizon_s, PLAZA, default_rng(0))


def test_changes_have_the_stated_sizes(recorded: SpawnEvents) -> None:
    """Of people alone, whom order of time finds again: each differs from the nearest start."""
    found = sample()
    assert len(found) == len(recorded)
    assert np.abs(np.sort(found.time_s) - np.sort(recorded.time_s)).max() <= TIME_S
    assert found.speed.mean() == pytest.approx(recorded.speed.mean(), rel=0.02)
    gone = np.abs(found.start[:, None] - recorded.start).max(axis=2).min(axis=1)
    assert np.median(gone[found.entered]) > 0.05
    assert (gone[~found.entered] == 0).all()
    shared = np.intersect1d(found.speed, recorded.speed)
    assert len(shared) < 0.05 * len(recorded)


def test_companions_are_changed_alike(recorded: SpawnEvents) -> None:
    found = sample()
    assert np.unique(found.group[found.group >= 0]).size > 10
    for group in np.unique(found.group[found.group >= 0])[:40].tolist():
        was, now = (e.start[(e.group == group) & e.entered] for e in (recorded, found))
        if len(was) == len(now) >= 2:
            gaps = [np.sort(np.linalg.norm(p[:, None] - p, axis=2).ravel()) for p in (was, now)]
            assert gaps[0] == pytest.approx(gaps[1], abs=1e-4)


def test_the_order_is_that_of_time_and_everyone_starts_where_people_can_walk() -> None:
    found = sample()
    assert (np.diff(found.time_s) >= 0).all()
    entered = found.start[found.entered].astype(np.float64)
    assert PLAZA.walkable(entered).all()
    assert PLAZA.walkable(found.goal.astype(np.float64)).all()


def test_draws_follow_from_key_and_seed() -> None:
    one = sample("ab", 1)
    assert (one.start == sample("ab", 1).start).all()
    assert not (one.start == sample("ab", 2).start).all()
    assert not (one.start == sample("cd", 1).start).all()


def test_a_shorter_horizon_has_the_first_of_the_same_people() -> None:
    model = PerturbedReplay(recording_of(PLAZA), "ab")
    whole = model.sample(PLAZA.horizon_s, PLAZA, default_rng(0))
    short = model.sample(600.0, PLAZA, default_rng(0))
    assert (short.start == whole.start[: len(short)]).all()
    assert short.time_s.max() < 600


@given(st.integers(0, 2**31), st.floats(0.0, 5.0))
def test_nobody_is_moved_into_a_wall_or_out_of_the_place(seed: int, by_m: float) -> None:
    rng = default_rng(seed)
    b = PLAZA.bounds
    points = rng.uniform((b.x_min_m, b.y_min_m), (b.x_max_m, b.y_max_m), (20, 2))
    points = points[PLAZA.walkable(points)]
    group = rng.integers(0, 5, len(points))
    found = moved(points, rng.normal(0, by_m, points.shape), group, PLAZA)
    assert PLAZA.walkable(found).all()


def test_a_velocity_turns_with_its_way() -> None:
    velocity, east, north = (np.array([[1.0, 2.0]]), np.array([[3.0, 0]]), np.array([[0, 5.0]]))
    assert turn(velocity, east, north) == pytest.approx(np.array([[-2.0, 1.0]]))
    assert turn(velocity, np.zeros((1, 2)), north) == pytest.approx(velocity)


def test_names_with_and_without_keys() -> None:
    assert with_key("perturbed-replay") == ""
    assert with_key("perturbed-replay:0af3") == "0af3"
    assert with_key("replay") is None
    assert with_key("perturbed-replay:a+b.toml") is None
    assert [name for name in ("replay", "perturbed-replay:1", "poisson-gmm") if replays(name)] == [
        "replay",
        "perturbed-replay:1",
    ]
    with pytest.raises(SettingError, match="Did you mean `perturbed-replay`"):
        spawn_model("perturbed-replay-x", PLAZA)
    with pytest.raises(SettingError, match="with a key of letters, digits and _"):
        spawn_model("perturbed-replay:x!y", PLAZA)


def test_a_policy_without_random_draws_gets_several_draws_of_arrivals(tmp_path) -> None:
    pairs = [("perturbed-replay:ab", "straight"), ("replay", "straight")]
    jobs = plan(PLAZA.asked, PLAZA, pairs, "heldout", 15, tmp_path)
    number = {s: sum(job.spawn == s for job in jobs) for s, _ in pairs}
    assert number == {"perturbed-replay:ab": DRAWS, "replay": 1}
    assert len({job.path for job in jobs}) == len(jobs)


def test_people_walk_to_their_changed_goals() -> None:
    crowd = rollout(
        PLAZA, spawn_model("perturbed-replay", PLAZA), policy("straight", PLAZA), seed=0
    )
    assert crowd.provenance["spawn"] == "perturbed-replay"
    assert (crowd.outcome == OUTCOMES.index("goal")).mean() > 0.9
    assert crowd.frames == PLAZA.recording.frames
