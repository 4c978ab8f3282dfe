"""The static parts of a scene: walls, bounds, spawn areas and goal areas, as lines to draw."""

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.errors import WeightsError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, read_areas

WORLD = "world"
"""The entity below which all coordinates are in metres, with x to the right and y up."""
SIMULATION = "simulation"
"""The side of the viewer with the crowd that was asked for; the other is compared with it."""
UNKNOWN = 2**16 - 1
"""Class of people with an unknown goal area."""
GREY = "#9A9A9A"
_HATCHES, _DASHES = 50, 80  # number across a scene
_LEAST_DASHES = 8


def areas_of(scene: Scene) -> Areas | None:
    """The scene's areas; None if they have not been fitted."""
    try:
        return read_areas(scene)
    except WeightsError:
        return None


def rgb(colour: str) -> tuple[int, int, int]:
    """Red, green and blue (0 to 255) of a colour `#RRGGBB`."""
    red, green, blue = bytes.fromhex(colour[1:])
    return red, green, blue


def corners(scene: Scene) -> list[tuple[float, float]]:
    """The corners of the scene's bounds, metres."""
    b = scene.bounds
    return [
        (b.x_min_m, b.y_min_m),
        (b.x_max_m, b.y_min_m),
        (b.x_max_m, b.y_max_m),
        (b.x_min_m, b.y_max_m),
    ]


def hatching(scene: Scene) -> list[Float[np.ndarray, "2 2"]]:
    """Strokes at 45° that hatch the walls, because rerun draws only outlines; metres."""
    b = scene.bounds
    height = b.y_max_m - b.y_min_m
    x = np.arange(b.x_min_m - height, b.x_max_m, extent_m(scene) / _HATCHES)
    strokes = shapely.linestrings(
        [[[left, b.y_min_m], [left + height, b.y_max_m]] for left in x.tolist()]
    )
    parts = shapely.get_parts(shapely.intersection(strokes, scene.obstacles))
    strokes = parts[(shapely.get_type_id(parts) == shapely.GeometryType.LINESTRING)]
    return list(shapely.get_coordinates(strokes[~shapely.is_empty(strokes)]).reshape(-1, 2, 2))


def dashed_areas(scene: Scene, areas: Areas) -> list[Float[np.ndarray, "2 2"]]:
    """Outlines of the spawn areas as dashes, metres."""
    lines = [areas.spawn.outline(k) for k in range(len(areas.spawn))]
    return [dash for line in lines for dash in dashes(line, extent_m(scene) / _DASHES)]


def dashes(line: Float[np.ndarray, "n 2"], length_m: float) -> list[Float[np.ndarray, "2 2"]]:
    """A line as dashes of equal length, about `length_m`, with gaps of the same length."""
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1))])
    pairs = max(_LEAST_DASHES, round(along[-1] / (2 * length_m)))
    at = np.linspace(0, along[-1], 2 * pairs + 1)
    points = np.stack([np.interp(at, along, line[:, k]) for k in (0, 1)], axis=1)
    return [points[k : k + 2] for k in range(0, len(points) - 1, 2)]


def extent_m(scene: Scene) -> float:
    """The longer side of the scene's bounds, metres."""
    b = scene.bounds
    return max(b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m)
