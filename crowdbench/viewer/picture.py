"""A frame of a crowd: people, trails and ended trips; and pictures of it.

A picture is one array of pixels per frame, fast enough for a video.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8
from PIL import Image, ImageDraw, ImageFont

from crowdbench.colours import goal_colour
from crowdbench.data.table import Indices, Points, Trajectories
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.viewer.place import GREY, areas_of, corners, dashed_areas, extent_m

TRAIL_S = 2.0
"""Length of a trail, seconds."""
Past = Sequence[tuple[Int[np.ndarray, " _"], Float32[np.ndarray, "_ 2"]]]
"""Ids and positions of the people present, frame by frame; the present frame is the last."""
LONGEST_PX = 640
_FINER = 2  # drawn larger by this factor and then reduced, as PIL does not smooth edges
_MARGIN_PX = 12
_WALL, _BOUNDS, _SPAWN, _INK = "#BBBBBB", "#888888", "#666666", "#222222"


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
    """Draws a scene's people from above on white, with x to the right and y up."""

    def __init__(self, scene: Scene) -> None:
        b = scene.bounds
        extent = np.array([b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m])
        self._per_m = _FINER * (LONGEST_PX - 2 * _MARGIN_PX) / extent_m(scene)
        self._corner = np.array([b.x_min_m, b.y_max_m])
        self._scene = scene
        self._font = ImageFont.load_default(13 * _FINER)
        size = extent * self._per_m / _FINER + 2 * _MARGIN_PX
        even = 2 * np.round(size / 2).astype(np.int64) * _FINER  # even, as video formats require
        self._empty = Image.new("RGB", tuple(even.tolist()), "white")
        ink = ImageDraw.Draw(self._empty)
        for wall in scene.walls:
            ink.polygon(self._pixels(np.array(wall.corners_m)), fill=_WALL)
        bounds = self._pixels(np.array([*corners(scene), corners(scene)[0]]))
        ink.line(bounds, fill=_BOUNDS, width=_FINER)
        areas = areas_of(scene)
        if areas is not None:
            for dash in dashed_areas(scene, areas):
                ink.line(self._pixels(dash), fill=_SPAWN, width=_FINER)
            for k in range(len(areas.goal)):
                line = self._pixels(areas.goal.outline(k))
                ink.line(line, fill=goal_colour(k), width=2 * _FINER)

    def draw(
        self, now: Now, ringed: Sequence[int] = (), *, observed: bool = True
    ) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame: height × width × (red, green, blue), from 0 to 255.

        People with the ids `ringed` have a black ring. A frame that was not `observed` says so.
        """
        image = self._empty.copy()
        ink = ImageDraw.Draw(image)
        colours = [GREY if k < 0 else goal_colour(k) for k in now.goal_area.tolist()]
        radius = max(self._scene.motion.person_radius_m * self._per_m, 2.0 * _FINER)
        for trail, goal, colour in zip(now.trail, now.target, colours, strict=True):
            ink.line(self._pixels(trail), fill=colour, width=max(_FINER, round(radius / 3)))
            self._disc(ink, goal, 1.5 * _FINER, colour)
        for k in range(len(now.xy)):  # companions are linked
            for other in np.flatnonzero((now.group == now.group[k]) & (now.group >= 0)).tolist():
                if other > k:
                    ink.line(self._pixels(now.xy[[k, other]]), fill=_INK, width=_FINER)
        for xy, colour in zip(now.xy, colours, strict=True):
            self._disc(ink, xy, radius, colour)
        for xy in now.xy[np.isin(now.person_id, ringed)]:
            self._disc(ink, xy, radius + 3 * _FINER, None, outline=_INK, width=2 * _FINER)
        seconds = now.frame * self._scene.dt_s
        alive = int((now.ended == 0).sum())
        text = f"{alive} {'person' if alive == 1 else 'persons'}" if observed else "not observed"
        text = f"{seconds:.1f} s, {text}"
        where = (_MARGIN_PX + 6) * _FINER
        ink.text((where, where), text, fill=_INK, font=self._font,
                 stroke_width=2 * _FINER, stroke_fill="white")  # fmt: skip
        return np.array(image.reduce(_FINER))

    def _pixels(self, xy: np.ndarray) -> list[tuple[float, float]]:
        """Positions in metres converted to pixels, with y pointing downwards."""
        at = (xy - self._corner) * [self._per_m, -self._per_m] + _MARGIN_PX * _FINER
        return [(x, y) for x, y in at.tolist()]

    def _disc(
        self,
        ink: ImageDraw.ImageDraw,
        xy: np.ndarray,
        radius: float,
        colour: str | None,
        **line: Any,
    ) -> None:
        ((x, y),) = self._pixels(xy[None])
        ink.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour, **line)
