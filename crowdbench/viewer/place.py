"""The static parts of a scene: walls, bounds, spawn areas and goal areas."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from crowdbench.colours import goal_colour
from crowdbench.errors import WeightsError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, read_areas

if TYPE_CHECKING:
    from rerun import RecordingStream

WORLD = "world"
"""The entity below which all coordinates are in metres, with x to the right and y up."""
UNKNOWN = 2**16 - 1
"""Class of people with an unknown goal area."""
GREY = "#9A9A9A"
_DIM = "#5A5A5A"
_HATCHES, _DASHES = 50, 80  # number across a scene
_LEAST_DASHES = 8
_DRAW_ORDER = -1.0  # below people


def areas_of(scene: Scene) -> Areas | None:
    """The scene's areas; None if they have not been fitted."""
    try:
        return read_areas(scene)
    except WeightsError:
        return None


def log_place(stream: "RecordingStream", scene: Scene) -> None:
    """Log the scene's walls, bounds and areas, and the colours and labels of goal areas."""
    import rerun as rr

    # rerun's 2D views always have y pointing downwards. A single flip at the root keeps all logged
    # coordinates, and those shown at the cursor, in metres.
    stream.log(WORLD, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    areas = areas_of(scene)
    spawns = dashed_areas(scene, areas) if areas else []
    goals = [areas.goal.outline(k) for k in range(len(areas.goal))] if areas else []
    classes = [(UNKNOWN, "goal area unknown", rgb(GREY))]
    classes += [(k, f"to goal area {k}", rgb(goal_colour(k))) for k in range(len(goals))]
    stream.log("/", rr.AnnotationContext(classes), static=True)

    def lines(name: str, strips: Sequence[np.ndarray], width: float, *colours: str) -> None:
        drawn = rr.LineStrips2D(
            list(strips),
            # In screen points, so that line widths do not depend on the size of the scene.
            radii=rr.Radius.ui_points(width / 2),
            colors=[rgb(c) for c in colours],
            draw_order=_DRAW_ORDER,
        )
        stream.log(f"{WORLD}/place/{name}", drawn, static=True)

    lines("bounds", [_closed(corners(scene))], 1.0, _DIM)
    lines("walls", [_closed(wall.corners_m) for wall in scene.walls], 1.5, GREY)
    lines("walls/hatching", hatching(scene), 1.0, _DIM)
    lines("spawn_areas", spawns, 1.0, "#CCCCCC")
    lines("goal_areas", goals, 2.0, *map(goal_colour, range(len(goals))))


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
    import shapely

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


def _closed(polygon: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.array([*polygon, polygon[0]])
