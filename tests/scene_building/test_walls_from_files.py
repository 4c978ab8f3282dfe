"""Walls from files of polygons."""

import json
from pathlib import Path

import pytest
import shapely

from crowdbench.errors import SceneError
from crowdbench.scene import Bounds
from crowdbench.scene_building.walls import read_walls

BOUNDS = Bounds(0.0, 10.0, 0.0, 10.0)
SQUARE = [[1, 1], [3, 1], [3, 3], [1, 3], [1, 1]]
RING = "POLYGON ((1 1, 9 1, 9 9, 1 9, 1 1), (2 2, 8 2, 8 4, 2 4, 2 2), (2 5, 8 5, 8 8, 2 8, 2 5))"


def polygon(corners: list[list[float]] = SQUARE) -> dict[str, object]:
    return {"type": "Polygon", "coordinates": [corners]}


def feature(name: str | None) -> dict[str, object]:
    return {"type": "Feature", "properties": {"name": name}, "geometry": polygon()}


def written(folder: Path, content: object) -> Path:
    path = folder / "walls.file"
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def area(*polygons: tuple[tuple[float, float], ...]) -> float:
    return float(shapely.union_all([shapely.Polygon(corners) for corners in polygons]).area)


@pytest.mark.parametrize(
    ("content", "names"),
    [
        (polygon(), ["wall 1"]),
        (feature("kiosk"), ["kiosk"]),
        ({"type": "Feature", "properties": None, "geometry": polygon()}, ["wall 1"]),
        (
            {"type": "FeatureCollection", "features": [feature("kiosk"), feature(None)]},
            ["kiosk", "wall 2"],
        ),
        (
            {"type": "GeometryCollection", "geometries": [polygon(), polygon()]},
            ["wall 1", "wall 2"],
        ),
        ({"type": "MultiPolygon", "coordinates": [[SQUARE]]}, ["wall 1"]),
        ("POLYGON ((1 1, 3 1, 3 3, 1 3, 1 1))", ["wall 1"]),
        ("POLYGON Z ((1 1 5, 3 1 5, 3 3 5, 1 3 5, 1 1 5))", ["wall 1"]),
    ],
)
def test_polygons_are_walls_by_their_names(
    tmp_path: Path, content: object, names: list[str]
) -> None:
    walls = read_walls(written(tmp_path, content), BOUNDS)
    assert [wall.name for wall in walls] == names
    assert area(*[wall.corners_m for wall in walls]) == pytest.approx(4.0)
    assert all(len(set(wall.corners_m)) == len(wall.corners_m) == 4 for wall in walls)


def test_what_lies_outside_the_bounds_is_cut_off(tmp_path: Path) -> None:
    wall = "MULTIPOLYGON (((-5 4, 20 4, 20 6, -5 6, -5 4)), ((50 50, 60 50, 60 60, 50 50)))"
    (found,) = read_walls(written(tmp_path, wall), BOUNDS)
    assert shapely.Polygon(found.corners_m).bounds == (0, 4, 10, 6)


def test_holes_stay_free(tmp_path: Path) -> None:
    walls = read_walls(written(tmp_path, RING), BOUNDS)
    whole = shapely.union_all([shapely.Polygon(wall.corners_m) for wall in walls])
    assert shapely.symmetric_difference(whole, shapely.from_wkt(RING)).area < 1e-9
    assert {wall.name for wall in walls} == {"wall 1"}


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ("LINESTRING (0 0, 5 5)", r"got a LineString; expected polygons.*line.buffer\(0.1\)"),
        ({"type": "Point", "coordinates": [1, 1]}, "got a Point"),
        ("POLYGON ((0 0, 4 4, 4 0, 0 4, 0 0))", "do not cross themselves.*make_valid"),
        ("POLYGON ((8.54 47.3, 8.55 47.3, 8.55 47.4, 8.54 47.3))", r"walls at \(8.54, 47.3, 8.55"),
        ("POLYGON EMPTY", "got no wall.*Use a file of polygons"),
        ("a wall", "expected GeoJSON or WKT.*Use a file of polygons"),
        ("{", "expected valid GeoJSON"),
        ({"type": "FeatureCollection"}, "an invalid FeatureCollection"),
        ({"type": "Feature", "geometry": None}, "an invalid object"),
        ({"type": "Polygon", "coordinates": [[1, 2]]}, "an invalid Polygon"),
        ({"walls": []}, "an invalid object without a type.*Use a file of polygons"),
    ],
)
def test_what_is_no_wall_is_refused(tmp_path: Path, content: object, message: str) -> None:
    with pytest.raises(SceneError, match=message):
        read_walls(written(tmp_path, content), BOUNDS)


def test_a_file_that_is_missing_is_told(tmp_path: Path) -> None:
    with pytest.raises(SceneError, match=r"no such file.*Use a file of polygons"):
        read_walls(tmp_path / "nowhere.geojson", BOUNDS)
