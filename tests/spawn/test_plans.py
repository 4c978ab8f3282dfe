"""Recorded plans: goals, stops, speeds and companions under recorded arrivals, and the cut."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from strategies import crowds
from worlds import box, square

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import SettingError
from crowdbench.policies import RecordedPaths, Straight
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene
from crowdbench.spawn import Replay
from crowdbench.spawn.events import check_events, entering, joined
from crowdbench.spawn.recorded_plans import cut_at_goals, plans_of

DT = 0.4
OPEN = square(40.0)
RNG = np.random.default_rng(0)


def walk(*pieces: tuple[float, float], y: float = 0.0) -> np.ndarray:
    """Positions along x: pieces of (speed in m/s, duration in s), from 0 on."""
    speed = np.concatenate([np.full(round(duration / DT), v) for v, duration in pieces])
    x = np.concatenate([[0.0], np.cumsum(speed * DT)])
    return np.stack([x, np.full(len(x), y)], axis=1)


def recording(*paths: np.ndarray, frames: int | None = None, **persons: list) -> Trajectories:
    sizes = [len(path) for path in paths]
    return from_rows(
        scene=OPEN.id,
        dt_s=DT,
        person_id=np.repeat(np.arange(len(paths)), sizes),
        frame=np.concatenate([np.arange(2, size + 2) for size in sizes]),
        xy=np.concatenate(paths),
        frames=frames or max(sizes) + 4,
        persons={name: np.repeat(values, sizes) for name, values in persons.items()},
        where="test",
    )


def test_a_plan_holds_the_longest_stop_and_a_speed_without_standing() -> None:
    crowd = recording(walk((1.2, 8), (0.0, 8), (1.2, 8), (0.0, 20), (1.2, 8)), walk((1.5, 8)))
    plans = plans_of(crowd)  # the wait begins 1 m, 0.8 s, before the place
    np.testing.assert_allclose(plans.via[0], [19.2, 0], atol=0.2)
    assert plans.wait_s[0] == pytest.approx(20, abs=1.2)
    np.testing.assert_allclose(plans.speed, [1.2, 1.5], atol=0.03)
    assert np.isnan(plans.via[1]).all()
    assert plans.wait_s[1] == 0


def test_people_who_hardly_walk_have_no_speed() -> None:
    shifts_its_feet = walk((0.1, 30))
    short, soon = walk((0.8, 1.2)), walk((1.2, 0.8))
    plans = plans_of(recording(shifts_its_feet, short, soon, walk((0.5, 8))))
    assert np.isnan(plans.speed[:3]).all()
    assert plans.speed[3] == pytest.approx(0.5)


def test_preferred_speeds_stay_below_the_speed_limit() -> None:
    events = Replay(recording(walk((30.0, 2)), walk((1.5, 8), y=9))).sample(60.0, OPEN, RNG)
    np.testing.assert_allclose(events.speed, [OPEN.motion.max_speed_mps, 1.5], atol=0.03)


def test_recorded_arrivals_carry_the_plans() -> None:
    path = walk((1.2, 8), (0.0, 8), (1.2, 8))
    crowd = recording(path, path + np.array([0.0, 0.8]), walk((1.5, 12), y=9), group=[0, 0, -1])
    events = Replay(crowd).sample(60.0, OPEN, RNG)
    check_events(events, "replay")
    assert events.group.tolist() == [0, 0, -1]
    np.testing.assert_allclose(events.via[:2, 0], 9.6, atol=0.2)
    assert events.wait_s[2] == 0
    np.testing.assert_allclose(events.speed, [1.2, 1.2, 1.5], atol=0.03)


def test_whoever_never_walks_gets_the_usual_speed() -> None:
    crowd = recording(np.zeros((30, 2)), walk((1.5, 8), y=5), walk((1.3, 8), y=9))
    events = Replay(crowd).sample(60.0, OPEN, RNG)
    assert events.speed[0] == pytest.approx(1.4, abs=0.02)


def test_via_points_in_walls_are_moved_out() -> None:
    scene = square(40.0, box(9.0, -1.0, 10.2, 1.0))
    events = Replay(recording(walk((1.2, 8), (0.0, 8), (1.2, 8)))).sample(60.0, scene, RNG)
    assert scene.walkable(events.via.astype(np.float64)).all()


def test_a_trip_is_cut_at_the_first_step_to_the_goal_after_the_last_stop() -> None:
    lingers = np.concatenate([walk((1.2, 8)), np.repeat(walk((1.2, 8))[-1:], 6, axis=0)])
    waits = walk((1.2, 8), (0.0, 8), y=9)  # stands at its goal for long: a stop, not lingering
    crowd = recording(lingers, waits)
    cut = cut_at_goals(crowd, OPEN)
    # Within 0.25 m of the goal after the 20th step, which ends 0 m from it.
    assert np.diff(cut.offsets).tolist() == [21, len(waits)]
    np.testing.assert_array_equal(cut.goal, crowd.end)
    np.testing.assert_array_equal(cut.left, crowd.left)


def test_a_short_stop_at_the_goal_after_a_longer_one_is_lingering() -> None:
    path = walk((1.2, 8), (0.0, 12), (1.2, 8), (0.0, 8))
    cut = cut_at_goals(recording(path), OPEN)
    assert len(cut.xy) == 1 + 20 + 30 + 20


@given(crowds())
def test_cutting_shortens_trips_to_where_they_reach_their_goals(drawn: Trajectories) -> None:
    cut = cut_at_goals(drawn, OPEN)
    assert (cut.last <= drawn.last).all()
    np.testing.assert_array_equal(cut.start, drawn.start)
    reach = np.linalg.norm(cut.end - OPEN.nearest_walkable(drawn.goal.astype(np.float64)), axis=1)
    shorter = cut.last < drawn.last
    step_m = 1e-3 + OPEN.motion.goal_radius_m
    assert (reach[shorter] <= step_m + _last_step(cut)[shorter]).all()


def _last_step(crowd: Trajectories) -> np.ndarray:
    last = crowd.offsets[1:] - 1
    before = np.maximum(last - 1, crowd.offsets[:-1])
    return np.asarray(np.linalg.norm(crowd.xy[last].astype(np.float64) - crowd.xy[before], axis=1))


@pytest.fixture
def place() -> Scene:
    return OPEN


SWERVES = walk((1.2, 8), (0.0, 8), (1.4, 8))
SWERVES[:, 1] = np.interp(np.arange(len(SWERVES)), [5, 10, 18, 23], [0, 2.5, 2.5, 0])
WAITERS = {
    "stops": walk((1.2, 8), (0.0, 8), (1.4, 8)),
    "stops where it enters": walk((0.0, 8), (1.4, 8)),
    "comes back": np.concatenate([walk((1.2, 8), (0.0, 8)), walk((1.4, 8))[::-1] - 1.6]),
    "swerves": SWERVES,
    "stops twice": walk((1.2, 8), (0.0, 8), (1.2, 8), (0.0, 12), (1.2, 8)),
    "stops at its goal": walk((1.2, 8), (0.0, 8)),
}


@pytest.mark.parametrize("path", WAITERS.values(), ids=WAITERS)
def test_recorded_people_walked_leave_where_the_cut_recording_ends(
    place: Scene, path: np.ndarray
) -> None:
    lingers = walk((1.5, 12), y=9)
    lingers = np.concatenate([lingers, np.repeat(lingers[-1:], 6, axis=0)])
    crowd = cut_at_goals(recording(path, lingers), place)
    walked = rollout(place, Replay(crowd), RecordedPaths(crowd), seed=0, horizon_s=crowd.duration_s)
    np.testing.assert_array_equal(walked.last, crowd.last)
    np.testing.assert_allclose(walked.xy, crowd.xy, atol=1e-4)
    np.testing.assert_array_equal(walked.goal, crowd.goal)


def test_whoever_was_not_seen_to_leave_stays_censored(place: Scene) -> None:
    crowd = recording(walk((1.2, 12)), walk((1.2, 12), y=5), left=[False, True], frames=60)
    crowd = replace(crowd, left=np.array([False, True]))
    walked = rollout(place, Replay(crowd), Straight(), seed=0, horizon_s=24.0)
    assert walked.left.tolist() == [False, True]


def events_with(**more: np.ndarray) -> None:
    size = 2
    points = np.zeros((size, 2))
    area = np.zeros(size, np.int32)
    good = entering(
        time_s=np.arange(2.0),
        start=points,
        goal=points + 5,
        spawn_area=area,
        goal_area=area,
        speed=np.ones(size),
    )
    check_events(replace(good, **more), "mine")


def test_events_with_a_wait_but_no_via_point_are_refused() -> None:
    with pytest.raises(SettingError, match="without via"):
        events_with(wait_s=np.array([0.0, 3.0]))
    with pytest.raises(SettingError, match="via that are not finite"):
        events_with(via=np.array([[1.0, np.nan], [2.0, 2.0]], np.float32))
    events_with(via=np.array([[np.nan, np.nan], [2, 2]], np.float32), wait_s=np.array([0.0, 3.0]))


def test_groups_of_joined_events_stay_apart() -> None:
    area = np.zeros(2, np.int32)
    points = np.zeros((2, 2))
    pair = entering(
        time_s=np.zeros(2),
        start=points,
        goal=points + 5,
        spawn_area=area,
        goal_area=area,
        speed=np.ones(2),
        group=np.array([0, 0]),
    )
    assert joined([pair, pair.shifted(5.0)]).group.tolist() == [0, 0, 1, 1]
