import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from msgspec.structs import replace as replace_struct
from strategies import crowd_of

from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.errors import SceneError, WeightsError
from crowdbench.scene import Clustering, Scene, load_scene
from crowdbench.spawn.areas import Areas, Gaussians, fit_areas, read_areas, write_areas
from crowdbench.spawn.recorded_plans import plans_of

PAPER = Clustering(0.8, 3, 0.8, 3, keep_noise=False)
KEEP = Clustering(0.8, 3, 0.8, 3, keep_noise=True)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("eth-v0")


@pytest.fixture(scope="module")
def eth(opentraj: Path) -> Trajectories:
    return read_published(SOURCES["eth"], opentraj)


@pytest.fixture(scope="module")
def fitted(eth: Trajectories, scene: Scene) -> tuple[Areas, Trajectories]:
    return fit_areas(eth, scene, scene.clustering["default"])


@pytest.fixture
def folder(tmp_path: Path, scene: Scene) -> Path:
    """A folder of ETH's scene without what was fitted."""
    (tmp_path / "scene.toml").write_bytes((scene.folder / "scene.toml").read_bytes())
    return tmp_path


def walks(starts: list, ends: list) -> Trajectories:
    """People who walk from each start to its end within ten frames, one frame apart."""
    paths = [np.linspace(a, b, 10) for a, b in zip(starts, ends, strict=True)]
    trips = [(k + 1, k + 10) for k in range(len(starts))]
    return crowd_of(trips, frames=len(starts) + 12, dt_s=0.4, xy=np.concatenate(paths))


RING = [[2.0, 5.0], [2.2, 5.0], [2.0, 5.2], [2.2, 5.2]]
AFAR = [[10.0, 5.0], [10.3, 5.0], [10.0, 5.3], [10.3, 5.3]]


def test_less_than_a_tenth_of_eth_is_left_out(fitted):
    areas, crowd = fitted
    assert max(areas.left_out) < 0.1
    assert (crowd.spawn_area[crowd.entered] < 0).mean() < 0.1


def test_the_papers_settings_leave_out_more(eth, scene, fitted):
    paper, crowd = fit_areas(eth, scene, scene.clustering["paper"])
    assert paper.left_out[0] > fitted[0].left_out[0]
    assert (crowd.spawn_area[crowd.entered] < 0).mean() == pytest.approx(paper.left_out[0])


def test_everyone_who_entered_eth_has_a_spawn_area_and_no_other(fitted):
    _, crowd = fitted
    np.testing.assert_array_equal(crowd.spawn_area >= 0, crowd.entered)


def test_everyone_who_left_eth_has_a_goal_area_and_no_other(fitted):
    _, crowd = fitted
    np.testing.assert_array_equal(crowd.goal_area >= 0, crowd.left)


def test_flows_of_eth_are_the_shares_of_its_people(fitted):
    areas, crowd = fitted
    np.testing.assert_allclose(areas.flow.sum(axis=1), 1)
    whole = crowd.entered & crowd.left & (crowd.spawn_area == 0)
    share = np.bincount(crowd.goal_area[whole], minlength=len(areas.goal)) / whole.sum()
    np.testing.assert_allclose(areas.flow[0], share)


def test_preferred_speeds_of_eth_are_those_of_its_people(fitted):
    areas, crowd = fitted
    speeds = plans_of(crowd).speed
    speeds = speeds[crowd.entered & crowd.left & np.isfinite(speeds)]
    assert areas.speed_quantiles[[0, 100]].tolist() == [speeds.min(), speeds.max()]
    assert areas.speed_quantiles[50] == pytest.approx(np.median(speeds))


def test_what_eths_areas_draw_is_walkable_and_in_order(fitted, scene):
    areas, _ = fitted
    rng = np.random.default_rng(1)
    spawn_area = np.repeat(np.arange(len(areas.spawn)), 200)
    events = areas.draw(rng.random(len(spawn_area)) * 60, spawn_area, scene, rng)
    assert scene.walkable(events.start.astype(np.float64)).all()
    assert scene.walkable(events.goal.astype(np.float64)).all()
    assert (np.diff(events.time_s) >= 0).all()
    np.testing.assert_array_equal(np.bincount(events.spawn_area), 200)


