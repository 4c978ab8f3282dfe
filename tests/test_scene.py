from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of
from worlds import box, square

from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.errors import SceneError
from crowdbench.scene import Scene, list_scenes, load_scene, scenes_folder
from crowdbench.spawn import Replay

ETH_TOML = (scenes_folder() / "eth-v0" / "scene.toml").read_text()


@pytest.fixture
def scene() -> Scene:
    return load_scene("eth-v0")


@pytest.fixture(scope="module")
def eth(opentraj: Path) -> Trajectories:
    return read_published(SOURCES["eth"], opentraj)


def altered(folder: Path, was: str, becomes: str) -> Path:
    """A scene folder with ETH's scene.toml, one text in it replaced."""
    assert was in ETH_TOML
    (folder / "scene.toml").write_text(ETH_TOML.replace(was, becomes, 1))
    return folder


def test_a_scene_is_found_by_its_id(scene):
    assert scene.id == "eth-v0"
    assert (scene.dt_s, scene.grid_s, scene.recording.frames) == (0.4, 0.4, 1934)
    assert scene.horizon_s == pytest.approx(773.6)


def test_a_scene_is_loaded_from_any_folder(tmp_path, scene):
    copy = load_scene(altered(tmp_path, "ETH main entrance", "Elsewhere"))
    assert copy.title == "Elsewhere, Zurich"
    assert copy.folder == tmp_path
    assert copy.walls == scene.walls


def test_a_loaded_scene_is_taken_as_it_is(scene):
    assert load_scene(scene) is scene


@pytest.mark.parametrize("name", list_scenes())
def test_each_scene_that_ships_is_named_like_its_folder(name):
    assert load_scene(name).id == name


def test_whole_numbers_in_a_scene_file_are_numbers(tmp_path):
    assert load_scene(altered(tmp_path, "block_s = 60.0", "block_s = 60")).protocol.block_s == 60.0


def test_everyone_recorded_in_eth_stands_where_people_can_walk(scene, eth):
    assert scene.walkable(eth.xy.astype(np.float64)).all()


def test_no_recorded_path_of_eth_touches_a_wall(scene, eth):
    walls = shapely.union_all([shapely.Polygon(wall.corners_m) for wall in scene.walls])
    long = [p for p in range(len(eth)) if eth.last[p] > eth.first[p]]
    touching = [p for p in long if shapely.LineString(eth.path(p)).intersects(walls)]
    assert touching == []


def test_eths_recording_is_as_the_scene_file_says(scene, eth):
    assert scene.recording.frames == eth.frames
    dwell = (eth.last - eth.first)[eth.entered & eth.left] * eth.dt_s
    assert np.percentile(dwell, 99) == pytest.approx(scene.recording.dwell_p99_s, abs=0.1)


@pytest.mark.parametrize(
    ("x", "y", "inside", "walkable"),
    [
        (5.0, 5.0, True, True),
        (15.0, 2.0, True, False),
        (14.9, 5.6, True, True),
        (16.0, 5.0, False, False),
        (5.0, -6.0, False, False),
    ],
    ids=["square", "facade", "door", "behind the door", "below the bounds"],
)
def test_walls_and_bounds_of_eth_are_where_they_are(scene, x, y, inside, walkable):
    point = np.array([[x, y]])
    assert scene.inside(point).tolist() == [inside]
    assert scene.walkable(point).tolist() == [walkable]


# A box, one that touches it, one in a corner of the bounds, and a post.
WALLED = square(
    6.0, box(-2, -2, 2, 1), box(2, -2, 3, 0), box(4, 4, 7, 7), ((-4, 3), (-3.8, 4), (-4.2, 4))
)
PLACES = st.lists(
    st.tuples(st.floats(-9, 9, width=32), st.floats(-9, 9, width=32)), min_size=1, max_size=20
)


@given(PLACES)
def test_who_stands_in_a_wall_or_outside_is_moved_to_the_nearest_walkable_place(places):
    points = np.array(places, dtype=np.float64)
    given_points = points.copy()
    moved = WALLED.nearest_walkable(points)
    assert (points == given_points).all()
    stays = WALLED.walkable(points)
    assert (moved[stays] == points[stays]).all()
    # In float32 too, as simulations have it.
    assert WALLED.walkable(moved.astype(np.float32).astype(np.float64)).all()
    # No nearer place is free; a centimetre off the walls, at a corner of them more by 1.42.
    x = np.arange(-5.95, 6.0, 0.05)
    grid = np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    grid = grid[WALLED.walkable(grid)]
    for point, place in zip(points[~stays], moved[~stays], strict=True):
        nearest = np.linalg.norm(grid - point, axis=1).min()
        assert np.linalg.norm(place - point) <= nearest + 0.0142 + 1e-6


@given(PLACES)
def test_who_has_room_stands_within_the_bounds_a_persons_radius_from_walls(places):
    points = np.array(places, dtype=np.float64)
    walls = [shapely.Polygon(wall.corners_m) for wall in WALLED.walls]
    distance = np.min([shapely.distance(wall, shapely.points(points)) for wall in walls], axis=0)
    radius = WALLED.motion.person_radius_m
    clear = np.abs(distance - radius) > 1e-9
    expected = WALLED.inside(points) & (distance >= radius)
    room = WALLED.has_room(points)
    assert (room[clear] == expected[clear]).all()
    assert (room <= WALLED.walkable(points)).all()


def test_bounds_need_no_room_and_scenes_without_walls_have_it_everywhere():
    just_inside = np.array([[5.999, 0.0], [6.001, 0.0]])
    for scene in (square(6.0), WALLED):
        assert scene.has_room(just_inside).tolist() == [True, False]


