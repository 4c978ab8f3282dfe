"""The kernel that drives robots: limits of acceleration, kinematics, and walls that stop them."""

import math

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.robot.robots import BICYCLE, HOLONOMIC, Limits
from crowdbench.simulation.rules import distance_to_segment
from crowdbench.simulation.walls import CELL_M, cell_of

SUBSTEP_S = 0.1
"""Longest time in which speeds are constant, in seconds."""
GAP_M = 1e-3
"""Distance from a wall at which a robot stops, beyond its radius."""
HALVINGS = 8
"""Number of halvings in the search for the place where a robot meets a wall."""


def longest_substep_m(limits: Limits) -> float:
    """Largest distance that a robot drives in a substep, metres."""
    return min(SUBSTEP_S * limits.max_speed, limits.radius)


@compiled
def drive(actions, period, limits, bounds, walls, position, heading, velocity, speed, turn, hit):
    """Drive the robots of all worlds for `period` seconds, by the kinematics of `limits`.

    Speeds approach those commanded as fast as the limits allow. A wall stops a robot at once; it
    does not slide along it, but may turn or drive away. `hit` says so. The bounds of the scene stop
    it, too, without a hit.

    Args:
        actions: (W, 2) in [−1, 1]; see `RobotVectorEnv`.
        period: seconds.
        limits: `Robot.limits`.
        bounds: x_min, x_max, y_min, y_max in metres.
        walls: a `WallTable` whose cells list walls up to `limits.radius` + a substep away.
        position: (W, 2) metres, which is changed, as are
        heading: (W,) radians.
        velocity: (W, 2) m/s in the world frame.
        speed: (W,) forward speed, m/s.
        turn: (W,) turn rate in rad/s, or steering angle of a bicycle in radians.
        hit: (W,) whether the robot met a wall.
    """
    # A substep is no longer than the radius, so that no robot jumps over a wall.
    parts = max(1, math.ceil(period / min(SUBSTEP_S, limits.radius / limits.max_speed) - 1e-6))
    h = period / parts
    for w in range(len(actions)):
        a = min(1.0, max(-1.0, np.float64(actions[w, 0])))
        b = min(1.0, max(-1.0, np.float64(actions[w, 1])))
        x, y, angle = position[w, 0], position[w, 1], heading[w]
        vx, vy, v, rate = velocity[w, 0], velocity[w, 1], speed[w], turn[w]
        hit[w] = False
        if limits.kind == HOLONOMIC:  # relative to the heading at the beginning of the period
            want_x, want_y = _wanted(a, b, angle, limits.max_speed)
        for _ in range(parts):
            if limits.kind == HOLONOMIC:
                vx, vy = _approach(vx, vy, want_x, want_y, limits.max_acceleration * h)
                v = math.sqrt(vx * vx + vy * vy)
                to_x, to_y, to_angle = x + vx * h, y + vy * h, angle
                if v > 1e-9:
                    to_angle = math.atan2(vy, vx)
            else:
                want = min(limits.max_speed, max(limits.min_speed, a * limits.max_speed))
                most = limits.max_acceleration * h
                v += min(most, max(-most, want - v))
                if limits.kind == BICYCLE:
                    most = limits.max_turn * h
                    rate += min(most, max(-most, b * limits.max_steer - rate))
                    yaw = v * math.tan(rate) / limits.wheelbase
                else:
                    most = limits.max_turn_acceleration * h
                    rate += min(most, max(-most, b * limits.max_turn - rate))
                    yaw = rate
                to_x, to_y, to_angle = _along_arc(x, y, angle, v, yaw, h)
            share = _free_share(x, y, to_x, to_y, limits.radius, walls)
            x, y, angle = x + share * (to_x - x), y + share * (to_y - y), to_angle
            inside_x = min(bounds[1], max(bounds[0], x))
            inside_y = min(bounds[3], max(bounds[2], y))
            stopped = inside_x != x or inside_y != y
            x, y = inside_x, inside_y
            if share < 1.0 or stopped:
                hit[w] = hit[w] or share < 1.0
                vx, vy, v = 0.0, 0.0, 0.0
        if limits.kind != HOLONOMIC:
            vx, vy = v * math.cos(angle), v * math.sin(angle)
        position[w, 0], position[w, 1] = x, y
        heading[w] = (angle + math.pi) % (2.0 * math.pi) - math.pi
        velocity[w, 0], velocity[w, 1] = vx, vy
        speed[w], turn[w] = v, rate


@compiled
def _wanted(a, b, angle, max_speed):
    """Velocity in the world frame that a holonomic robot is commanded, in m/s."""
    scale = max_speed / max(1.0, math.sqrt(a * a + b * b))
    cos, sin = math.cos(angle), math.sin(angle)
    return scale * (a * cos - b * sin), scale * (b * cos + a * sin)


@compiled
def _approach(vx, vy, want_x, want_y, most):
    """The velocity v changed towards another one by at most `most`."""
    dx, dy = want_x - vx, want_y - vy
    change = math.sqrt(dx * dx + dy * dy)
    share = min(1.0, most / change) if change > 0.0 else 1.0
    return vx + share * dx, vy + share * dy


@compiled
def _along_arc(x, y, angle, v, yaw, h):
    """Pose after driving for h seconds at the speed v and the turn rate `yaw`."""
    half = 0.5 * yaw * h
    chord = v * h * (math.sin(half) / half if abs(half) > 1e-9 else 1.0)
    return x + chord * math.cos(angle + half), y + chord * math.sin(angle + half), angle + 2 * half


@compiled
def _free_share(x, y, to_x, to_y, radius, walls):
    """Share of a straight move that a disc can go until it meets a wall."""
    cell = cell_of(x, y, (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows))
    way = math.hypot(to_x - x, to_y - y)
    if way == 0.0 or walls.clear[cell] > way + radius + GAP_M:
        return 1.0
    first, stop = walls.step_start[cell], walls.step_start[cell + 1]
    share = 1.0
    for k in range(first, stop):
        s = walls.segments[walls.step_segment[k]]
        end = distance_to_segment(
            x + share * (to_x - x), y + share * (to_y - y), s[0], s[1], s[2], s[3]
        )
        if end > radius + GAP_M:
            continue
        here = distance_to_segment(x, y, s[0], s[1], s[2], s[3])
        if end >= here:  # it is too near already, and may go away or along
            continue
        low, high = 0.0, share
        if here > radius + GAP_M:
            for _ in range(HALVINGS):
                middle = 0.5 * (low + high)
                off = distance_to_segment(
                    x + middle * (to_x - x), y + middle * (to_y - y), s[0], s[1], s[2], s[3]
                )
                if off > radius + GAP_M:
                    low = middle
                else:
                    high = middle
        share = low
    return share
