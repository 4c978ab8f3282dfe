"""Rollouts: whole crowds from a spawn model and a policy."""

from dataclasses import fields
from pathlib import Path

import numpy as np
import pytest
import shapely
from worlds import box, poisson, square

from crowdbench.data.recordings.catalogue import SOURCES, import_recording, read_published
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import CapacityError, SettingError
from crowdbench.policies import (
    Policy,
    Random,
    RecordedPaths,
    ReplayPolicy,
    SocialForce,
    SpeedModel,
    Straight,
)
from crowdbench.run.replay_check import compare_replay
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.simulation import Settings
from crowdbench.spawn import Replay

DT = 0.4
HALL = square(8.0, box(-1, 2, 1, 3), dwell_p99_s=20.0)
ETH = load_scene("eth-v0")


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    """Two minutes of straight walkers in a stationary crowd."""
    return rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=120.0)


@pytest.fixture(scope="module")
def eth(opentraj: Path) -> Trajectories:
    return read_published(SOURCES["eth"], opentraj)


@pytest.fixture(scope="module")
def replayed(eth: Trajectories) -> Trajectories:
    return rollout(ETH, Replay(eth), ReplayPolicy(eth), seed=0)


@pytest.fixture(scope="module")
def straight(eth: Trajectories) -> Trajectories:
    return rollout(ETH, Replay(eth), Straight(), seed=0)


def same(one: Trajectories, other: Trajectories) -> bool:
    names = [f.name for f in fields(Trajectories) if f.name != "provenance"]
    values = [(getattr(one, name), getattr(other, name)) for name in names]
    return all(np.array_equal(a, b) for a, b in values)


@pytest.mark.parametrize(
    "policy", [Straight(), Random(), SocialForce(), SpeedModel()], ids=lambda p: p.name
)
def test_the_same_seed_gives_the_same_crowd(policy: Policy) -> None:
    one, again = (rollout(HALL, poisson(HALL), policy, seed=3, horizon_s=30.0) for _ in range(2))
    assert same(one, again)


def test_another_seed_gives_another_crowd(crowd: Trajectories) -> None:
    assert not same(crowd, rollout(HALL, poisson(HALL), Straight(), seed=2, horizon_s=120.0))


def test_a_crowd_is_as_long_as_asked_for(crowd: Trajectories) -> None:
    assert (crowd.frames, crowd.observed.tolist()) == (300, [[0, 300]])


def test_ids_count_from_zero_without_a_gap(crowd: Trajectories) -> None:
    assert sorted(crowd.person_id.tolist()) == list(range(len(crowd)))


def test_who_is_there_at_first_has_not_entered_and_everyone_else_has(crowd: Trajectories) -> None:
    assert (crowd.entered == (crowd.first > 0)).all()


def test_a_stationary_crowd_begins_with_the_people_of_its_middle() -> None:
    present = [
        rollout(HALL, poisson(HALL), Straight(), seed=seed, horizon_s=40.0).present()
        for seed in range(12)
    ]
    first, later = np.mean([n[0] for n in present]), np.mean([n[50:].mean() for n in present])
    assert first == pytest.approx(later, rel=0.4)


def test_an_empty_start_has_nobody_before_the_first_arrival() -> None:
    crowd = rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=40.0, start="empty")
    assert crowd.present()[0] == 0
    assert crowd.entered.all()


def test_entered_minus_left_is_present(crowd: Trajectories) -> None:
    frame = np.arange(crowd.frames)[:, None]
    gone = (crowd.last < frame).sum(axis=1)
    come = (crowd.first <= frame).sum(axis=1)
    assert (crowd.present() == come - gone).all()


def test_everyone_left_but_those_whom_the_horizon_cut_off(crowd: Trajectories) -> None:
    cut = crowd.outcome == OUTCOMES.index("horizon")
    assert (crowd.left == ~cut).all()
    assert (crowd.last[cut] == crowd.frames - 1).all()


def test_straight_walkers_in_a_free_hall_all_reach_their_goals(crowd: Trajectories) -> None:
    assert {OUTCOMES[k] for k in crowd.outcome[crowd.left]} == {"goal"}


def test_dwell_is_the_way_to_the_goal_over_the_speed(crowd: Trajectories) -> None:
    # Rows stand at both ends of a life, so n + 1 of them are n steps.
    whole = crowd.entered & crowd.left
    rows = np.diff(crowd.offsets)[whole]
    dwell_s = (rows - 1) * DT
    assert (dwell_s == (crowd.last - crowd.first)[whole] * DT).all()
    way = np.linalg.norm(crowd.end - crowd.start, axis=1)[whole]
    np.testing.assert_allclose(way / crowd.mean_speeds()[whole], dwell_s, rtol=1e-4)


def test_waiting_is_what_lies_between_request_and_entry() -> None:
    crowd = rollout(HALL, poisson(HALL, 6.0), Straight(), seed=1, horizon_s=40.0)
    waited = crowd.spawn_s - crowd.requested_s
    frames = np.round(waited / DT)
    assert frames.max() > 0
    np.testing.assert_allclose(waited, frames * DT, atol=1e-9)
    due = np.ceil(crowd.requested_s / DT - 1e-6)
    assert (crowd.first == due + frames)[crowd.entered].all()


