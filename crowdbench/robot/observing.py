"""What robots observe: `social`, `lidar` or `state`, from the view of their true state."""

import math
from typing import Any

import numpy as np
from gymnasium import spaces

from crowdbench.compilation import compiled
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.encounters import Present
from crowdbench.robot.lidar import disturb, scan
from crowdbench.robot.seeing import RobotView

OWN = 6
"""Numbers in `social` and `lidar` about the robot and its path."""
PROBES = 16
"""Number of directions in which `social` shows the distance to the nearest wall."""
OF_PERSON = 6
"""Numbers in `social` about each of the nearest people."""
_WINDING = 4.0  # no path is longer than this times width plus height of a scene
_ROUNDING = 1e-3
FASTEST_MPS = 3.0
"""Velocities relative to the robot are divided by this, and clipped."""


class Observer:
    """Computes the observations of W robots.

    - `social` (6 + 16 + 6K numbers in [−1, 1]), in the robot's frame, whose x axis is its heading:
      the unit vector to the next point of the path; the distance to it and the length of the path,
      both divided by the range and clipped at 1; the forward speed divided by the largest; the turn
      rate or steering angle divided by the largest; the distances to the nearest wall in 16
      directions, beginning at the back and turning left, divided by the range; and for each of the
      K nearest people its position (divided by the range), its velocity relative to the robot
      (divided by 3 m/s), the distance of both surfaces (divided by the range), and 1. All six
      numbers are 0 where there is nobody.
    - `lidar` (6 + R numbers in [−1, 1]): the first six numbers of `social`, and the ranges of R
      rays to people and walls, divided by the range.
    - `state`: a dictionary of float32 arrays in metres, m/s and radians, in the frame of the scene:
      `robot` (10: position, velocity, heading, forward speed, turn rate or steering angle, radius,
      next point of the path), `goal` (3: position, length of the path), `people` (K, 5: position,
      velocity, radius) and `there` (K: 1 for each person who is there).
    """

    def __init__(self, config: RobotConfig, view: RobotView, segments: np.ndarray) -> None:
        self._config, self._view, self._segments = config, view, segments
        worlds = len(view.heading)
        rays = config.rays if config.observation == "lidar" else PROBES
        self._ranges = np.zeros((worlds, rays))
        size = OWN + (
            rays if config.observation == "lidar" else PROBES + OF_PERSON * config.nearest
        )
        self._numbers = np.zeros((worlds, size), np.float32)

    @property
    def space(self) -> spaces.Space[Any]:
        """The observation space of one robot."""
        if self._config.observation != "state":
            return spaces.Box(-1.0, 1.0, self._numbers.shape[1:], np.float32)
        return _state_space(self._view, self._config.nearest)

    def observe(
        self, worlds: np.ndarray, present: Present, keys: np.ndarray, steps: np.ndarray
    ) -> Any:
        """Observations of all robots, computed anew in some worlds, (W, size) or a dictionary.

        `keys` and `steps` (W,) are what the noise of scans is drawn from.
        """
        view, config = self._view, self._config
        if config.observation == "state":
            return self._state()
        lidar = config.observation == "lidar"
        radius = view.near_radius.dtype.type(0.0)
        if lidar:
            motion = view.scene.motion
            radius = motion.body_radius_m or motion.person_radius_m
        scan(
            worlds, view.position, view.heading, self._segments, present, float(radius),
            config.range_m, self._ranges,
        )  # fmt: skip
        if lidar and (config.range_noise_m > 0 or config.drop_out > 0):
            disturb(
                worlds, keys, steps, config.range_noise_m, config.drop_out, config.range_m,
                self._ranges,
            )  # fmt: skip
        robot = view.robot
        _write(
            worlds, view.position, view.heading, view.velocity, view.speed, view.turn,
            view.towards, view.remaining, view.near, view.near_velocity, view.near_radius,
            view.there, robot.max_speed_mps, robot.turn_limit, robot.radius_m, config.range_m,
            self._ranges, not lidar, self._numbers,
        )  # fmt: skip
        return self._numbers.copy()

    def _state(self) -> dict[str, np.ndarray]:
        v = self._view
        radius = np.full(len(v.heading), v.robot.radius_m)
        own = [v.position, v.velocity, v.heading, v.speed, v.turn, radius, v.towards]
        return {
            "robot": np.column_stack(own).astype(np.float32),
            "goal": np.column_stack([v.goal, v.remaining]).astype(np.float32),
            "people": np.concatenate(
                [v.near, v.near_velocity, v.near_radius[..., None]], axis=2
            ).astype(np.float32),
            "there": v.there.astype(np.float32),
        }


