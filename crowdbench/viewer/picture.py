"""A frame of a crowd: people, trails and ended trips; and pictures of it.

A picture is one array of pixels per frame, fast enough for a video.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8

from crowdbench.colours import goal_colour
from crowdbench.data.table import Indices, Points, Trajectories
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.viewer.canvas import FINER, INK, Canvas
from crowdbench.viewer.place import GREY

TRAIL_S = 2.0
"""Length of a trail, seconds."""
Past = Sequence[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]
"""Ids and positions of the people present, frame by frame; the present frame is the last."""


@dataclass(frozen=True, eq=False)
class Now:
    """`n` persons of a world, including those whose trips have just ended."""

    frame: int
    person_id: Int[np.ndarray, " n"]
    goal_area: Int[np.ndarray, " n"]
    group: Int[np.ndarray, " n"]
    """Group of each person, −1 for people who are alone."""
    xy: Float32[np.ndarray, "n 2"]
    """Positions, metres."""
    target: Float32[np.ndarray, "n 2"]
    """Where each person walks to now, its via point or its goal, metres."""
    trail: Float32[np.ndarray, "n k 2"]
    """Positions in the last frames, metres; the present frame is the last. Frames before a
    person's first one have the person's first position."""
    born: Int[np.ndarray, " n"]
    """Frame in which each person entered."""
    spawned: Bool[np.ndarray, " n"]
    """Whether each person entered in this frame."""
    ended: Int[np.ndarray, " n"]
    """Outcome of trips that ended in this frame, as an index into `OUTCOMES`; 0 for others."""

    @classmethod
    def of(cls, simulation: Simulation, past: Past) -> "Now":
        """Read the present state of a simulation's first world, without changing it."""
        slots = simulation.slots
        there = (slots.alive[0] | (slots.ended[0] != 0)).nonzero()[0]
        person, xy = slots.person[0, there], slots.position[0, there]
        return cls(
            frame=int(simulation.clock.frame[0]),
            person_id=person,
            goal_area=simulation.events[0].goal_area[slots.event[0, there]],
            group=simulation.events[0].group[slots.event[0, there]],
            xy=xy,
            target=slots.target[0, there],
            trail=_trails(person, xy, past),
            born=slots.born[0, there],
            spawned=slots.spawned[0, there],
            ended=slots.ended[0, there],
        )


def trail_steps(dt_s: float) -> int:
    """Length of a trail in steps."""
    return max(1, round(TRAIL_S / dt_s))


def trails(crowd: Trajectories, rows: Indices, first_row: Indices) -> Float32[np.ndarray, "n k 2"]:
    """Positions in the last `TRAIL_S` seconds up to each row of a table, metres.

    Times before a person's first row have the position of the first row.
    """
    back = np.arange(trail_steps(crowd.dt_s), -1, -1)
    return crowd.xy[np.maximum(rows[:, None] - back, first_row[:, None])]


def _trails(person: Indices, xy: Points, past: Past) -> Float32[np.ndarray, "n k 2"]:
    trail = np.repeat(xy[:, None], max(1, len(past)), axis=1)
    for k in range(len(past) - 2, -1, -1):  # backwards, to repeat first positions
        ids, there = past[k]
        _, mine, its = np.intersect1d(person, ids, assume_unique=True, return_indices=True)
        trail[:, k] = trail[:, k + 1]
        trail[mine, k] = there[its]
    return trail


class Pictures:
    """Draws a scene's people from above on white, with x to the right and y up.

    With `areas`, it also draws the scene's areas, and where each person walks to.
    """

    def __init__(self, scene: Scene, *, areas: bool = True) -> None:
        self._scene, self._canvas = scene, Canvas(scene, with_areas=areas)
        self._areas = areas

    def draw(
        self, now: Now, ringed: Sequence[int] = (), *, observed: bool = True
    ) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame: height × width × (red, green, blue), from 0 to 255.

        People with the ids `ringed` have a black ring. A frame that was not `observed` says so.
        """
        pen = self._canvas.pen()
        colours = [GREY if k < 0 else goal_colour(k) for k in now.goal_area.tolist()]
        radius = max(self._scene.motion.person_radius_m * self._canvas.per_m, 2.0 * FINER)
        for trail, goal, colour in zip(now.trail, now.target, colours, strict=True):
            pen.line(trail, colour, max(FINER, round(radius / 3)))
            if self._areas:
                pen.disc(goal, 1.5 * FINER, colour)
        for k in range(len(now.xy)):  # companions are linked
            for other in np.flatnonzero((now.group == now.group[k]) & (now.group >= 0)).tolist():
                if other > k:
                    pen.line(now.xy[[k, other]], INK, FINER)
        for xy, colour in zip(now.xy, colours, strict=True):
            pen.disc(xy, radius, colour)
        for xy in now.xy[np.isin(now.person_id, ringed)]:
            pen.disc(xy, radius + 3 * FINER, None, outline=INK, width=2 * FINER)
        alive = int((now.ended == 0).sum())
        pen.label(now.frame * self._scene.dt_s, alive if observed else None)
        return pen.picture()
