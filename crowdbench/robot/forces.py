"""`social-force`: a robot that walks by the social forces of Helbing & Molnár (1995).

Forces are those of the people who walk by `crowdbench.policies.social_force`. The repulsion by
people is that of CrowdNav's social-force robot, 10 m²/s² (Chen et al. 2019, ICRA, 6015-6022):
nearly five times that of the paper, with which people hardly avoid each other. The robot wants to
drive at its maximum speed, and does not drive faster. People are predicted to keep their velocities
within the control period. A robot that is wider than a person keeps a larger distance.
"""

import math

import numpy as np
from jaxtyping import Float32
from numba import prange

from crowdbench.compilation import Kernel
from crowdbench.policies.near import walls_near
from crowdbench.policies.social_force import (
    COS_OF_VIEW,
    PUBLISHED,
    REACH_M,
    SUBSTEP_S,
    Forces,
    nearer,
    repulsion,
    wall_force,
)
from crowdbench.robot.following import follow
from crowdbench.robot.robots import Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.scene import Scene

CROWDNAV = PUBLISHED._replace(repulsion=10.0)


class ForceDriven:
    """Robots attracted by their goals and repelled by people and walls."""

    name = "social-force"

    def __init__(self, forces: Forces = CROWDNAV) -> None:
        self.forces = forces

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:
        """Load the walls of `scene`."""
        self._segments = np.ascontiguousarray(scene.wall_segments)
        self._walls = np.array(scene.wall_of_segment, dtype=np.int32)
        self._wider = max(0.0, robot.radius_m - scene.motion.person_radius_m)

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:
        """Actions (W, 2)."""
        robot, period_s = view.robot, view.period_s
        moved = np.empty((len(view.position), 2))
        near, count = walls_near(
            view.position.astype(np.float64),
            np.full(len(moved), REACH_M + robot.max_speed_mps * period_s),
            self._segments,
        )
        _drive(
            len(moved),
            moved,
            *(
                np.ascontiguousarray(values, np.float64)
                for values in (
                    view.position, view.velocity, view.towards, view.near, view.near_velocity,
                )
            ),
            np.ascontiguousarray(view.there),
            self._segments,
            self._walls,
            near,
            count,
            robot.max_speed_mps,
            self._wider,
            max(1, round(period_s / SUBSTEP_S)),
            period_s,
            self.forces,
        )  # fmt: skip
        return follow(robot, view, moved / period_s)


@Kernel
def _drive(
    moved, position, velocity, towards, near, near_velocity, there, segments, walls, near_walls,
    wall_count, speed, wider, substeps, period_s, forces,
):  # fmt: skip
    """Write the displacements (W, 2) in a control period to `moved`, in metres."""
    h = period_s / substeps
    for w in prange(len(moved)):
        x, y = position[w, 0], position[w, 1]
        vx, vy = velocity[w, 0], velocity[w, 1]
        ex, ey = 0.0, 0.0
        for step in range(substeps):
            gx, gy = towards[w, 0] - x, towards[w, 1] - y
            distance = math.sqrt(gx * gx + gy * gy)
            if distance > 0.0:
                ex, ey = gx / distance, gy / distance
            fx = (speed * ex - vx) / forces.relaxation_s
            fy = (speed * ey - vy) / forces.relaxation_s
            for k in range(there.shape[1]):
                if not there[w, k]:
                    continue
                px, py = near_velocity[w, k, 0], near_velocity[w, k, 1]
                rx = x - near[w, k, 0] - px * h * step
                ry = y - near[w, k, 1] - py * h * step
                rx, ry = nearer(rx, ry, wider)
                if rx * rx + ry * ry >= REACH_M * REACH_M:
                    continue
                px, py = repulsion(rx, ry, px * forces.step_s, py * forces.step_s, forces)
                toward = -(ex * px + ey * py)
                seen = toward >= math.sqrt(px * px + py * py) * COS_OF_VIEW
                weight = 1.0 if seen else forces.behind
                fx += weight * px
                fy += weight * py
            wx, wy = wall_force(x, y, segments, walls, near_walls[w, : wall_count[w]], forces)
            vx, vy = vx + h * (fx + wx), vy + h * (fy + wy)
            v = math.sqrt(vx * vx + vy * vy)
            scale = min(1.0, speed / v) if v > 0.0 else 1.0
            vx, vy = vx * scale, vy * scale
            x, y = x + h * vx, y + h * vy
        moved[w, 0], moved[w, 1] = x - position[w, 0], y - position[w, 1]
