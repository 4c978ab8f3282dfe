"""A crowd in RVO2, to check the adapter with ORCA.

The parameters are those of `crowdbench.baselines.orca`. That policy gives the library everyone's
state in each frame; here the library keeps it from frame to frame, as other simulators do.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float
from pyrvo import RVOSimulator
from shapely import LinearRing

import crowdbench.baselines.orca as orca
from crowdbench.scene import Scene

from .adapter import Crowd, Newcomer, PeerPolicy, steps_of

FAR_M = 1000.0
"""Where people are put who have left: RVO2 cannot remove anybody."""


class RVOCrowd:
    """One world in RVO2."""

    def __init__(self, scene: Scene) -> None:
        self._steps = steps_of(scene.dt_s, orca.SUBSTEP_S)
        self._fastest = scene.motion.max_speed_mps
        self._frame_s = scene.dt_s
        self._simulator = RVOSimulator(
            scene.dt_s / self._steps,
            orca.NEIGHBOUR_RANGE_M,
            orca.NEIGHBOURS,
            orca.HORIZON_S,
            orca.WALL_HORIZON_S,
            orca.BODY_M,
            0.0,
        )
        for wall in scene.walls:
            corners = wall.corners_m
            self._simulator.add_obstacle(corners if LinearRing(corners).is_ccw else corners[::-1])
        self._simulator.process_obstacles()
        self._agents: dict[int, int] = {}
        self._unused: list[int] = []
        self._preferred: dict[int, float] = {}

    def enter(self, newcomer: Newcomer) -> Literal["entered", "moved", "refused"]:
        """Take a person in; nobody is refused."""
        if not self._unused:
            self._unused.append(self._simulator.add_agent((0.0, 0.0)))
        agent = self._unused.pop()
        self._agents[newcomer.person] = agent
        self._preferred[newcomer.person] = newcomer.speed_mps
        self._simulator.set_agent_position(agent, newcomer.position)
        self._simulator.set_agent_velocity(agent, newcomer.velocity)
        return "entered"

    def leave(self, person: int) -> None:
        """Take a person out."""
        agent = self._agents.pop(person)
        del self._preferred[person]
        self._simulator.set_agent_position(agent, (FAR_M + 10.0 * agent, FAR_M))
        self._simulator.set_agent_velocity(agent, (0.0, 0.0))
        self._simulator.set_agent_pref_velocity(agent, (0.0, 0.0))
        self._unused.append(agent)

    def steer(
        self,
        persons: Sequence[int],
        target: Float[np.ndarray, "n 2"],
        speed_mps: Float[np.ndarray, " n"],
    ) -> None:
        """Set preferred velocities, with the nudges of `crowdbench.baselines.orca`."""
        way = target - self.positions(persons)
        distance = np.linalg.norm(way, axis=1)
        speed = np.minimum(speed_mps, distance / self._frame_s)
        scale = np.divide(speed, distance, out=np.zeros_like(speed), where=distance > 0)
        angle = orca.GOLDEN_ANGLE * np.asarray(persons)
        nudge = orca.NUDGE_MPS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
        wanted = way * scale[:, None] + nudge
        for person, to in zip(persons, wanted.tolist(), strict=True):
            agent = self._agents[person]
            self._simulator.set_agent_pref_velocity(agent, tuple(to))
            most = min(orca.FASTEST * self._preferred[person], self._fastest)
            self._simulator.set_agent_max_speed(agent, most)

    def advance(self) -> Sequence[int]:
        """Simulate a frame."""
        for _ in range(self._steps):
            self._simulator.do_step()
        return ()

    def positions(self, persons: Sequence[int]) -> Float[np.ndarray, "n 2"]:
        """Where people are."""
        position = self._simulator.get_agent_position
        return np.array([position(self._agents[person]).to_tuple() for person in persons])


class ORCA(PeerPolicy):
    """`crowdbench.baselines.orca`, through the adapter."""

    name = "orca-peer"

    def crowd(self, scene: Scene) -> Crowd:
        """An empty crowd."""
        return RVOCrowd(scene)
