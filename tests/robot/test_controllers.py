"""Controllers of robots keep off people and walls, within what each kinematics can do."""

import sys
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from drivers import PERIOD_S, Driver
from hypothesis import assume, given
from hypothesis import strategies as st
from worlds import box, square

from crowdbench.errors import SettingError
from crowdbench.robot.controllers import BUILT_IN, Controller, controller
from crowdbench.robot.following import follow
from crowdbench.robot.robots import DELIVERY, HOLONOMIC_ROBOT, Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.scene import Scene

CAR = Robot(name="car", kinematics="bicycle", min_speed_mps=-0.5)
KINEMATICS = (HOLONOMIC_ROBOT, DELIVERY, CAR)
AVOIDING = ("social-force", "orca", "dwa")
OPEN = square()
PERSON_M = 0.15
Vector = tuple[float, float]
Walker = tuple[float, float, float, float]
"""Position and velocity."""
ANGLES = st.floats(-np.pi, np.pi)


def by_name(robot: Robot) -> str:
    return robot.kinematics


def seen_by(
    robot: Robot,
    people: Sequence[Walker] = (),
    *,
    goal: Vector = (8.0, 0.0),
    position: Vector = (0.0, 0.0),
    heading: float = 0.0,
    speed: float = 0.0,
    scene: Scene = OPEN,
) -> RobotView:
    """What the robot of one world sees whose way to the goal is straight."""
    view = RobotView.empty(scene, robot, PERIOD_S, 1, max(1, len(people)))
    view.position[0], view.heading[0], view.speed[0] = position, heading, speed
    view.velocity[0] = speed * np.cos(heading), speed * np.sin(heading)
    view.goal[0] = view.towards[0] = goal
    view.remaining[0] = np.linalg.norm(view.goal - view.position)
    for k, (x, y, vx, vy) in enumerate(people):
        view.near[0, k], view.near_velocity[0, k] = (x, y), (vx, vy)
        view.near_radius[0, k], view.there[0, k] = PERSON_M, True
    return view


def chosen(name: str, view: RobotView) -> np.ndarray:
    made = BUILT_IN[name]()
    made.reset(view.scene, view.robot, 1, view.period_s)
    return made.act(view)[0]


@pytest.mark.parametrize("name", BUILT_IN)
def test_each_is_a_controller_under_its_own_name(name: str) -> None:
    made = controller(name, OPEN)
    assert isinstance(made, Controller)
    assert made.name == name


