"""How a robot follows a velocity that its kinematics may not allow at once."""

import numpy as np
from jaxtyping import Float, Float32

from crowdbench.robot.robots import Robot
from crowdbench.robot.seeing import RobotView

SETTLE_S = 0.5
"""Time in which a unicycle turns towards the wanted direction, if its limits allow."""
LOOK_AHEAD_S = 1.0
"""Pure pursuit: a car aims at the point where it would be after this time."""
CREEP = 0.2
"""Least speed of a car that turns, as a share of the wanted speed: it cannot turn in place."""


def follow(
    robot: Robot, view: RobotView, wanted: Float[np.ndarray, "W 2"]
) -> Float32[np.ndarray, "W 2"]:
    """Actions by which robots take up velocities.

    A holonomic robot takes the velocity itself. A unicycle turns towards it and drives with its
    component along the heading, so that it turns in place if the direction is behind it. It never
    turns faster than it can stop turning in the remaining angle. A car steers by pure pursuit
    (Coulter 1992, CMU-RI-TR-92-01), and backs if it can and the direction is behind it. Limits of
    acceleration are left to the simulation.

    Args:
        robot: the robot.
        view: what it sees.
        wanted: (W, 2) velocities in the world frame in m/s.
    """
    speed = np.minimum(np.hypot(wanted[:, 0], wanted[:, 1]), robot.max_speed_mps)
    moving = speed > 1e-6
    heading = view.heading.astype(np.float64)
    direction = np.where(moving, np.arctan2(wanted[:, 1], wanted[:, 0]), heading)
    angle = wrap(direction - heading)
    if robot.kinematics == "holonomic":
        action = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        return (action * (speed / robot.max_speed_mps)[:, None]).astype(np.float32)
    if robot.kinematics == "unicycle":
        first, second = _turn(robot, view, speed, angle)
    else:
        first, second = _steer(robot, speed, angle)
    return np.clip(np.stack([first, second], axis=1), -1.0, 1.0).astype(np.float32)


def wrap(angle: Float[np.ndarray, " W"]) -> Float[np.ndarray, " W"]:
    """Angles from −π to π."""
    return (angle + np.pi) % (2 * np.pi) - np.pi


def _turn(
    robot: Robot,
    view: RobotView,
    speed: Float[np.ndarray, " W"],
    angle: Float[np.ndarray, " W"],
) -> tuple[Float[np.ndarray, " W"], Float[np.ndarray, " W"]]:
    size = np.abs(angle)
    # From this rate, it can stop turning within the angle, after one more control period.
    brake, period_s = robot.max_turn_acceleration_rps2, view.period_s
    stoppable = brake * (np.sqrt(period_s**2 / 4 + 2 * size / brake) - period_s / 2)
    rate = np.minimum(size / max(SETTLE_S, period_s), stoppable)
    forward = np.maximum(0.0, np.cos(angle)) * speed
    return forward / robot.max_speed_mps, np.sign(angle) * rate / robot.max_turn_rps


def _steer(
    robot: Robot, speed: Float[np.ndarray, " W"], angle: Float[np.ndarray, " W"]
) -> tuple[Float[np.ndarray, " W"], Float[np.ndarray, " W"]]:
    ahead_m = np.maximum(speed * LOOK_AHEAD_S, robot.wheelbase_m)
    steer = np.arctan(2.0 * robot.wheelbase_m * np.sin(angle) / ahead_m)
    forward = np.maximum(CREEP, np.cos(angle)) * speed
    behind = np.abs(angle) > np.pi / 2
    full = np.sign(angle) * robot.max_steer_rad
    backing = min(0.0, robot.min_speed_mps)
    if backing < 0.0:
        # Backing with the wheels turned away turns the nose towards the direction.
        forward = np.where(behind & (speed > 0), backing, forward)
        steer = np.where(behind, -full, steer)
    else:
        steer = np.where(behind, full, steer)
    return forward / robot.max_speed_mps, steer / robot.max_steer_rad