def test_drawn_goals_follow_the_flow(fitted, scene):
    areas, _ = fitted
    rng = np.random.default_rng(2)
    draws = 2000
    events = areas.draw(np.zeros(draws), np.zeros(draws, dtype=np.int64), scene, rng)
    share = np.bincount(events.goal_area, minlength=len(areas.goal)) / draws
    error = np.sqrt(areas.flow[0] * (1 - areas.flow[0]) / draws)
    assert (np.abs(share - areas.flow[0]) <= 4 * error).all()


def test_people_enter_at_their_preferred_speed_towards_their_goal(fitted, scene):
    areas, _ = fitted
    events = areas.draw(np.zeros(50), np.zeros(50, dtype=np.int64), scene, np.random.default_rng(3))
    np.testing.assert_allclose(np.linalg.norm(events.velocity, axis=1), events.speed, rtol=1e-4)
    way = events.goal - events.start
    along = (way * events.velocity).sum(axis=1)
    np.testing.assert_allclose(along, np.linalg.norm(way, axis=1) * events.speed, rtol=1e-4)


def test_a_cluster_is_a_gaussian_of_its_members(scene):
    areas, _ = fit_areas(walks(RING, AFAR), scene, PAPER)
    np.testing.assert_allclose(areas.spawn.mean, [[2.1, 5.1]], rtol=1e-6)
    # A variance of 0.1² of the corners, and 0.1² because people are not points.
    np.testing.assert_allclose(areas.spawn.covariance, [0.02 * np.eye(2)], atol=1e-6)


def test_a_wide_cluster_is_split_at_its_gaps(scene: Scene) -> None:
    rng = np.random.default_rng(0)
    doors = [rng.normal(x, 0.8, 60) for x in (3.0, 6.5, 10.0)]
    starts = np.stack([np.concatenate(doors), np.full(180, 5.0)], axis=1)
    crowd = walks(starts.tolist(), [AFAR[k % 4] for k in range(180)])
    whole, _ = fit_areas(crowd, scene, KEEP)
    assert len(whole.spawn) == 1
    split, found = fit_areas(crowd, scene, replace_struct(KEEP, widest_m=1.5))
    np.testing.assert_allclose(np.sort(split.spawn.mean[:, 0]), [3.0, 6.5, 10.0], atol=0.3)
    assert len(split.goal) == len(whole.goal)
    assert (np.bincount(found.spawn_area) > 50).all()


def test_noise_does_not_shape_the_gaussian_of_a_cluster(scene):
    noisy = walks([*RING, [3.6, 5.0]], [*AFAR, [10.1, 5.1]])
    areas, crowd = fit_areas(noisy, scene, KEEP)
    alone, _ = fit_areas(walks(RING, AFAR), scene, KEEP)
    np.testing.assert_array_equal(areas.spawn.mean, alone.spawn.mean)
    np.testing.assert_array_equal(areas.spawn.covariance, alone.spawn.covariance)
    assert crowd.spawn_area.tolist() == [0] * 5


def test_noise_joins_the_nearest_cluster(scene):
    near_the_second = [9.0, 5.0]
    crowd = walks([*RING, *AFAR, near_the_second], [*AFAR, *RING, [2.1, 5.1]])
    _, crowd = fit_areas(crowd, scene, KEEP)
    assert crowd.spawn_area[8] == crowd.spawn_area[4] != crowd.spawn_area[0]


def test_noise_far_from_all_clusters_forms_a_broad_area(scene):
    scattered = [[2.0, 10.0], [6.0, 9.0], [10.0, 10.0]]
    beside_the_ring = [3.6, 5.0]
    crowd = walks([*RING, beside_the_ring, *scattered], [*AFAR, *AFAR])
    areas, crowd = fit_areas(crowd, scene, KEEP)
    assert crowd.spawn_area.tolist() == [0] * 5 + [1] * 3
    np.testing.assert_allclose(areas.spawn.mean[1], [6.0, 29 / 3])
    assert areas.left_out == (3 / 8, 0.0)


def test_the_paper_leaves_noise_out(scene):
    crowd = walks([*RING, [9.0, 9.0]], [*AFAR, [10.1, 5.1]])
    areas, crowd = fit_areas(crowd, scene, PAPER)
    assert crowd.spawn_area.tolist() == [0] * 4 + [-1]
    assert areas.left_out == (0.2, 0.0)


@pytest.mark.parametrize("starts", [RING[:2], [[0.0, 0.0], [5.0, 5.0], [10.0, 0.0]]])
def test_starts_without_a_cluster_are_refused(scene, starts):
    with pytest.raises(SceneError, match="no cluster among"):
        fit_areas(walks(starts, AFAR[: len(starts)]), scene, KEEP)


