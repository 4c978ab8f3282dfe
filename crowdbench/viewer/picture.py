"""An environment as pictures: one array of pixels per frame, fast enough for a video."""

from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import UInt8

from crowdbench.colours import goal_colour
from crowdbench.scene import Scene
from crowdbench.viewer.now import Now
from crowdbench.viewer.place import GREY, areas_of, corners, dashed_areas, extent_m

if TYPE_CHECKING:
    from PIL.ImageDraw import ImageDraw

LONGEST_PX = 640
_FINER = 2  # drawn larger by this factor and then reduced, as PIL does not smooth edges
_MARGIN_PX = 12
_WALL, _BOUNDS, _SPAWN, _INK = "#BBBBBB", "#888888", "#666666", "#222222"


class Pictures:
    """Draws a scene's people from above on white, with x to the right and y up."""

    def __init__(self, scene: Scene) -> None:
        from PIL import Image, ImageDraw, ImageFont

        b = scene.bounds
        extent = np.array([b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m])
        self._per_m = _FINER * (LONGEST_PX - 2 * _MARGIN_PX) / extent_m(scene)
        self._corner = np.array([b.x_min_m, b.y_max_m])
        self._scene = scene
        self._font = ImageFont.load_default(13 * _FINER)
        size = extent * self._per_m / _FINER + 2 * _MARGIN_PX
        even = 2 * np.round(size / 2).astype(np.int64) * _FINER  # even, as video formats require
        self._empty = Image.new("RGB", tuple(even.tolist()), "white")
        self._draw_place(ImageDraw.Draw(self._empty))

    def draw(self, now: Now) -> UInt8[np.ndarray, "h w 3"]:
        """The picture of a frame: height × width × (red, green, blue), from 0 to 255."""
        from PIL import ImageDraw

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
        seconds = now.frame * self._scene.dt_s
        alive = int((now.ended == 0).sum())
        text = f"{seconds:.1f} s, {alive} {'person' if alive == 1 else 'persons'}"
        where = (_MARGIN_PX + 6) * _FINER
        ink.text((where, where), text, fill=_INK, font=self._font,
                 stroke_width=2 * _FINER, stroke_fill="white")  # fmt: skip
        return np.array(image.reduce(_FINER))

    def _draw_place(self, ink: "ImageDraw") -> None:
        for wall in self._scene.walls:
            ink.polygon(self._pixels(np.array(wall.corners_m)), fill=_WALL)
        bounds = self._pixels(np.array([*corners(self._scene), corners(self._scene)[0]]))
        ink.line(bounds, fill=_BOUNDS, width=_FINER)
        areas = areas_of(self._scene)
        if areas is None:
            return
        for dash in dashed_areas(self._scene, areas):
            ink.line(self._pixels(dash), fill=_SPAWN, width=_FINER)
        for k in range(len(areas.goal)):
            line = self._pixels(areas.goal.outline(k))
            ink.line(line, fill=goal_colour(k), width=2 * _FINER)

    def _pixels(self, xy: np.ndarray) -> list[tuple[float, float]]:
        """Positions in metres converted to pixels, with y pointing downwards."""
        at = (xy - self._corner) * [self._per_m, -self._per_m] + _MARGIN_PX * _FINER
        return [(x, y) for x, y in at.tolist()]

    def _disc(self, ink: "ImageDraw", xy: np.ndarray, radius: float, colour: str) -> None:
        ((x, y),) = self._pixels(xy[None])
        ink.ellipse((x - radius, y - radius, x + radius, y + radius), fill=colour)
