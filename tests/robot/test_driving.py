"""How robots drive: within their limits, as their kinematics say, and never into a wall."""

import math

import numpy as np
import pytest
import shapely
from drivers import PERIOD_S, Driver
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import box, square

from crowdbench.robot.robots import Robot

ROOM = square(6.0, box(-1, -1, 1, 1), box(2.0, -4.0, 2.2, 4.0))


robots = st.builds(
    Robot,
    kinematics=st.sampled_from(["holonomic", "unicycle", "bicycle"]),
    radius_m=st.floats(0.05, 0.6),
    max_speed_mps=st.floats(0.3, 3.0),
    min_speed_mps=st.sampled_from([0.0, -0.3]),
    max_acceleration_mps2=st.floats(0.2, 5.0),
    max_turn_rps=st.floats(0.2, 4.0),
    max_turn_acceleration_rps2=st.floats(0.2, 8.0),
)
actions = st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=1, max_size=12)
SLACK = 1 + 1e-9


@given(robots, actions)
def test_speeds_and_accelerations_stay_within_the_limits(
    robot: Robot, commands: list[tuple[float, float]]
) -> None:
    driver = Driver(robot)
    for a, b in commands:
        position, velocity = driver.position.copy(), driver.velocity.copy()
        speed, turn = driver.speed[0], driver.turn[0]
        driver.go(a, b)
        most = robot.max_acceleration_mps2 * PERIOD_S * SLACK
        way = np.linalg.norm(driver.position - position)
        assert way <= robot.max_speed_mps * PERIOD_S * SLACK
        assert abs(driver.turn[0]) <= robot.turn_limit * SLACK
        assert -math.pi <= driver.heading[0] <= math.pi
        np.testing.assert_allclose(np.linalg.norm(driver.velocity), abs(driver.speed[0]), atol=1e-9)
        if robot.kinematics == "holonomic":
            assert np.linalg.norm(driver.velocity - velocity) <= most
        else:
            assert robot.min_speed_mps <= driver.speed[0] <= robot.max_speed_mps
            assert abs(driver.speed[0] - speed) <= most
            change = robot.max_turn_acceleration_rps2
            if robot.kinematics == "bicycle":
                change = robot.max_turn_rps
            assert abs(driver.turn[0] - turn) <= change * PERIOD_S * SLACK


@settings(max_examples=100)
@given(robots, actions, st.floats(-5, 5), st.floats(-5, 5))
def test_no_robot_drives_into_a_wall_or_out_of_the_bounds(
    robot: Robot, commands: list[tuple[float, float]], x: float, y: float
) -> None:
    start = shapely.Point(x, y)
    if ROOM.obstacles.distance(start) < robot.radius_m + 0.01:
        return
    driver = Driver(robot, ROOM, x, y)
    for a, b in commands:
        before = driver.position[0].copy()
        driver.go(a, b)
        way = shapely.LineString([before, driver.position[0]])
        assert ROOM.obstacles.distance(shapely.Point(driver.position[0])) >= robot.radius_m
        assert not way.crosses(ROOM.obstacles)
        assert (np.abs(driver.position) <= 6.0).all()


def test_a_unicycle_drives_in_a_circle() -> None:
    robot = Robot(max_speed_mps=1.0, max_turn_rps=0.5, max_acceleration_mps2=100,
                  max_turn_acceleration_rps2=100)  # fmt: skip
    driver = Driver(robot)
    for _ in range(5):
        driver.go(1.0, 1.0)
    angle = 0.5 * 5 * PERIOD_S  # on a circle of 2 m around (0, 2)
    want = [2 * math.sin(angle), 2 - 2 * math.cos(angle)]
    np.testing.assert_allclose(driver.position[0], want, atol=1e-9)
    np.testing.assert_allclose(driver.heading[0], angle)


def test_a_bicycle_turns_at_the_rate_of_its_steering_angle() -> None:
    robot = Robot(kinematics="bicycle", wheelbase_m=0.8, max_steer_rad=0.4, max_turn_rps=100,
                  max_acceleration_mps2=100)  # fmt: skip
    driver = Driver(robot)
    for _ in range(3):
        driver.go(1.0, -1.0)
    np.testing.assert_allclose(driver.heading[0], -3 * PERIOD_S * math.tan(0.4) / 0.8)


def test_a_holonomic_robot_is_commanded_in_its_own_frame() -> None:
    driver = Driver(Robot(kinematics="holonomic", max_acceleration_mps2=100))
    driver.go(0.0, 1.0)
    np.testing.assert_allclose(driver.position[0], [0.0, PERIOD_S], atol=1e-9)
    driver.go(1.0, 0.0)  # ahead is now where it went
    np.testing.assert_allclose(driver.position[0], [0.0, 2 * PERIOD_S], atol=1e-9)


@pytest.mark.parametrize("kinematics", ["holonomic", "unicycle"])
def test_a_wall_stops_a_robot_which_can_drive_away(kinematics: str) -> None:
    robot = Robot(kinematics=kinematics, radius_m=0.3, min_speed_mps=-1.0,
                  max_acceleration_mps2=100)  # fmt: skip
    driver = Driver(robot, ROOM, -3.0, 0.0)
    for _ in range(8):
        driver.go(1.0, 0.0)
    assert driver.hit[0]
    assert driver.speed[0] == 0.0
    np.testing.assert_allclose(driver.position[0], [-1.3, 0.0], atol=0.01)
    driver.go(-1.0, 0.0)
    assert not driver.hit[0]
    np.testing.assert_allclose(driver.position[0], [-1.7, 0.0], atol=0.01)