def test_unknown_names_are_told(monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(SettingError, match="Did you mean `orca`"):
        controller("orcs", OPEN)
    monkeypatch.setitem(sys.modules, "pyrvo", None)
    with pytest.raises(SettingError, match=r"no pyrvo.*\[orca\]"):
        controller("orca", OPEN)


@pytest.mark.parametrize("robot", KINEMATICS, ids=by_name)
@pytest.mark.parametrize("name", BUILT_IN)
def test_with_nobody_there_all_drive_straight_ahead(name: str, robot: Robot) -> None:
    forward, aside = chosen(name, seen_by(robot, speed=0.9 * robot.max_speed_mps))
    assert forward > 0.85
    assert abs(aside) < 0.05


@pytest.mark.parametrize("robot", KINEMATICS, ids=by_name)
@pytest.mark.parametrize("name", BUILT_IN)
@given(angle=ANGLES, heading=ANGLES, shift=st.floats(-3, 3))
def test_a_rigid_motion_of_everything_changes_no_action(
    name: str, robot: Robot, angle: float, heading: float, shift: float
) -> None:
    assume(abs(heading) < np.pi - 1e-3)  # away from the goal, left and right are equally good
    people = [(2.0, 0.4, -1.0, 0.1), (3.0, -1.5, 0.3, 1.0)]
    view = seen_by(robot, people, heading=heading, speed=0.5)
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    moved = view._replace(
        heading=view.heading + angle,
        velocity=view.velocity @ turn.T,
        near_velocity=view.near_velocity @ turn.T,
        **{
            name: getattr(view, name) @ turn.T + shift
            for name in ("position", "goal", "towards", "near")
        },
    )
    np.testing.assert_allclose(chosen(name, moved), chosen(name, view), atol=2e-3)


@pytest.mark.parametrize("robot", KINEMATICS, ids=by_name)
@given(direction=ANGLES, heading=ANGLES, speed=st.floats(0, 1))
def test_whoever_follows_a_velocity_turns_towards_it(
    robot: Robot, direction: float, heading: float, speed: float
) -> None:
    view = seen_by(robot, heading=heading)
    wanted = speed * robot.max_speed_mps * np.array([[np.cos(direction), np.sin(direction)]])
    first, second = follow(robot, view, wanted)[0]
    assert max(abs(first), abs(second)) <= 1.0
    off = (direction - heading + np.pi) % (2 * np.pi) - np.pi
    if robot.kinematics == "holonomic":
        expected = speed * np.cos(off), speed * np.sin(off)
        np.testing.assert_allclose((first, second), expected, atol=1e-6)
    elif speed > 1e-3 and 1e-3 < abs(off) < 3.1:
        turns_left = second > 0 if first >= 0 else second < 0  # a car that backs
        assert turns_left == (off > 0)
        assert abs(first) <= max(speed, 0.5) + 1e-6


def test_a_unicycle_turns_in_place_to_what_is_behind_it() -> None:
    forward, turn = follow(DELIVERY, seen_by(DELIVERY), np.array([[-1.0, 0.2]]))[0]
    assert forward == 0.0
    assert turn == 1.0


@pytest.mark.parametrize("robot", KINEMATICS, ids=by_name)
@pytest.mark.parametrize("name", AVOIDING)
def test_somebody_ahead_is_avoided(name: str, robot: Robot) -> None:
    fast = robot.max_speed_mps
    view = seen_by(robot, [(1.8, 0.1, -0.6, 0.0)], speed=fast)
    alone = chosen(name, seen_by(robot, speed=fast))
    forward, aside = chosen(name, view)
    assert forward < alone[0] - 0.05 or aside < alone[1] - 0.05


def test_straight_sees_nobody() -> None:
    view = seen_by(DELIVERY, [(1.0, 0.0, -1.0, 0.0)])
    np.testing.assert_array_equal(chosen("straight", view), chosen("straight", seen_by(DELIVERY)))


@given(ahead=st.floats(0.7, 3.0), speed=st.floats(0.0, 1.6), across=st.floats(-1.0, 1.0))
def test_the_dynamic_window_never_drives_into_a_wall(
    ahead: float, speed: float, across: float
) -> None:
    if speed**2 / (2 * DELIVERY.max_acceleration_mps2) > ahead - DELIVERY.radius_m - 0.05:
        return  # too late for anyone
    wall = square(10.0, box(ahead, -9.0, ahead + 1.0, 9.0))
    driver, dwa = Driver(DELIVERY, wall), BUILT_IN["dwa"]()
    driver.speed[0] = driver.velocity[0, 0] = speed
    dwa.reset(wall, DELIVERY, 1, PERIOD_S)
    same = ("position", "heading", "velocity", "speed", "turn")
    view = RobotView.empty(wall, DELIVERY, PERIOD_S, 1, 1)
    view = view._replace(**{name: getattr(driver, name) for name in same})
    view.goal[0] = view.towards[0] = (8.0, across)  # behind the wall
    for _ in range(15):
        view.remaining[0] = np.linalg.norm(view.goal - view.position)
        driver.go(*dwa.act(view)[0].tolist())
        assert not driver.hit[0]


def test_a_wider_robot_keeps_a_larger_distance_by_social_forces() -> None:
    person = [(1.5, 0.5, 0.0, 0.0)]
    wide = replace(HOLONOMIC_ROBOT, radius_m=0.6)
    slim = chosen("social-force", seen_by(HOLONOMIC_ROBOT, person, speed=1.0))
    assert chosen("social-force", seen_by(wide, person, speed=1.0))[1] < slim[1] < 0
