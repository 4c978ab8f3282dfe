"""`dwa`: the dynamic window approach among people who move.

The method is that of Fox, Burgard & Thrun (1997), The dynamic window approach to collision
avoidance, IEEE Robotics & Automation Magazine 4(1), 23-33. Of the commands that the robot can reach
within one control period, those are admissible after which it can still stop before it touches
something. Among them, it takes the one with the largest sum of heading, clearance and velocity
(eq. 13). Three things differ, because people move:

- Clearance is the time without contact on the arc, instead of the distance, and people are
  predicted to keep their velocities (as in Seder & Petrović 2007, ICRA, 1986-1991).
- A holonomic robot chooses among velocities in all directions, a car among speeds and steering
  angles (Brock & Khatib 1999, ICRA, 341-346, for the former).
- The weights are chosen for people; the objective is not smoothed over neighbouring commands.
"""

import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit, prange

from crowdbench.compilation import Kernel
from crowdbench.robot.robots import BICYCLE, HOLONOMIC, UNICYCLE, Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.scene import Scene
from crowdbench.simulation.rules import distance_to_segment, to_own_frame

NEARER_M = 1e-3
"""Approach of somebody who is within the margin already that counts as contact."""


class Window(NamedTuple):
    """Settings of the search."""

    heading: float = 1.0
    """Weight of the alignment with the way, α."""
    clearance: float = 1.0
    """Weight of the share of the horizon without contact, β."""
    velocity: float = 0.5
    """Weight of the speed, γ."""
    horizon_s: float = 2.0
    """Time for which each command is tried."""
    step_s: float = 0.2
    """Time between two positions that are tested for contact."""
    person_margin_m: float = 0.1
    """Distance between the surfaces of robot and person that counts as contact."""
    wall_margin_m: float = 0.05
    """The same for walls."""
    speeds: int = 7
    """Number of speeds, or of velocities along x, in the window."""
    turns: int = 11
    """Number of turn rates or steering angles, or of velocities along y, in the window."""


USUAL = Window()


class DynamicWindow:
    """Robots that choose among the commands that they can reach in a control period."""

    name = "dwa"

    def __init__(self, window: Window = USUAL) -> None:
        self.window = window

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:
        """Take the walls of `scene` and the limits of `robot`."""
        self._segments = np.ascontiguousarray(scene.wall_segments)
        self._limits = robot.limits
        second = robot.max_speed_mps if robot.kinematics == "holonomic" else robot.turn_limit
        self._unit = np.array([robot.max_speed_mps, second])

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:
        """Actions (W, 2)."""
        best = np.empty((len(view.position), 2))
        _choose(
            len(best),
            best,
            *(
                np.ascontiguousarray(values, np.float64)
                for values in (
                    view.position, view.heading, view.velocity, view.speed, view.turn,
                    view.towards, view.remaining, view.near, view.near_velocity, view.near_radius,
                )
            ),
            np.ascontiguousarray(view.there),
            self._segments,
            self._limits,
            view.period_s,
            self.window,
        )  # fmt: skip
        return np.clip(best / self._unit, -1.0, 1.0).astype(np.float32)


@Kernel
def _choose(
    best, position, heading, velocity, speed, turn, towards, remaining, near, near_velocity,
    near_radius, there, segments, limits, period_s, window,
):  # fmt: skip
    """Write the best command of each robot to `best` (W, 2), in m/s and rad/s (or rad).

    All is computed in the robot's own frame, in which its heading is 0.
    """
    for w in prange(len(best)):
        frame = (position[w, 0], position[w, 1], math.cos(heading[w]), math.sin(heading[w]))
        people = _people_ahead(
            frame, near[w], near_velocity[w], near_radius[w], there[w], limits, window
        )
        walls = _walls_ahead(frame, segments, limits, window)
        now = (speed[w], turn[w])
        if limits.kind == HOLONOMIC:
            now = to_own_frame(velocity[w, 0], velocity[w, 1], frame[2], frame[3])
        x, y = _point(towards[w, 0], towards[w, 1], frame)
        best[w, 0], best[w, 1] = _best_of(
            now, math.atan2(y, x), remaining[w], people, walls, limits, period_s, window
        )


@njit(error_model="numpy")
def _point(x, y, frame):
    """A point in the robot's own frame, which is (x, y, cosine and sine of the heading)."""
    return to_own_frame(x - frame[0], y - frame[1], frame[2], frame[3])


@njit(error_model="numpy")
def _people_ahead(frame, near, velocity, radius, there, limits, window):
    """People whom the robot can touch within the horizon: x, y, vx, vy and distance of contact.

    They are in the robot's frame. The distance of contact of somebody who is nearer already is the
    present one, so that commands which lead away from them are free.
    """
    people = np.empty((len(near), 5))
    count = 0
    for k in range(len(near)):
        if not there[k]:
            continue
        x, y = _point(near[k, 0], near[k, 1], frame)
        apart = math.sqrt(x * x + y * y)
        contact = limits.radius + radius[k] + window.person_margin_m
        fastest = limits.max_speed + math.sqrt(velocity[k, 0] ** 2 + velocity[k, 1] ** 2)
        if apart - contact > fastest * window.horizon_s:
            continue
        vx, vy = to_own_frame(velocity[k, 0], velocity[k, 1], frame[2], frame[3])
        people[count, 0], people[count, 1], people[count, 2], people[count, 3] = x, y, vx, vy
        people[count, 4] = min(contact, apart - NEARER_M)
        count += 1
    return people[:count]


