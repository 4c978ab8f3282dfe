"""Reads walls from a file of polygons in GeoJSON or WKT, in metres, in the recording's frame."""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import shapely

from crowdbench.errors import SceneError, hinting
from crowdbench.files import read_bytes
from crowdbench.scene import Bounds, Wall

_GRID_M = 0.001  # coordinates are rounded to millimetres
_LEAST_M2 = 0.001
_HINT = "Use a file of polygons in GeoJSON or WKT, in metres and in the recording's frame."


@hinting(_HINT)
def read_walls(path: Path, bounds: Bounds) -> tuple[Wall, ...]:
    """The walls in a file, clipped to the bounds.

    The name of a wall is the property `name` of its feature. A polygon with holes is cut into
    several adjacent walls, so that the holes stay free.

    Raises:
        SceneError: the file is missing or broken, contains something other than polygons, or no
            wall lies within the bounds.
    """
    text = read_bytes(path, SceneError, _HINT).decode("utf-8-sig", "replace")
    shapes = list(_shapes(text, path))
    place = shapely.box(bounds.x_min_m, bounds.y_min_m, bounds.x_max_m, bounds.y_max_m)
    polygons = [(name, polygon) for name, shape in shapes for polygon in _polygons(shape, path)]
    walls: list[Wall] = []
    for number, (name, polygon) in enumerate(polygons, 1):
        for piece in _solid(shapely.set_precision(polygon.intersection(place), _GRID_M)):
            corners = tuple((float(x), float(y)) for x, y, *_ in piece.exterior.coords[:-1])
            walls.append(Wall(name or f"wall {number}", corners))
    if not walls:
        extent = [shape.bounds for _, shape in shapes if not shape.is_empty]
        raise SceneError(
            path,
            got=f"walls at {', '.join(_rounded(e) for e in extent[:3])}" if extent else "no wall",
            expected=f"at least one wall within the bounds {_rounded(place.bounds)} "
            "(x min, y min, x max, y max)",
        )
    return tuple(walls)


def _rounded(extent: tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{x:.6g}" for x in extent) + ")"


def _shapes(text: str, path: Path) -> Iterator[tuple[str, shapely.Geometry]]:
    is_json = text.lstrip().startswith("{")
    try:
        if is_json:
            yield from _features(json.loads(text), "", path)
        else:
            yield "", shapely.from_wkt(text)
    except (ValueError, RecursionError, shapely.errors.ShapelyError) as error:
        expected = "valid GeoJSON" if is_json else "GeoJSON or WKT"
        raise SceneError(path, got=str(error).splitlines()[0], expected=expected) from error


def _features(item: Any, name: str, path: Path) -> Iterator[tuple[str, shapely.Geometry]]:
    kind = item.get("type") if isinstance(item, dict) else None
    try:
        if kind == "FeatureCollection":
            for feature in item["features"]:
                yield from _features(feature, name, path)
        elif kind == "Feature":
            properties = item.get("properties") or {}
            yield from _features(item["geometry"], str(properties.get("name") or name), path)
        else:
            yield name, shapely.geometry.shape(item)
    except (shapely.errors.ShapelyError, KeyError, TypeError, AttributeError, IndexError) as error:
        got = f"an invalid {kind or 'object without a type'} ({error})"
        raise SceneError(path, got=got, expected="GeoJSON features with polygons") from error


def _polygons(shape: shapely.Geometry, where: object) -> Iterator[shapely.Polygon]:
    if isinstance(shape, shapely.MultiPolygon | shapely.GeometryCollection):
        for part in shape.geoms:
            yield from _polygons(part, where)
        return
    if not isinstance(shape, shapely.Polygon):
        got = f"a {shape.geom_type}"
        hint = "Convert lines to polygons first, for example with shapely's line.buffer(0.1)."
        raise SceneError(where, got=got, expected="polygons, because walls are solid", hint=hint)
    if not shape.is_valid:
        got = f"an invalid polygon ({shapely.is_valid_reason(shape)})"
        expected = "polygons that do not cross themselves"
        hint = "shapely.make_valid repairs most of them."
        raise SceneError(where, got=got, expected=expected, hint=hint)
    yield shape


def _solid(shape: shapely.Geometry) -> Iterator[shapely.Polygon]:
    """The polygons of a shape, cut in two through holes until none of them has a hole."""
    for piece in getattr(shape, "geoms", [shape]):
        if not isinstance(piece, shapely.Polygon) or piece.area < _LEAST_M2:
            continue
        if not piece.interiors:
            yield piece
            continue
        x0, y0, x1, y1 = piece.bounds
        hole = shapely.Polygon(piece.interiors[0]).bounds
        middle = (hole[0] + hole[2]) / 2
        for half in (shapely.box(x0, y0, middle, y1), shapely.box(middle, y0, x1, y1)):
            yield from _solid(shapely.set_precision(piece.intersection(half), _GRID_M))