def test_a_recording_in_which_nobody_entered_is_refused(scene):
    crowd = walks(RING, AFAR)
    with pytest.raises(SceneError, match="no cluster among 0 starts"):
        fit_areas(replace(crowd, entered=np.zeros(4, dtype=bool)), scene, KEEP)


def test_a_recording_without_a_whole_life_is_refused(scene):
    crowd = walks([*RING, *RING], [*AFAR, *AFAR])
    enters = np.arange(8) < 4
    with pytest.raises(SceneError, match="none of whom was seen to enter and to leave"):
        fit_areas(replace(crowd, entered=enters, left=~enters), scene, KEEP)


def test_an_area_where_nobody_can_walk_is_refused(scene):
    behind = Gaussians(np.array([[100.0, 100.0]]), np.array([0.01 * np.eye(2)]))
    with pytest.raises(SceneError) as caught:
        behind.draw(np.zeros(1, dtype=np.int64), scene, np.random.default_rng(0))
    assert "[100.0, 100.0] m" in caught.value.got


def test_areas_come_back_from_their_file_as_they_were(folder, fitted):
    areas, _ = fitted
    write_areas(areas, folder / "areas.json")
    back = read_areas(load_scene(folder))
    for name in ("flow", "speed_quantiles"):
        np.testing.assert_array_equal(getattr(back, name), getattr(areas, name))
    for name in ("mean", "covariance"):
        np.testing.assert_array_equal(getattr(back.spawn, name), getattr(areas.spawn, name))
        np.testing.assert_array_equal(getattr(back.goal, name), getattr(areas.goal, name))
    assert (back.scene, back.left_out) == (areas.scene, areas.left_out)


def test_areas_that_are_missing_say_how_to_get_them(folder):
    with pytest.raises(WeightsError) as caught:
        read_areas(load_scene(folder))
    assert caught.value.where == str(folder / "areas.json")
    assert caught.value.got == "no such file"
    assert "crowdbench scene fit " in caught.value.hint


def test_areas_that_are_no_json_are_refused(folder):
    (folder / "areas.json").write_text('{"schema": 1,')
    with pytest.raises(WeightsError, match="expected valid JSON"):
        read_areas(load_scene(folder))


BROKEN = {
    "scene": ("scene", "zara01-v0", "areas of zara01-v0"),
    "schema": ("schema", 99, "schema 99"),
    "unknown field": ("colour", "red", "colour"),
    "text": ("flow", "none", "of shape ()"),
    "whole": ("left_out", 0.5, "Expected `array`"),
    "no areas": ("spawn_mean_m", [], "shape"),
    "three dimensions": ("spawn_mean_m", [[1.0, 2.0, 3.0]] * 2, "shape"),
    "ragged": ("flow", [[1.0], [0.5, 0.5]], "shape"),
    "one area too few": ("goal_covariance_m2", [[[1.0, 0.0], [0.0, 1.0]]], "shape"),
    "nan": ("speed_quantiles_mps", [None] * 101, "object of shape"),
    "flow": ("flow", [[0.5, 0.4], [0.5, 0.5]], "invalid values"),
    "negative flow": ("flow", [[1.5, -0.5], [0.5, 0.5]], "invalid values"),
    "covariance": ("spawn_covariance_m2", [[[1.0, 2.0], [2.0, 1.0]]] * 2, "invalid values"),
    "lopsided": ("spawn_covariance_m2", [[[1.0, 0.5], [0.0, 1.0]]] * 2, "invalid values"),
    "speeds": ("speed_quantiles_mps", [2.0] * 100 + [1.0], "invalid values"),
}


@pytest.mark.parametrize(("field", "value", "got"), BROKEN.values(), ids=BROKEN)
def test_areas_that_are_broken_are_refused(folder, scene, field, value, got):
    areas, _ = fit_areas(walks(RING + AFAR, AFAR + RING), scene, KEEP)
    write_areas(areas, folder / "areas.json")
    content = json.loads((folder / "areas.json").read_text())
    (folder / "areas.json").write_text(json.dumps(content | {field: value}))
    with pytest.raises(WeightsError) as caught:
        read_areas(load_scene(folder))
    assert str(folder / "areas.json") in caught.value.where
    assert got in caught.value.got
    assert "crowdbench scene fit " in caught.value.hint