def _state_space(view: RobotView, nearest: int) -> spaces.Dict:
    """The space of `state`; people may leave the bounds of the scene by one step."""
    b, motion, robot = view.scene.bounds, view.scene.motion, view.robot
    step_m = motion.max_speed_mps * view.scene.dt_s
    low = np.array([b.x_min_m, b.y_min_m]) - step_m
    high = np.array([b.x_max_m, b.y_max_m]) + step_m
    fastest = np.full(2, max(motion.max_speed_mps, robot.max_speed_mps) + 1.0)
    turn = max(robot.turn_limit, np.pi)
    longest = _WINDING * float((high - low).sum())
    own_low = np.concatenate([low, -fastest, [-np.pi, -fastest[0], -turn, 0.0], low])
    own_high = np.concatenate([high, fastest, [np.pi, fastest[0], turn, robot.radius_m], high])
    person_low = np.minimum(np.concatenate([low, -fastest, [0.0]]), 0.0)
    person_high = np.maximum(np.concatenate([high, fastest, [1.0]]), 0.0)

    def box(lowest: np.ndarray, highest: np.ndarray) -> spaces.Box:
        return spaces.Box(lowest.astype(np.float32), highest.astype(np.float32), dtype=np.float32)

    return spaces.Dict(
        {
            "robot": box(own_low - _ROUNDING, own_high + _ROUNDING),
            "goal": box(np.append(low, 0.0), np.append(high, longest)),
            "people": box(np.tile(person_low, (nearest, 1)), np.tile(person_high, (nearest, 1))),
            "there": spaces.Box(0.0, 1.0, (nearest,), np.float32),
        }
    )


@compiled
def _write(
    worlds, position, heading, velocity, speed, turn, towards, remaining, near, near_velocity,
    near_radius, there, max_speed, max_turn, radius, range_m, ranges, people, out,
):  # fmt: skip
    """Write the numbers of `social`, if `people` are shown, or of `lidar`; see `Observer`."""
    rays = ranges.shape[1]
    for w in worlds:
        cos, sin = math.cos(heading[w]), math.sin(heading[w])
        dx, dy = towards[w, 0] - position[w, 0], towards[w, 1] - position[w, 1]
        way = math.sqrt(dx * dx + dy * dy)
        scale = 1.0 / way if way > 0.0 else 0.0
        out[w, 0] = _clip(scale * (dx * cos + dy * sin))
        out[w, 1] = _clip(scale * (dy * cos - dx * sin))
        out[w, 2] = min(1.0, way / range_m)
        out[w, 3] = min(1.0, remaining[w] / range_m)
        out[w, 4] = _clip(speed[w] / max_speed)
        out[w, 5] = _clip(turn[w] / max_turn)
        for r in range(rays):
            out[w, OWN + r] = min(1.0, ranges[w, r] / range_m)
        if not people:
            continue
        for k in range(there.shape[1]):
            at = OWN + rays + k * OF_PERSON
            out[w, at : at + OF_PERSON] = 0.0
            if there[w, k]:
                dx, dy = near[w, k, 0] - position[w, 0], near[w, k, 1] - position[w, 1]
                vx = near_velocity[w, k, 0] - velocity[w, 0]
                vy = near_velocity[w, k, 1] - velocity[w, 1]
                gap = math.sqrt(dx * dx + dy * dy) - radius - near_radius[w, k]
                out[w, at] = _clip((dx * cos + dy * sin) / range_m)
                out[w, at + 1] = _clip((dy * cos - dx * sin) / range_m)
                out[w, at + 2] = _clip((vx * cos + vy * sin) / FASTEST_MPS)
                out[w, at + 3] = _clip((vy * cos - vx * sin) / FASTEST_MPS)
                out[w, at + 4] = _clip(gap / range_m)
                out[w, at + 5] = 1.0


@compiled
def _clip(value):
    return min(1.0, max(-1.0, value))
