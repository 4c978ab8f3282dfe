"""`RobotView`: the true state of robots and of the people near them."""

import math
from typing import NamedTuple

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.robot.robots import Robot
from crowdbench.scene import Scene
from crowdbench.simulation.free_space import free_distance

_EXTRA_M = 0.02
_STEP_M = 0.1


class RobotView(NamedTuple):
    """True state of the robots of W worlds, from which observations and controllers are computed.

    The next step changes the arrays in place. All but `there` are float64.
    """

    scene: Scene
    robot: Robot
    period_s: float
    """Control period, seconds."""
    position: np.ndarray
    """(W, 2) metres."""
    heading: np.ndarray
    """(W,) radians, from −π to π."""
    velocity: np.ndarray
    """(W, 2) m/s in the world frame."""
    speed: np.ndarray
    """(W,) forward speed, m/s; negative in reverse."""
    turn: np.ndarray
    """(W,) turn rate in rad/s, or steering angle of a bicycle in radians; positive to the left."""
    goal: np.ndarray
    """(W, 2) present goal, metres."""
    towards: np.ndarray
    """(W, 2) next point on the shortest path to the goal that keeps the robot off walls, metres."""
    remaining: np.ndarray
    """(W,) length of that path, metres."""
    near: np.ndarray
    """(W, K, 2) positions of the nearest people, nearest first, metres."""
    near_velocity: np.ndarray
    """(W, K, 2) their velocities in the world frame, m/s."""
    near_radius: np.ndarray
    """(W, K) their radii, metres."""
    there: np.ndarray
    """(W, K) bool: whether there is such a person; the other arrays are 0 elsewhere."""

    @classmethod
    def empty(
        cls, scene: Scene, robot: Robot, period_s: float, worlds: int, nearest: int
    ) -> "RobotView":
        """A view of nothing, in which the arrays are filled later."""
        pairs = ("position", "velocity", "goal", "towards")
        numbers = ("heading", "speed", "turn", "remaining")
        return cls(
            scene,
            robot,
            period_s,
            **{name: np.zeros((worlds, 2)) for name in pairs},
            **{name: np.zeros(worlds) for name in numbers},
            near=np.zeros((worlds, nearest, 2)),
            near_velocity=np.zeros((worlds, nearest, 2)),
            near_radius=np.zeros((worlds, nearest)),
            there=np.zeros((worlds, nearest), np.bool_),
        )


@compiled
def find_nearest(
    worlds, position, present, range_m, radius, near, near_velocity, near_radius, there
):
    """Write the K people nearest to the robots of some worlds, within a range in metres.

    Args:
        worlds: (n,) indices of worlds.
        position: (W, 2) of the robots, metres.
        present: `Present`.
        range_m: people further away than this are not seen.
        radius: of a person, metres.
        near, near_velocity, near_radius, there: see `RobotView`.
    """
    most = there.shape[1]
    who, gaps = np.empty(most, np.int64), np.empty(most)
    for w in worlds:
        found = 0
        for i in range(present.there.shape[1]):
            if not present.there[w, i]:
                continue
            dx = present.position[w, i, 0] - position[w, 0]
            dy = present.position[w, i, 1] - position[w, 1]
            gap = dx * dx + dy * dy
            if gap > range_m * range_m or (found == most and gap >= gaps[most - 1]):
                continue
            k = found if found < most else most - 1
            found = min(found + 1, most)
            while k > 0 and gap < gaps[k - 1]:
                gaps[k], who[k] = gaps[k - 1], who[k - 1]
                k -= 1
            gaps[k], who[k] = gap, i
        for k in range(most):
            there[w, k] = k < found
            near_radius[w, k] = radius if k < found else 0.0
            for c in range(2):
                near[w, k, c] = present.position[w, who[k], c] if k < found else 0.0
                near_velocity[w, k, c] = present.velocity[w, who[k], c] if k < found else 0.0


@compiled
def off_walls(position, off_m, free):
    """Move points (n, 2) that are nearer to walls or bounds than `off_m` away from them.

    Paths of robots begin there, because walls are thicker for these. `free` is the grid of the
    scene.
    """
    grid = (free.x_min, free.y_min, free.per_x, free.per_y, free.columns, free.rows)
    for k in range(len(position)):
        for _ in range(2):  # the second time for corners
            x, y = position[k, 0], position[k, 1]
            lacks = off_m + _EXTRA_M - free_distance(x, y, free.distance, grid)
            if lacks <= 0.0:
                break
            along_x = free_distance(x + _STEP_M, y, free.distance, grid)
            along_x -= free_distance(x - _STEP_M, y, free.distance, grid)
            along_y = free_distance(x, y + _STEP_M, free.distance, grid)
            along_y -= free_distance(x, y - _STEP_M, free.distance, grid)
            length = math.sqrt(along_x * along_x + along_y * along_y)
            if length > 0.0:
                position[k, 0] = x + lacks * along_x / length
                position[k, 1] = y + lacks * along_y / length
