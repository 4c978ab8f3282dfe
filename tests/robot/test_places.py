"""Where robots start, where they go to, and on which path."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from numpy.random import default_rng
from worlds import box, square

import crowdbench
from crowdbench.errors import SettingError
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.places import Places, routes_for

NOBODY = np.empty((0, 2))


@pytest.mark.parametrize("scene", crowdbench.list_scenes())
def test_starts_and_goals_are_apart_free_and_reachable(scene: str) -> None:
    place = crowdbench.load_scene(scene)
    for config in (RobotConfig(), RobotConfig(task="patrol", points=3, min_distance_m=2.0)):
        places = Places(place, 0.45, config)
        routes = routes_for(place, 0.45)
        for seed in range(20):
            start, goals = places.draw(default_rng(seed), NOBODY, 1.0)
            stops = np.concatenate([[start], goals])
            assert len(goals) == config.goals
            off = shapely.distance(place.obstacles, shapely.points(stops))
            assert (off >= 0.45).all()
            assert place.inside(stops).all()
            legs = np.linalg.norm(np.diff(stops, axis=0), axis=1)
            assert (legs >= places.least_m).all()
            for k in range(len(goals)):
                way = follow(routes, stops[k], stops[k + 1])
                assert shapely.distance(place.obstacles, shapely.LineString(way)) >= 0.45


def follow(routes, start: np.ndarray, goal: np.ndarray) -> np.ndarray:  # type: ignore[no-untyped-def]
    """The corners of a path, both ends included."""
    way = [start]
    while len(way) < 100 and not np.array_equal(way[-1], goal):
        at = np.array([0])
        way.append(routes.next_of(at, at, way[-1][None], goal[None])[0][0])
    return np.array(way)


def test_a_start_keeps_off_people() -> None:
    places = Places(crowdbench.load_scene("eth-v0"), 0.3, RobotConfig())
    for seed in range(50):
        rng = default_rng(seed)
        people = places.points[rng.integers(len(places.points), size=5)]
        start, _ = places.draw(rng, people, 1.5)
        assert np.linalg.norm(people - start, axis=1).min() > 1.5


def test_given_ends_are_kept_and_the_others_are_far_from_them() -> None:
    scene = crowdbench.load_scene("eth-v0")
    for settings in ({"start": (0.0, 5.0)}, {"goal": (0.0, 5.0)}):
        for task in ("cross", "patrol"):
            places = Places(scene, 0.3, RobotConfig(**settings, task=task, min_distance_m=6.0))
            start, goals = places.draw(default_rng(0), NOBODY, 1.0)
            fixed = start if "start" in settings else goals[-1]
            np.testing.assert_array_equal(fixed, (0.0, 5.0))
            stops = np.concatenate([[start], goals])
            assert (np.linalg.norm(np.diff(stops, axis=0), axis=1) >= 6.0).all()


def test_a_robot_takes_the_way_that_is_wide_enough() -> None:
    # A wall with a gap of 0.8 m at the middle, and the way around its upper end.
    scene = square(10.0, box(-0.2, -10, 0.2, -0.4), box(-0.2, 0.4, 0.2, 4.0))
    ways = [follow(routes_for(scene, r), np.array([-3.0, 0.0]), np.array([3.0, 0.0]))
            for r in (0.2, 0.5)]  # fmt: skip
    assert len(ways[0]) == 2
    assert ways[1][:, 1].max() > 4.5


def test_a_room_that_walls_enclose_keeps_its_inside() -> None:
    ring = [box(-6, -6, 6, -5.8), box(-6, 5.8, 6, 6), box(-6, -6, -5.8, 6), box(5.8, -6, 6, 6)]
    scene = square(10.0, *ring, box(-1, -1, 1, 1))
    way = follow(routes_for(scene, 0.3), np.array([-4.0, 0.0]), np.array([4.0, 0.0]))
    assert len(way) >= 3
    assert shapely.distance(scene.obstacles, shapely.LineString(way)) >= 0.3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"min_distance_m": 500.0}, "min_distance_m"),
        ({"start": (14.5, 0.0)}, "start: got"),
        ({"goal": (100.0, 0.0)}, "goal: got"),
    ],
)
def test_places_without_room_are_refused(settings: dict[str, float], message: str) -> None:
    scene = crowdbench.load_scene("eth-v0")
    with pytest.raises(SettingError, match=message):
        Places(scene, 0.6, RobotConfig(**settings))


def test_a_goal_behind_walls_is_refused() -> None:
    scene = square(10.0, box(-0.2, -10, 0.2, 10))
    config = RobotConfig(start=(-5.0, 0.0), goal=(5.0, 0.0))
    with pytest.raises(SettingError, match="to which the robot can drive"):
        Places(scene, 0.3, config)
    Places(replace(scene, walls=()), 0.3, config)
