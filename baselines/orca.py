"""Optimal reciprocal collision avoidance (ORCA), computed by the RVO2 library.

The method is that of van den Berg, Guy, Lin & Manocha (2011), Reciprocal n-body collision
avoidance, Springer Tracts in Advanced Robotics 70, 3. Each person takes the velocity closest to
its preferred one that avoids collisions for a given time, if everyone makes half of each avoidance.
With the package of RVO2 (extra `orca`): `crowdbench evaluate eth-v0 --policy
crowdbench.baselines.orca:ORCA`.

The parameters are those that the authors of RVO2 use for pedestrians in Menge (Curtis, Best &
Manocha 2016, Collective Dynamics 1, A1): its default horizons, and the neighbours of its
documentation. The radius is 0.2 m, the distance of shortest paths from corners, instead of 0.19 m.
The maximum speed is that of `social-force`. Measurements with arrivals of ntpp-gmm:

- With the scene's radius of 0.3 m, people block an entrance of `gc-v0` permanently as soon as many
  leave while many enter. With 0.2 m they do not. Recorded people also have someone closer than
  0.6 m: 16 % of the time there and 5 % on `eth-v0`. With a radius of 0.2 m it is 13 % and 10 %,
  with `straight` 11 % and 11 %.
- One step per frame of 0.4 s would be longer than the time horizon for walls. On `eth-v0`, steps of
  0.4, 0.2, 0.1 and 0.05 s lead to overlaps in 0.52, 0.38, 0.33 and 0.34 % of the time, with
  accelerations of 0.31, 0.32, 0.27 and 0.28 m/s² (root mean square).
- Eight to twelve people who walk to the opposite side of a circle 10 m wide block each other for 27
  to 42 s with the nudge of RVO2's examples, 10⁻⁴ m/s. With 0.01 m/s they need 9 to 10 s in total.
"""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32
from numpy.random import Generator
from shapely import LinearRing

from crowdbench.errors import SettingError, to_install
from crowdbench.policies import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes

BODY_M = 0.2  # radius; no more than crowdbench.simulation.routes.CORNER_M
NEIGHBOURS = 10  # maximum number of people that a person avoids
NEIGHBOUR_RANGE_M = 5.0
HORIZON_S = 2.5  # τ, time without collisions with people
WALL_HORIZON_S = 0.15  # time without collisions with walls
FASTEST = 1.3  # maximum speed as a multiple of the preferred one: Helbing & Molnár (1995), eq. 11
SUBSTEP_S = 0.1
NUDGE_MPS = 0.01  # perturbation of the preferred velocity, in another direction for each person
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
FAR_M, APART_M = 1000.0, 10.0  # positions of unused agents, out of range of everyone


class ORCA:
    """Walkers who share the avoidance of collisions equally."""

    name = "orca"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True

    def __init__(self) -> None:
        try:
            import pyrvo  # noqa: F401
        except ImportError as error:
            raise SettingError(
                "policy orca",
                got=f"no {error.name}",
                expected="the package of RVO2",
                hint=to_install("orca"),
            ) from error

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`; there are no random draws."""
        self._scene = scene
        self._routes = Routes.on(scene)
        self._crowds: dict[int, Crowd] = {}

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocities (A, 2) over the frame, in units of the maximum speed."""
        dt_s, most = self._scene.dt_s, self._scene.motion.max_speed_mps
        way = seen.towards(self._routes) - seen.position
        distance = np.linalg.norm(way, axis=1)
        speed = np.minimum(seen.speed, distance / dt_s)
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        # Breaks the symmetry of people who meet head-on or have the same position.
        angle = GOLDEN_ANGLE * seen.person
        nudge = NUDGE_MPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        fastest = np.minimum(FASTEST * seen.speed, most)
        radius = BODY_M + seen.wider
        state = np.column_stack(
            [seen.position, seen.velocity + nudge, way * scale[:, None] + nudge, fastest, radius]
        )
        moved = np.empty_like(way)
        for world in np.unique(seen.world).tolist():
            if world not in self._crowds:
                self._crowds[world] = Crowd(self._scene)
            here = seen.world == world
            moved[here] = self._crowds[world].walk(state[here])
        # In dense crowds, RVO2's linear programs (float32) exceed the given maximum speed.
        length = np.linalg.norm(moved, axis=1)
        moved *= np.minimum(1.0, fastest * dt_s / np.maximum(length, 1e-9))[:, None]
        return (moved / (dt_s * most)).astype(np.float32)


class Crowd:
    """The RVO2 simulator of one world, whose walls and agents are kept between frames.

    The complete state of an agent is set before each frame, so agent k can represent the k-th
    person present. Unused agents are placed far away, out of range of everyone. (pyrvo 0.4.3 has
    `clear_agents`, but its search tree keeps references to removed agents.)
    """

    def __init__(self, scene: Scene) -> None:
        from pyrvo import RVOSimulator

        self.steps = max(1, round(scene.dt_s / SUBSTEP_S))
        self.simulator = RVOSimulator(
            scene.dt_s / self.steps,
            NEIGHBOUR_RANGE_M,
            NEIGHBOURS,
            HORIZON_S,
            WALL_HORIZON_S,
            BODY_M,
            0.0,
        )
        for wall in scene.walls:
            corners = wall.corners_m
            # Anticlockwise, because for RVO2 the right side of an edge is outside.
            solid = corners if LinearRing(corners).is_ccw else corners[::-1]
            self.simulator.add_obstacle(solid)
        self.simulator.process_obstacles()
        self._present = 0

    def walk(self, state: Float[np.ndarray, "A 8"]) -> Float[np.ndarray, "A 2"]:
        """Displacements (A, 2) in a frame, in metres.

        A row of `state` is a position, a velocity, a preferred velocity, a maximum speed and a
        radius.
        """
        simulator, size = self.simulator, len(state)
        for _ in range(simulator.get_num_agents(), size):
            simulator.add_agent((0.0, 0.0))
        for k in range(size, self._present):
            self._tell(k, FAR_M + APART_M * k, FAR_M, 0.0, 0.0, 0.0, 0.0, 0.0, BODY_M)
        self._present = size
        for k, row in enumerate(state.tolist()):
            self._tell(k, *row)
        for _ in range(self.steps):
            simulator.do_step()
        there = [simulator.get_agent_position(k).to_tuple() for k in range(size)]
        return np.array(there) - state[:, :2]

    def _tell(
        self,
        k: int,
        x: float,
        y: float,
        vx: float,
        vy: float,
        px: float,
        py: float,
        fastest: float,
        radius: float,
    ) -> None:
        self.simulator.set_agent_position(k, (x, y))
        self.simulator.set_agent_velocity(k, (vx, vy))
        self.simulator.set_agent_pref_velocity(k, (px, py))
        self.simulator.set_agent_max_speed(k, fastest)
        self.simulator.set_agent_radius(k, radius)
