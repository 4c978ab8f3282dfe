"""Robots meet people: who touches whom, and when."""

import numpy as np
import pytest
from lonely_robots import AHEAD, STAND, drive, lonely, result
from worlds import Person, square, with_bodies

from crowdbench.robot.robots import Robot


def facing(**person: float) -> Person:
    """Somebody who walks from (1, 0) towards the robot that stands at (−5, 0)."""
    return Person(start=(1.0, 0.0), goal=(-9.0, 0.0), velocity=(-1.0, 0.0), **person)


def test_a_contact_between_the_ends_of_a_period_is_noticed() -> None:
    # Somebody crosses in front at 2.5 m/s: within reach only between two frames.
    fast = Robot(name="fast", kinematics="holonomic", radius_m=0.05, max_acceleration_mps2=100)
    scene = square(person_radius_m=0.05)
    person = Person(start=(-4.9, -1.5), goal=(-4.9, 9.0), speed=2.5, velocity=(0.0, 2.5))
    worlds = lonely(person, robot=fast, scene=scene, visible=False)
    gaps = []
    for _ in range(4):
        drive(worlds, STAND)
        gaps.append(worlds.encounter.gap[0])
    assert min(gaps) > 0.2
    worlds = lonely(
        Person(start=(-4.95, -1.5), goal=(-4.95, 9.0), speed=2.5, velocity=(0.0, 2.5)),
        robot=fast, scene=scene, visible=False, collision="count",
    )  # fmt: skip
    drive(worlds, *[STAND] * 4)
    assert result(worlds)["collision_person"] == 1


def test_a_contact_counts_once_and_terminates() -> None:
    steps = drive(lonely(facing(), visible=False), *[STAND] * 20)
    # They touch at −4.4, after 5.4 m at 1 m/s.
    assert next(k for k, step in enumerate(steps) if step.terminated[0]) == 13
    counted = lonely(facing(), visible=False, collision="count")
    assert not any(step.terminated[0] for step in drive(counted, *[STAND] * 20))
    assert result(counted)["collision_person"] == 1


def test_who_enters_within_reach_of_a_robot_does_not_collide_with_it() -> None:
    person = Person(time_s=2.0, start=(-4.8, 0.0), goal=(9.0, 0.0))
    worlds = lonely(person, collision="count", visible=False)
    drive(worlds, *[STAND] * 12)
    assert worlds.encounter.gap[0] > 0
    assert result(worlds)["min_distance_m"] < 0
    assert result(worlds)["collision"] == 0


def test_time_to_collision_and_distance_are_those_of_the_surfaces() -> None:
    worlds = lonely(facing(), visible=False)
    drive(worlds, STAND)
    np.testing.assert_allclose(worlds.encounter.gap[0], 5.6 - 0.6, atol=1e-5)
    np.testing.assert_allclose(worlds.encounter.collision_s[0], 5.0, atol=1e-5)
    drive(worlds, AHEAD)  # both come closer now
    np.testing.assert_allclose(worlds.encounter.collision_s[0], 4.2 / 2.0, atol=1e-5)


def test_people_are_where_they_are_in_between_frames() -> None:
    fine, coarse = (lonely(facing(), period_s=p, visible=False) for p in (0.1, None))
    x = []
    for _ in range(4):
        drive(fine, STAND)
        x.append(fine.present.position[0, 0, 0])
    drive(coarse, STAND)
    np.testing.assert_allclose(x, [0.9, 0.8, 0.7, 0.6], atol=1e-6)
    assert x[-1] == coarse.present.position[0, 0, 0]


@pytest.mark.parametrize("visible", [True, False])
def test_people_with_bodies_stop_at_a_robot_that_they_see(visible: bool) -> None:
    worlds = lonely(facing(), scene=with_bodies(square()), visible=visible, collision="count")
    drive(worlds, *[STAND] * 20)
    found = result(worlds)
    assert (found["collision_person"] == 0) == visible
    assert (found["min_distance_m"] > -1e-3) == visible


def test_people_who_slide_around_a_standing_robot_do_not_collide() -> None:
    people = [
        Person(time_s=2.0 * k, start=(1.0, 0.1 * k), goal=(-9.0, 0.0), velocity=(-1.0, 0.0))
        for k in range(4)
    ]
    wide = Robot(name="wide", kinematics="holonomic", radius_m=0.5)
    worlds = lonely(*people, robot=wide, scene=with_bodies(square()), collision="count")
    drive(worlds, *[STAND] * 49)
    assert result(worlds)["collision_person"] == 0
    assert result(worlds)["min_distance_m"] < 0.05
