"""Arrivals as JSON, for other simulators."""

import json
from pathlib import Path

import numpy as np
import pytest
import shapely
from worlds import Person, box, events, square

from crowdbench.cli import main
from crowdbench.errors import OutputError
from crowdbench.scene import list_scenes, load_scene
from crowdbench.spawn.export import BEYOND_M, walkable_area, write_arrivals


def test_everyone_is_in_the_file_with_what_they_plan(tmp_path: Path) -> None:
    scene = square(5.0, box(-1, -1, 1, 1))
    people = (
        Person(start=(-4, 0), goal=(4, 0.5), speed=1.25, group=2),
        Person(time_s=0.8, start=(-4, 1), goal=(4, 1), group=2, via=(0, 3), wait_s=2.5),
        Person(time_s=2.0, start=(0, 4), goal=(0, -4), leave_frame=10),
    )
    path = tmp_path / "arrivals.json"
    write_arrivals(events(*people), scene, path, frames=50)
    told = json.loads(path.read_text())
    assert (told["dt_s"], told["frames"], told["goal_radius_m"]) == (0.4, 50, 0.3)
    first, second, third = told["persons"]
    assert first == {
        "id": 0,
        "time_s": 0.0,
        "start": [-4.0, 0.0],
        "goal": [4.0, 0.5],
        "speed_mps": 1.25,
        "companions": [1],
        "via": None,
        "wait_s": 0.0,
        "until_s": None,
    }
    assert (second["companions"], second["via"], second["wait_s"]) == ([0], [0.0, 3.0], 2.5)
    assert (third["companions"], third["until_s"]) == ([], 4.0)
    area = shapely.from_wkt(told["walkable_area"])
    assert area.bounds == (-5 - BEYOND_M, -5 - BEYOND_M, 5 + BEYOND_M, 5 + BEYOND_M)
    assert not area.contains(shapely.Point(0, 0))


def test_of_an_area_that_walls_cut_apart_the_part_of_the_scene_is_taken() -> None:
    ring = (box(-6, -6, 6, -5), box(-6, 5, 6, 6), box(-6, -6, -5, 6), box(5, -6, 6, 6))
    area = walkable_area(square(5.0, *ring))
    assert area.bounds == (-5, -5, 5, 5)


@pytest.mark.parametrize("scene", list_scenes())
def test_people_walk_in_the_area_of_each_scene(scene: str) -> None:
    place, rng = load_scene(scene), np.random.default_rng(0)
    b = place.bounds
    points = rng.uniform((b.x_min_m, b.y_min_m), (b.x_max_m, b.y_max_m), (500, 2))
    inside = shapely.contains_xy(walkable_area(place), *points.T)
    assert (inside <= place.walkable(points)).all()
    assert inside.sum() > 0.9 * place.walkable(points).sum()


def test_another_ending_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        OutputError, match=r"got a file \.xlsx; expected \.csv, \.parquet or \.json"
    ):
        write_arrivals(events(Person()), square(), tmp_path / "arrivals.xlsx", frames=5)
    assert not list(tmp_path.iterdir())


def test_the_commands_write_json(tmp_path: Path) -> None:
    for k, arguments in enumerate(
        (["data", "arrivals", "plaza-v0"], ["spawn", "sample", "plaza-v0", "--horizon-s", "100"])
    ):
        path = tmp_path / f"{k}.json"
        assert main([*arguments, "--out", str(path)]) == 0
        told = json.loads(path.read_text())
        assert told["scene"] == "plaza-v0"
        assert told["frames"] == (4500, 250)[k]
        assert [p["id"] for p in told["persons"]] == list(range(len(told["persons"])))
