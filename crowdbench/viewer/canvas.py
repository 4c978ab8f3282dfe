"""The empty picture of a scene, and pens that draw on copies of it."""

from typing import Any

import numpy as np
from jaxtyping import UInt8
from PIL import Image, ImageDraw, ImageFont

from crowdbench.colours import goal_colour
from crowdbench.registry.map_images import WHITE, MapImage, map_of
from crowdbench.scene import Scene
from crowdbench.viewer.place import areas_of, corners, dashed_areas, extent_m

LONGEST_PX = 640
FINER = 2
"""Drawn larger by this factor and then reduced, as PIL does not smooth edges."""
INK = "#222222"
_MARGIN_PX = 12
_WALL, _BOUNDS, _SPAWN = "#BBBBBB", "#888888", "#666666"


class Canvas:
    """A scene from above: walls, bounds and areas on white or its map, x to the right and y up."""

    def __init__(self, scene: Scene, *, with_areas: bool = True) -> None:
        b = scene.bounds
        extent = np.array([b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m])
        self.per_m = FINER * (LONGEST_PX - 2 * _MARGIN_PX) / extent_m(scene)
        """Pixels per metre before the picture is reduced."""
        self.corner = np.array([b.x_min_m, b.y_max_m])
        self.font = ImageFont.load_default(13 * FINER)
        size = extent * self.per_m / FINER + 2 * _MARGIN_PX
        even = 2 * np.round(size / 2).astype(np.int64) * FINER  # even, as video formats require
        self.empty = Image.new("RGB", tuple(even.tolist()), "white")
        pen = Pen(self, self.empty)
        image = map_of(scene)
        if image is not None:
            pen.image(image)
        for wall in scene.walls:
            pen.area(np.array(wall.corners_m), _WALL)
        pen.line(np.array([*corners(scene), corners(scene)[0]]), _BOUNDS, FINER)
        areas = areas_of(scene) if with_areas else None
        if areas is not None:
            for dash in dashed_areas(scene, areas):
                pen.line(dash, _SPAWN, FINER)
            for k in range(len(areas.goal)):
                pen.line(areas.goal.outline(k), goal_colour(k), 2 * FINER)

    def pen(self) -> "Pen":
        """A pen on a new copy."""
        return Pen(self, self.empty.copy())


class Pen:
    """Draws in metres. Radii and widths are in pixels before the picture is reduced."""

    def __init__(self, canvas: Canvas, image: Image.Image) -> None:
        self._canvas, self._image = canvas, image
        self._ink = ImageDraw.Draw(image)

    def line(self, xy: np.ndarray, colour: str, width: int) -> None:
        """A line along points (n, 2)."""
        self._ink.line(self._pixels(xy), fill=colour, width=width)

    def area(self, xy: np.ndarray, colour: str) -> None:
        """A polygon with corners (n, 2)."""
        self._ink.polygon(self._pixels(xy), fill=colour)

    def image(self, image: MapImage) -> None:
        """An image of the floor."""
        b = image.bounds
        (x, y), end = self._pixels(np.array([[b.x_min_m, b.y_max_m], [b.x_max_m, b.y_min_m]]))
        size = round(end[0] - x), round(end[1] - y)
        self._image.paste(Image.fromarray(image.on(WHITE)).resize(size), (round(x), round(y)))

    def disc(self, xy: np.ndarray, radius: float, colour: str | None, **outline: Any) -> None:
        """A disc around a point (2,); `outline` are `outline` and `width` of PIL's ellipse."""
        ((x, y),) = self._pixels(xy[None])
        box = (x - radius, y - radius, x + radius, y + radius)
        self._ink.ellipse(box, fill=colour, **outline)

    def label(self, seconds: float, persons: int | None) -> None:
        """The time and the number of people, None if nobody counted them."""
        text = f"{persons} {'person' if persons == 1 else 'persons'}"
        text = f"{seconds:.1f} s, {'not observed' if persons is None else text}"
        where = (_MARGIN_PX + 6) * FINER
        self._ink.text((where, where), text, fill=INK, font=self._canvas.font,
                       stroke_width=2 * FINER, stroke_fill="white")  # fmt: skip

    def picture(self) -> UInt8[np.ndarray, "h w 3"]:
        """What was drawn: height × width × (red, green, blue), from 0 to 255."""
        return np.array(self._image.reduce(FINER))

    def _pixels(self, xy: np.ndarray) -> list[tuple[float, float]]:
        """Positions in metres converted to pixels, with y pointing downwards."""
        of = self._canvas
        at = (xy - of.corner) * [of.per_m, -of.per_m] + _MARGIN_PX * FINER
        return [(x, y) for x, y in at.tolist()]
