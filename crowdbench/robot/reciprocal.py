"""`orca`: a robot that avoids people reciprocally, computed by the RVO2 library.

The method is that of van den Berg, Guy, Lin & Manocha (2011), Reciprocal n-body collision
avoidance, Springer Tracts in Advanced Robotics 70, 3. The robot takes the velocity nearest to its
wanted one that avoids collisions for a given time, if people make half of each avoidance. People
who do not see the robot, or cannot react, make none. The horizon for people is that of CrowdNav's
ORCA (Chen et al. 2019, ICRA, 6015-6022). A robot that is not holonomic follows the velocity as well
as it can (`crowdbench.robot.following`).
"""

import numpy as np
from jaxtyping import Float32
from shapely import LinearRing

from crowdbench.errors import SettingError, to_install
from crowdbench.robot.following import follow
from crowdbench.robot.robots import Robot
from crowdbench.robot.seeing import RobotView
from crowdbench.scene import Scene

HORIZON_S = 5.0
"""Time without collisions with people, τ."""
WALL_HORIZON_S = 1.0
RANGE_M = 10.0
"""Distance up to which people are avoided."""
MARGIN_M = 0.05
"""Distance that is kept from the surfaces of people."""
NUDGE_MPS = 0.01
"""Sideways part of the wanted velocity, by which the robot does not stop in front of people who
come straight towards it."""
FAR_M, APART_M = 1000.0, 20.0


class Orca:
    """Robots that share the avoidance of collisions with people."""

    name = "orca"

    def __init__(self) -> None:
        try:
            import pyrvo  # noqa: F401
        except ImportError as error:
            raise SettingError(
                "controller orca",
                got=f"no {error.name}",
                expected="the package of RVO2",
                hint=to_install("orca"),
            ) from error

    def reset(self, scene: Scene, robot: Robot, worlds: int, period_s: float) -> None:
        """Load the walls of `scene`. One simulator serves all worlds in turn: it has no memory."""
        from pyrvo import RVOSimulator

        self._agents = 0
        self._simulator = RVOSimulator(
            period_s, RANGE_M, 10, HORIZON_S, WALL_HORIZON_S, robot.radius_m, robot.max_speed_mps
        )
        for wall in scene.walls:
            corners = wall.corners_m
            # Anticlockwise, because for RVO2 the right side of an edge is outside.
            solid = corners if LinearRing(corners).is_ccw else corners[::-1]
            self._simulator.add_obstacle(solid)
        self._simulator.process_obstacles()

    def act(self, view: RobotView) -> Float32[np.ndarray, "W 2"]:
        """Actions (W, 2)."""
        robot, simulator = view.robot, self._simulator
        way = (view.towards - view.position).astype(np.float64)
        length = np.maximum(np.hypot(way[:, 0], way[:, 1]), 1e-9)[:, None]
        ahead = way / length
        aside = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
        wanted = robot.max_speed_mps * ahead + NUDGE_MPS * aside
        worlds, most = view.there.shape
        self._add_agents(1 + most)
        count = view.there.sum(axis=1).tolist()
        own = np.column_stack([view.position, view.velocity, wanted]).tolist()
        others = np.concatenate(
            [view.near, view.near_velocity, view.near_radius[:, :, None] + MARGIN_M], axis=2
        ).tolist()
        velocity = np.empty((worlds, 2))
        here = most
        for w in range(worlds):
            x, y, vx, vy, wx, wy = own[w]
            simulator.set_agent_position(0, (x, y))
            simulator.set_agent_velocity(0, (vx, vy))
            simulator.set_agent_pref_velocity(0, (wx, wy))
            for k in range(count[w]):
                x, y, vx, vy, radius = others[w][k]
                simulator.set_agent_position(k + 1, (x, y))
                simulator.set_agent_velocity(k + 1, (vx, vy))
                simulator.set_agent_radius(k + 1, radius)
            for k in range(count[w], here):
                simulator.set_agent_position(k + 1, (FAR_M + APART_M * k, FAR_M))
                simulator.set_agent_velocity(k + 1, (0.0, 0.0))
            here = count[w]
            simulator.do_step()
            velocity[w] = simulator.get_agent_velocity(0).to_tuple()
        for k in range(here):  # nobody is left from the last world
            simulator.set_agent_position(k + 1, (FAR_M + APART_M * k, FAR_M))
        return follow(robot, view, velocity)

    def _add_agents(self, count: int) -> None:
        for k in range(self._agents, count):
            self._simulator.add_agent((FAR_M + APART_M * k, FAR_M))
        self._agents = max(self._agents, count)
