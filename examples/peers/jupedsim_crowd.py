"""A crowd in JuPedSim.

People are steered to the next corner on their way (JuPedSim's *direct steering*), so all models
have the same routes as the policies of crowdbench, and each is compared as what moves people. A
model has its published parameters, unless others are given.
"""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import fields
from typing import Literal

import jupedsim as jps
import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.scene import Scene
from crowdbench.spawn.export import walkable_area

from .adapter import Newcomer, steps_of

LONGEST_STEP_S = 0.01
"""Longest step: JuPedSim recommends this one."""
SLACK_M = 0.01
"""Distance to walls beyond the radius, at which people can enter."""
FARTHEST_M = 1.0
"""How far from its start a person may enter."""
_ANGLES = np.arange(8) * np.pi / 4
_RINGS = np.concatenate(
    [r * np.stack([np.cos(_ANGLES), np.sin(_ANGLES)], 1) for r in (0.1, 0.2, 0.3, 0.4, 0.5)]
)
"""Places beside others, from near to far."""


class JuPedSimCrowd:
    """One world in JuPedSim."""

    def __init__(
        self,
        scene: Scene,
        model: type,
        agent: type,
        parameters: Mapping[str, float],
        longest_step_s: float = LONGEST_STEP_S,
    ) -> None:
        of_model = {f.name for f in fields(model)}
        self._of_agent = {k: v for k, v in parameters.items() if k not in of_model}
        self._agent = agent
        self._steps = steps_of(scene.dt_s, longest_step_s)
        self._area = walkable_area(scene)
        self._simulation = jps.Simulation(
            model=model(**{k: v for k, v in parameters.items() if k in of_model}),
            geometry=self._area,
            dt=scene.dt_s / self._steps,
        )
        stage = self._simulation.add_direct_steering_stage()
        journey = self._simulation.add_journey(jps.JourneyDescription([stage]))
        self._way = {"journey_id": journey, "stage_id": stage}
        self._known = {f.name for f in fields(agent)}
        radius_m = getattr(agent(**self._of_agent), "radius", None)
        if radius_m is None:  # an ellipse
            radius_m = agent(**self._of_agent).b_max
        self._room = self._area.buffer(-radius_m - SLACK_M)
        self._free = self._area.buffer(-SLACK_M)
        for area in (self._room, self._area, self._free):
            shapely.prepare(area)
        self._ids: dict[int, int] = {}
        self._leaving = False
        self._taken = 0
        """Number of the frame's steps that are taken already."""

    def enter(self, newcomer: Newcomer) -> Literal["entered", "moved", "refused"]:
        """Take a person in, or at the nearest place with room for it beside walls.

        Who has waited long enough may enter beside others, too.
        """
        self._clear()
        start = np.asarray(newcomer.position)
        nearest = shapely.get_coordinates(shapely.shortest_line(self._room, shapely.Point(start)))
        places = [start] if shapely.contains_xy(self._free, *start) else []
        if not self._room.covers(shapely.Point(start)):
            places.append(nearest[0])
        if newcomer.beside:
            around = nearest[0] + _RINGS
            places += list(around[shapely.contains_xy(self._room, *around.T)])
        for place in places:
            if math.dist(place, start) <= FARTHEST_M and self._added(newcomer, place):
                return "entered" if math.dist(place, start) < SLACK_M else "moved"
        return "refused"

    def _added(self, newcomer: Newcomer, place: Float[np.ndarray, " 2"]) -> bool:
        way = np.subtract(newcomer.target, place)
        length, going = float(np.hypot(*way)), float(np.hypot(*newcomer.velocity))
        ahead = tuple((way / length).tolist()) if length > 0 else (1.0, 0.0)
        # Those who stand face their target.
        heading = tuple(np.divide(newcomer.velocity, going).tolist()) if going > 0.1 else ahead
        more = {
            "velocity": newcomer.velocity,
            "speed": going,
            "orientation": heading,
            "desired_direction": ahead,
            "desired_speed": newcomer.speed_mps,
        }
        try:
            number = self._simulation.add_agent(
                self._agent(
                    position=tuple(map(float, place)),
                    **self._way,
                    **{name: value for name, value in more.items() if name in self._known},
                    **self._of_agent,
                )
            )
        except RuntimeError as error:
            if "too close" not in str(error):  # to people or walls
                raise
            return False
        self._ids[newcomer.person] = number
        return True

    def leave(self, person: int) -> None:
        """Take a person out. It stands there until the next step, see `_clear`."""
        self._leaving = True
        self._simulation.mark_agent_for_removal(self._ids.pop(person))

    def steer(
        self,
        persons: Sequence[int],
        target: Float[np.ndarray, "n 2"],
        speed_mps: Float[np.ndarray, " n"],
    ) -> None:
        """Set the targets and the desired speeds. JuPedSim allows no target inside a wall."""
        lost = np.flatnonzero(~shapely.contains_xy(self._free, *target.T))
        if len(lost):
            ways = shapely.shortest_line(self._free, shapely.points(target[lost]))
            target = target.copy()
            target[lost] = shapely.get_coordinates(ways)[::2]
        for person, to, speed in zip(persons, target.tolist(), speed_mps.tolist(), strict=True):
            agent = self._simulation.agent(self._ids[person])
            agent.target = (to[0], to[1])
            agent.model.desired_speed = speed

    def advance(self) -> Sequence[int]:
        """Simulate a frame. Those who leave the walkable area escape."""
        escaped: list[int] = []
        for _ in range(self._steps - self._taken):
            escaped += self._iterate()
        self._taken = 0
        return [*escaped, *self._take_out(self._lost())]

    def _clear(self) -> None:
        """Take one of the frame's steps if somebody has left, who would stand in the way."""
        if self._leaving:
            self._leaving = False
            with suppress(RuntimeError):  # somebody has left the walkable area: see `advance`
                self._simulation.iterate()
                self._taken += 1

    def _take_out(self, lost: Sequence[int]) -> Sequence[int]:
        for person in lost:
            self.leave(person)
        return lost

    def _iterate(self) -> list[int]:
        escaped: list[int] = []
        while True:
            try:
                self._simulation.iterate()
                self._leaving = False
                return escaped
            except RuntimeError:
                lost = self._lost()
                if not lost:
                    raise
                escaped += self._take_out(lost)

    def positions(self, persons: Sequence[int]) -> Float[np.ndarray, "n 2"]:
        """Where people are."""
        # What `agent` returns is no longer valid when people have entered or left.
        agent, ids = self._simulation.agent, self._ids
        return np.array([agent(ids[person]).position for person in persons])

    def _lost(self) -> list[int]:
        """Those who are outside the walkable area, or nowhere."""
        persons = list(self._ids)
        if not persons:
            return []
        at = self.positions(persons)
        inside = np.isfinite(at).all(axis=1)
        inside[inside] = shapely.contains_xy(self._area, *at[inside].T)
        return [person for person, known in zip(persons, inside, strict=True) if not known]
