"""Optimal reciprocal collision avoidance, as the RVO2 library computes it.

The method is van den Berg, Guy, Lin & Manocha (2011), Reciprocal n-body collision avoidance,
Springer Tracts in Advanced Robotics 70, 3: everyone takes the velocity that, of those at which
nobody is met for a while if all do their half of the avoiding, is nearest to the preferred one.
`pip install -e ".[orca]"`, then `crowdbench evaluate eth-v0 --policy baselines.orca:ORCA`.

Parameters are those that RVO2's authors gave pedestrians in Menge (Curtis, Best & Manocha 2016,
Collective Dynamics 1, A1): its default horizons, and the neighbours of its documentation, whose
bodies of 0.19 m are 0.2 m here, what ways keep off corners. The greatest speed is that of
`social-force`. What was measured, with arrivals by ntpp-gmm:

- Bodies of the scene's 0.3 m jam an entrance of `gc-v0` for good as soon as many come out while
  many go in; those of 0.2 m do not. Recorded people, too, have someone nearer than 0.6 m: 16 % of
  the time there, 5 % on `eth-v0`. Walkers with bodies of 0.2 m have 13 % and 10 %, `straight` has
  11 % and 11 %.
- One step per frame of 0.4 s would be longer than the walls' horizon. On `eth-v0`, steps of 0.4,
  0.2, 0.1 and 0.05 s let bodies overlap 0.52, 0.38, 0.33 and 0.34 % of the time, at accelerations
  of 0.31, 0.32, 0.27 and 0.28 m/s² (root mean square).
- Eight to twelve people who set out from a circle 10 m wide to its opposite side stand in each
  other's way for 27 to 42 s with the nudge of RVO2's examples, 10⁻⁴ m/s, and take 9 to 10 s in all
  with 0.01 m/s.
"""

from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float, Float32
from numpy.random import Generator
from shapely import LinearRing

from crowdbench.errors import SettingError
from crowdbench.policies import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes

BODY_M = 0.2  # radius; no more than crowdbench.simulation.routes.CLEARANCE_M
NEIGHBOURS = 10  # the nearest, whom a person avoids
NEIGHBOUR_RANGE_M = 5.0
HORIZON_S = 2.5  # τ, for how long nobody is to be met
WALL_HORIZON_S = 0.15  # likewise no wall
FASTEST = 1.3  # times the preferred speed: Helbing & Molnár (1995), eq. 11
SUBSTEP_S = 0.1
NUDGE_MPS = 0.01  # by which preferences are off, each person's in another direction
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))
FAR_M, APART_M = 1000.0, 10.0  # beyond anyone's range, of the scene and of each other


class ORCA:
    """Walkers who give way to each other, each by half."""

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
                expected="the package that computes it",
                hint='Install it, in the clone: pip install -e ".[orca]".',
            ) from error

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Take the walls of `scene`; nothing is left to chance."""
        self._scene = scene
        self._routes = Routes.on(scene)
        self._crowds: dict[int, Crowd] = {}

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocity over the frame, in units of the greatest speed."""
        dt_s, most = self._scene.dt_s, self._scene.motion.max_speed_mps
        way = seen.towards(self._routes) - seen.position
        distance = np.linalg.norm(way, axis=1)
        speed = np.minimum(seen.speed, distance / dt_s)
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        # Who meet in perfect symmetry, or stand in one place, would not know which side to take.
        angle = GOLDEN_ANGLE * seen.person
        nudge = NUDGE_MPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        fastest = np.minimum(FASTEST * seen.speed, most)
        state = np.column_stack(
            [seen.position, seen.velocity + nudge, way * scale[:, None] + nudge, fastest]
        )
        moved = np.empty_like(way)
        for world in np.unique(seen.world).tolist():
            if world not in self._crowds:
                self._crowds[world] = Crowd(self._scene)
            here = seen.world == world
            moved[here] = self._crowds[world].walk(state[here])
        # In a throng RVO2's linear programs, in float32, exceed the greatest speed they are given.
        length = np.linalg.norm(moved, axis=1)
        moved *= np.minimum(1.0, fastest * dt_s / np.maximum(length, 1e-9))[:, None]
        return (moved / (dt_s * most)).astype(np.float32)


class Crowd:
    """The simulator of one world, whose walls and agents stay from frame to frame.

    An agent knows no more than what it is told before each frame, so agent k is whoever is the
    k-th person there; those left over stand far away, out of everyone's sight. (pyrvo 0.4.3 can
    `clear_agents`, but its search tree goes on pointing to them.)
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
            # Anticlockwise: to RVO2, what is on the right of an edge is outside.
            solid = corners if LinearRing(corners).is_ccw else corners[::-1]
            self.simulator.add_obstacle(solid)
        self.simulator.process_obstacles()
        self._present = 0

    def walk(self, state: Float[np.ndarray, "A 7"]) -> Float[np.ndarray, "A 2"]:
        """How far everyone gets in a frame, metres.

        A row of `state` is a position, a velocity, the preferred velocity and the greatest speed.
        """
        simulator, size = self.simulator, len(state)
        for _ in range(simulator.get_num_agents(), size):
            simulator.add_agent((0.0, 0.0))
        for k in range(size, self._present):
            self._tell(k, FAR_M + APART_M * k, FAR_M, 0.0, 0.0, 0.0, 0.0, 0.0)
        self._present = size
        for k, row in enumerate(state.tolist()):
            self._tell(k, *row)
        for _ in range(self.steps):
            simulator.do_step()
        there = [simulator.get_agent_position(k).to_tuple() for k in range(size)]
        return np.array(there) - state[:, :2]

    def _tell(
        self, k: int, x: float, y: float, vx: float, vy: float, px: float, py: float, fastest: float
    ) -> None:
        self.simulator.set_agent_position(k, (x, y))
        self.simulator.set_agent_velocity(k, (vx, vy))
        self.simulator.set_agent_pref_velocity(k, (px, py))
        self.simulator.set_agent_max_speed(k, fastest)