def test_too_few_slots_are_an_error() -> None:
    with pytest.raises(CapacityError, match="max_alive"):
        rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=40.0,
                settings=Settings(max_alive=2))  # fmt: skip


def test_too_few_slots_in_the_warm_up_alone_are_an_error() -> None:
    # The horizon is so near that nobody is turned away after the warm-up.
    with pytest.raises(CapacityError, match="max_alive"):
        rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=DT,
                settings=Settings(max_alive=3))  # fmt: skip


def test_too_few_ids_are_an_error() -> None:
    with pytest.raises(CapacityError, match="max_persons"):
        rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=120.0,
                settings=Settings(max_persons=20))  # fmt: skip


def test_only_replay_can_begin_with_the_recorded_people() -> None:
    with pytest.raises(SettingError, match="stationary or empty"):
        rollout(HALL, poisson(HALL), Straight(), seed=1, horizon_s=9.0, start="recorded")


def test_replay_cannot_begin_with_a_stationary_crowd(eth: Trajectories) -> None:
    with pytest.raises(SettingError, match="recorded or empty"):
        rollout(ETH, Replay(eth), Straight(), seed=1, horizon_s=9.0, start="stationary")


@pytest.mark.parametrize("policy", [ReplayPolicy, RecordedPaths])
def test_recorded_paths_are_walked_only_after_recorded_arrivals(
    eth: Trajectories, policy: type[ReplayPolicy]
) -> None:
    with pytest.raises(SettingError, match="spawn model replay"):
        rollout(ETH, poisson(ETH), policy(eth), seed=1, horizon_s=9.0)


@pytest.mark.parametrize("policy", [ReplayPolicy, RecordedPaths])
def test_recorded_paths_are_walked_only_by_people_of_the_recorded_start(
    eth: Trajectories, policy: type[ReplayPolicy]
) -> None:
    # Without the initial population the events are numbered otherwise than the recorded persons.
    with pytest.raises(SettingError, match="start recorded"):
        rollout(ETH, Replay(eth), policy(eth), seed=0, start="empty", horizon_s=9.0)


def test_a_replayed_recording_is_the_recording(eth: Trajectories, replayed: Trajectories) -> None:
    assert (replayed.offsets == eth.offsets).all()
    assert np.linalg.norm(replayed.xy - eth.xy, axis=1).max() < 1e-3


@pytest.mark.parametrize("column", ["first", "entered", "left", "spawn_s", "requested_s"])
def test_a_replayed_recording_keeps_its_persons(
    eth: Trajectories, replayed: Trajectories, column: str
) -> None:
    np.testing.assert_allclose(getattr(replayed, column), getattr(eth, column), atol=1e-6)


EXCEPTIONS = {
    # A record of one frame.
    "hotel-v0": {"leave in another frame (a trip has at least two frames)": 1},
    "forum-v0": {},
    "zara1-v0": {},
}


@pytest.mark.long
@pytest.mark.parametrize("name", EXCEPTIONS)
def test_replayed_recordings_are_the_recordings(opentraj: Path, name: str) -> None:
    scene = load_scene(name)
    recording = import_recording(scene.recording.name, opentraj)
    replayed = rollout(scene, Replay(recording), ReplayPolicy(recording), seed=0)
    found = compare_replay(recording, replayed, scene)
    others = EXCEPTIONS[name]
    assert found["persons"] == f"{len(recording)} recorded, {len(recording)} replayed"
    assert found["identical"].startswith(f"{len(recording) - sum(others.values())} paths")
    said = {f"{count} {reason}" for reason, count in others.items()}
    assert set(found["differing"].split(", ")) == (said or {"none"})
    for column in ("first", "entered", "left", "spawn_s", "requested_s"):
        np.testing.assert_allclose(getattr(replayed, column), getattr(recording, column), atol=1e-6)


def test_of_grand_central_those_paths_differ_that_meet_walls_or_leap(opentraj: Path) -> None:
    scene = load_scene("gc-v0")
    recording = import_recording("gc", opentraj)
    replay, policy = Replay(recording), ReplayPolicy(recording)
    replayed = rollout(scene, replay, policy, seed=0, horizon_s=600.0)
    assert np.array_equal(replayed.first, recording.first[: len(replayed)])
    differing = 0
    for p in range(len(replayed)):
        there, here = recording.path(p), replayed.path(p)
        assert len(here) == len(there) or recording.last[p] >= replayed.frames
        path = there[: len(here)].astype(np.float64)
        if np.abs(here - path).max() <= 1e-3:
            continue
        differing += 1
        fastest = np.linalg.norm(np.diff(path, axis=0), axis=1).max() / scene.dt_s
        in_wall = shapely.intersects(scene.obstacles, shapely.LineString(path))
        # A wall also stops who would come nearer to it than a millimetre.
        near_wall = in_wall or shapely.dwithin(scene.obstacles, shapely.LineString(path), 2e-3)
        assert near_wall or fastest > scene.motion.max_speed_mps
    assert 0 < differing < 0.06 * len(replayed)


def test_straight_walkers_enter_as_recorded(eth: Trajectories, straight: Trajectories) -> None:
    assert len(straight) == 360
    waited = np.round((straight.spawn_s - straight.requested_s) / DT).astype(int)
    by_request = np.argsort(straight.requested_s, kind="stable")
    due = (straight.first - waited)[by_request]
    assert due.tolist() == np.sort(eth.first).tolist()
