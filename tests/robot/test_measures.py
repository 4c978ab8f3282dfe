"""Measures of episodes that can be computed by hand."""

from dataclasses import replace

import numpy as np
import pytest
from lonely_robots import AHEAD, STAND, drive, lonely, result
from worlds import Person, box, square

from crowdbench.robot.costs import COSTS
from crowdbench.robot.measures import MEASURES
from crowdbench.robot.robots import Robot


def test_an_empty_way_straight_ahead() -> None:
    worlds = lonely()
    steps = drive(worlds, *[AHEAD] * 24)
    # 9.5 m at 1 m/s, in frames of 0.4 s.
    assert [bool(s.terminated[0]) for s in steps] == [False] * 23 + [True]
    found = result(worlds)
    assert set(found) == set(MEASURES)
    assert found["success"] == 1
    assert found["collision"] == found["timeout"] == found["stalled_s"] == 0
    np.testing.assert_allclose(found["time_s"], 24 * 0.4)
    np.testing.assert_allclose(found["path_length_m"], 24 * 0.4)
    assert found["spl"] == 1.0
    assert np.isnan(found["min_distance_m"])
    assert np.isnan(found["mean_distance_m"])
    # From rest to 1 m/s within a period: acceleration 2.5 m/s², and back to none.
    np.testing.assert_allclose(found["jerk_mps3"], 2 * (2.5 / 0.4) / 24)


def test_a_detour_lowers_spl() -> None:
    worlds = lonely(start=(0.0, 0.0), goal=(2.0, 0.0), goal_radius_m=0.1)
    drive(worlds, [-1.0, 0.0], [-1.0, 0.0], *[AHEAD] * 5)  # a robot faces where it went
    found = result(worlds)
    np.testing.assert_allclose(found["path_length_m"], 0.4 + 0.4 + 2.0)
    np.testing.assert_allclose(found["spl"], 2.0 / 2.8)


def test_shares_of_time_near_a_person() -> None:
    # A person stands 3 m ahead of the start; the robot drives past it at a distance of 1 m.
    person = Person(start=(-2.0, 1.0), goal=(8.0, 8.0), speed=0.0)
    worlds = lonely(person)
    drive(worlds, *[AHEAD] * 24)
    x = -5 + 0.4 * np.arange(1, 25)
    gap = np.hypot(x + 2.0, 1.0) - 0.6
    found = result(worlds)
    np.testing.assert_allclose(found["min_distance_m"], gap.min(), atol=1e-6)
    np.testing.assert_allclose(found["mean_distance_m"], gap.mean(), atol=1e-6)
    assert found["intimate_space_share"] == (gap < 0.45).mean() > 0
    assert found["personal_space_share"] == (gap < 1.2).mean()
    assert found["ttc_below_2s_share"] == 0


def test_a_collision_course_shows_in_the_time_to_collision() -> None:
    worlds = lonely(Person(start=(0.0, 0.0), goal=(8.0, 8.0), speed=0.0))
    drive(worlds, *[AHEAD] * 10)
    found = result(worlds)
    gaps = 5 - 0.6 - 0.4 * np.arange(1, 11)
    assert found["ttc_below_2s_share"] == (gaps < 2.0).mean()
    assert found["collision"] == 0
    assert drive(worlds, AHEAD, AHEAD)[-1].terminated[0]
    assert result(worlds)["collision_person"] == 1


def test_waiting_is_stalled_time_and_ends_with_a_timeout() -> None:
    worlds = lonely()
    steps = drive(worlds, *[STAND] * 50)
    assert [bool(s.truncated[0]) for s in steps] == [False] * 49 + [True]
    found = result(worlds)
    assert found["timeout"] == 1
    np.testing.assert_allclose(found["stalled_s"], 20.0)
    assert found["spl"] == found["path_length_m"] == 0


def test_pressing_against_a_wall_is_one_collision() -> None:
    scene = square(10.0, box(-2, -1, -1, 1))
    worlds = lonely(scene=scene, collision="count")
    worlds.view.heading[0] = 0.0
    drive(worlds, *[AHEAD] * 20)
    found = result(worlds)
    assert (found["collision_wall"], found["collision_person"], found["collision"]) == (1, 0, 1)
    np.testing.assert_allclose(worlds.view.position[0], [-2.3, 0.0], atol=0.01)
    worlds = lonely(scene=scene)
    worlds.view.heading[0] = 0.0
    assert [bool(s.terminated[0]) for s in drive(worlds, *[AHEAD] * 8)].index(True) == 6


WIDE = Robot(name="wide", kinematics="holonomic", radius_m=0.45, max_acceleration_mps2=100)
PASSERS = [
    Person(time_s=1.5 * k, start=(-8.0, 1.0), goal=(8.0, 1.0), velocity=(1.3, 0.0), speed=1.3)
    for k in range(6)
]


@pytest.mark.parametrize("policy", ["social-force", "speed-model"])
def test_a_robot_in_a_corner_costs_nothing_and_one_in_the_way_does(policy: str) -> None:
    settings = {"walkers": policy, "costs": True, "robot": WIDE, "collision": "count"}
    corner = lonely(*PASSERS, **settings, start=(9.0, -9.0), goal=(5.0, -9.0))
    drive(corner, *[STAND] * 45)
    assert {name: result(corner)[name] for name in COSTS} == dict.fromkeys(COSTS, 0.0)
    amid = lonely(*PASSERS, **settings, start=(0.0, 1.0), goal=(5.0, -9.0))
    drive(amid, *[STAND] * 45)
    assert result(amid)["extra_time_s"] > 0.1
    assert result(amid)["extra_path_m"] > 0.0
    assert result(amid)["extra_acceleration_mps2"] > 0.0
    unseen = lonely(*PASSERS, **settings, start=(0.0, 1.0), goal=(5.0, -9.0), visible=False)
    drive(unseen, *[STAND] * 45)
    assert {name: result(unseen)[name] for name in COSTS} == dict.fromkeys(COSTS, 0.0)


def test_who_waits_to_enter_is_delayed() -> None:
    settings = {"costs": True, "robot": WIDE, "start": (-8.0, 1.0), "goal": (5.0, -9.0)}
    worlds = lonely(replace(PASSERS[0], time_s=2.0), **settings, collision="count")
    drive(worlds, *[STAND] * 45)
    # It waits for 2 s at most, as the scene says, and then walks on through the robot.
    np.testing.assert_allclose(result(worlds)["extra_time_s"], 2.0, atol=0.41)
    assert result(worlds)["extra_path_m"] == 0.0