@njit(error_model="numpy")
def _walls_ahead(frame, segments, limits, window):
    """Walls that the robot can touch within the horizon: both ends and the distance of contact."""
    walls = np.empty((len(segments), 5))
    count = 0
    contact = limits.radius + window.wall_margin_m
    for s in range(len(segments)):
        ax, ay = _point(segments[s, 0], segments[s, 1], frame)
        bx, by = _point(segments[s, 2], segments[s, 3], frame)
        apart = distance_to_segment(0.0, 0.0, ax, ay, bx, by)
        if apart - contact > limits.max_speed * window.horizon_s:
            continue
        walls[count, 0], walls[count, 1], walls[count, 2], walls[count, 3] = ax, ay, bx, by
        walls[count, 4] = min(contact, apart - NEARER_M)
        count += 1
    return walls[:count]


@njit(error_model="numpy")
def _best_of(now, way, remaining, people, walls, limits, period_s, window):
    """The best command of one robot; the slowest if none is admissible.

    `way` is the direction of its way in its own frame, in radians.
    """
    holonomic = limits.kind == HOLONOMIC
    fastest, change = limits.max_speed, limits.max_acceleration * period_s
    slowest = -fastest if holonomic else limits.min_speed
    low, high = _window(now[0], change, slowest, fastest)
    if holonomic:
        left, right = _window(now[1], change, -fastest, fastest)
    elif limits.kind == UNICYCLE:
        most, turn_change = limits.max_turn, limits.max_turn_acceleration * period_s
        left, right = _window(now[1], turn_change, -most, most)
    else:
        most, turn_change = limits.max_steer, limits.max_turn * period_s
        left, right = _window(now[1], turn_change, -most, most)
    # Not faster than a metre from the goal per second, so that the robot does not circle around it.
    wanted = min(fastest, max(0.2 * fastest, remaining)) if remaining > 0.0 else 0.0
    best, top = (now[0], now[1]), -np.inf
    safe, least = (0.0, 0.0), np.inf
    for i in range(window.speeds):
        for j in range(window.turns):
            first = low + (high - low) * i / (window.speeds - 1)
            second = left + (right - left) * j / (window.turns - 1)
            speed = first
            if holonomic:
                speed = math.sqrt(first * first + second * second)
                gained = math.sqrt((first - now[0]) ** 2 + (second - now[1]) ** 2)
                if speed > fastest + 1e-9 or gained > change + 1e-9:
                    continue
            free_s = _free_s(first, second, people, walls, limits, window)
            if abs(speed) < least:
                least, safe = abs(speed), (first, second)
            # v ≤ √(2·dist·a) of eq. 14, with dist = v·t.
            if (
                free_s < window.horizon_s
                and abs(speed) > 2.0 * limits.max_acceleration * free_s + 1e-3
            ):
                continue
            angle = _angle_to_way(first, second, way, limits, period_s)
            value = (
                window.heading * (1.0 - angle / math.pi)
                + window.clearance * free_s / window.horizon_s
                + window.velocity * (1.0 - abs(speed - wanted) / fastest)
            )
            if value > top:
                top, best = value, (first, second)
    return best if top > -np.inf else safe


@njit(error_model="numpy")
def _window(now, change, least, most):
    """Values from `least` to `most` that can be reached from the present one, as an interval."""
    now = min(most, max(least, now))
    return max(least, now - change), min(most, now + change)


@njit(error_model="numpy")
def _turn_rate(first, second, limits):
    if limits.kind == BICYCLE:
        return first * math.tan(second) / limits.wheelbase
    return second


@njit(error_model="numpy")
def _angle_to_way(first, second, way, limits, period_s):
    """Angle between the way and where the robot heads after the next period, 0 to π.

    As in the paper, it is that after the robot has stopped turning with its largest deceleration.
    """
    if limits.kind == HOLONOMIC:
        if first * first + second * second < 1e-4 * limits.max_speed**2:
            return 0.5 * math.pi  # whoever stands has no direction
        ahead = math.atan2(second, first)
    else:
        rate = _turn_rate(first, second, limits)
        ahead = rate * period_s
        if limits.kind == UNICYCLE:
            ahead += 0.5 * rate * abs(rate) / limits.max_turn_acceleration
        else:
            ahead += 0.5 * rate * abs(first) / limits.max_acceleration
    off = way - ahead
    return abs(off - 2.0 * math.pi * round(off / (2.0 * math.pi)))


@njit(error_model="numpy")
def _free_s(first, second, people, walls, limits, window):
    """Time until the robot touches something on the arc of a command, at most the horizon."""
    holonomic = limits.kind == HOLONOMIC
    rate = 0.0 if holonomic else _turn_rate(first, second, limits)
    for k in range(1, int(window.horizon_s / window.step_s + 1e-6) + 1):
        t = k * window.step_s
        if holonomic:
            x, y = first * t, second * t
        elif abs(rate) < 1e-6:
            x, y = first * t, 0.0
        else:
            x = first / rate * math.sin(rate * t)
            y = first / rate * (1.0 - math.cos(rate * t))
        for p in range(len(people)):
            dx = people[p, 0] + people[p, 2] * t - x
            dy = people[p, 1] + people[p, 3] * t - y
            if dx * dx + dy * dy < people[p, 4] * people[p, 4]:
                return t - window.step_s
        for s in range(len(walls)):
            wall = walls[s]
            if distance_to_segment(x, y, wall[0], wall[1], wall[2], wall[3]) < wall[4]:
                return t - window.step_s
    return window.horizon_s