def test_a_scene_without_walls_moves_only_those_outside_its_bounds():
    found = square(6.0).nearest_walkable(np.array([[1.0, 2.0], [9.0, 2.0], [9.0, -9.0]]))
    np.testing.assert_allclose(found, [[1, 2], [5.99, 2], [5.99, -5.99]], atol=1e-9)


def test_replayed_people_start_and_end_where_a_policy_can_walk():
    # From inside the box to outside the bounds; the path that `replay` walks stays as it is.
    path = np.array([[0, 0.9], [0, 3], [0, 6.5], [1, 3], [1, 4]])
    crowd = crowd_of([(1, 3), (1, 2)], frames=6, dt_s=0.4, xy=path)
    replay = Replay(crowd)
    events = replay.sample(9.0, WALLED, np.random.default_rng(0))
    np.testing.assert_allclose(events.start, [[0, 1.01], [1, 3]], atol=1e-6)
    np.testing.assert_allclose(events.goal, [[0, 5.99], [1, 4]], atol=1e-6)
    np.testing.assert_allclose(replay.scripted(events).start, crowd.start)


def test_a_scene_without_walls_is_walkable_within_its_bounds(tmp_path):
    head, tail = ETH_TOML.split("[[walls]]", 1)[0], "[motion]" + ETH_TOML.split("[motion]", 1)[1]
    (tmp_path / "scene.toml").write_text(head + tail)
    scene = load_scene(tmp_path)
    assert scene.walkable(np.array([[15.0, 2.0], [16.0, 2.0]])).tolist() == [True, False]
    assert scene.wall_segments.shape == (0, 4)


def test_wall_segments_close_each_wall(scene):
    for k, wall in enumerate(scene.walls):
        of_wall = scene.wall_segments[np.array(scene.wall_of_segment) == k]
        np.testing.assert_array_equal(of_wall[:, :2], np.array(wall.corners_m))
        np.testing.assert_array_equal(of_wall[:, 2:], np.roll(of_wall[:, :2], -1, axis=0))


@pytest.mark.parametrize(("duration_s", "frames"), [(0.4, 1), (0.5, 2), (773.6, 1934), (60.0, 150)])
def test_a_duration_fills_whole_frames(scene, duration_s, frames):
    assert scene.frames(duration_s) == frames


@pytest.mark.parametrize("name", ["nowhere-v0", "eth", "eth-v0/scene.toml"])
def test_an_unknown_scene_is_refused_with_the_known_ones(name):
    with pytest.raises(SceneError) as caught:
        load_scene(name)
    assert name in caught.value.got
    assert "eth-v0" in caught.value.expected


FIRST_WALL = next(line for line in ETH_TOML.splitlines() if line.startswith("corners_m"))
BROKEN = {
    "no toml": ('id = "eth-v0"', "id = ", "line", "valid TOML"),
    "unknown field": ("[bounds]", "[bounds]\nz_min_m = 0.0", "z_min_m", "fields"),
    "missing field": ("x_min_m = -9.0", "", "x_min_m", "fields"),
    "missing table": ("[motion]", "[spawning.motion]", "motion", "fields"),
    "wrong type": ("dt_s = 0.4", 'dt_s = "0.4"', "$.dt_s", "fields"),
    "half frames": ("frames = 1934", "frames = 1934.5", "$.recording.frames", "fields"),
    "flat corner": ("[-0.793, -0.595]", "[-0.793]", "corners_m", "fields"),
    "schema": ("schema = 1", "schema = 99", "schema = 99", "schema = 1"),
    "id": ('id = "eth-v0"', 'id = "ETH"', "id = 'ETH'", "an id like name-v0"),
    "reversed bounds": ("x_max_m = 15.5", "x_max_m = -10.0", "x_max_m=-10.0", "minima below"),
    "endless bounds": ("x_max_m = 15.5", "x_max_m = inf", "bounds.x_max_m = inf", "finite"),
    "still time": ("dt_s = 0.4", "dt_s = 0", "dt_s = 0.0", "a positive number"),
    "no radius": ("goal_radius_m = 0.3", "goal_radius_m = nan", "goal_radius_m = nan", "positive"),
    "patience": ("patience_s = 2.0", "patience_s = -1", "patience_s = -1.0", "zero or more"),
    "self-crossing": (
        FIRST_WALL,
        "corners_m = [[0, 0], [4, 4], [4, 0], [0, 4]]",
        "'south parapet' that crosses itself",
        "a simple polygon",
    ),
    "corner twice": (
        FIRST_WALL,
        "corners_m = [[0, 0], [4, 0], [4, 0], [0, 4]]",
        "'south parapet' with a repeated corner",
        "distinct corners",
    ),
    "two corners": (FIRST_WALL, "corners_m = [[0, 0], [4, 4]]", "'south parapet'", "three corners"),
    "nan corner": ("[-0.793, -0.595]", "[nan, -0.595]", "'south parapet' with a corner", "metres"),
    "no clustering": ("[clustering.default]", "[clustering.other]", "clustering.default", "DBSCAN"),
    "narrow": ("widest_m = 4.0", "widest_m = 0.3", "default.widest_m = 0.3", "1 m or more"),
    "no epsilon": ("goal_eps_m = 0.8", "goal_eps_m = 0", "default.goal_eps_m = 0.0", "positive"),
}


@pytest.mark.parametrize(("was", "becomes", "got", "expected"), BROKEN.values(), ids=BROKEN)
def test_a_broken_scene_file_is_refused(tmp_path, was, becomes, got, expected):
    folder = altered(tmp_path, was, becomes)
    with pytest.raises(SceneError) as caught:
        load_scene(folder)
    assert caught.value.where == str(folder / "scene.toml")
    assert got in caught.value.got
    assert expected in caught.value.expected
    assert caught.value.hint
