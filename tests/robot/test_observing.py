"""What robots observe: scans are those of geometry, numbers those of the docstring."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from lonely_robots import AHEAD, STAND, drive, lonely
from worlds import Person, box, square

from crowdbench.robot.encounters import Present
from crowdbench.robot.lidar import disturb, scan
from crowdbench.robot.observing import OWN, PROBES

ROOM = square(8.0, box(-1, -1, 1, 1), ((3.0, -6.0), (5.0, -2.0), (3.5, 2.0)))
RANGE_M, RADIUS_M, RAYS = 6.0, 0.3, 72


def ranges_of(
    x: float, y: float, heading: float, people: np.ndarray, radius: float = RADIUS_M
) -> np.ndarray:
    present = Present.nobody(1, max(1, len(people)))
    present.there[0, : len(people)] = True
    present.position[0, : len(people)] = people
    out = np.zeros((1, RAYS))
    scan(np.array([0]), np.array([[x, y]]), np.array([heading]), ROOM.wall_segments, present,
         radius, RANGE_M, out)  # fmt: skip
    return out[0]


@given(
    st.floats(-7, 7), st.floats(-7, 7), st.floats(-math.pi, math.pi),
    st.lists(st.tuples(st.floats(-7, 7), st.floats(-7, 7)), max_size=4),
)  # fmt: skip
def test_a_scan_is_what_a_geometry_library_measures(
    x: float, y: float, heading: float, points: list[tuple[float, float]]
) -> None:
    here = shapely.Point(x, y)
    if ROOM.obstacles.distance(here) < 0.05:
        return
    people = np.array(points).reshape(-1, 2)
    people = people[np.linalg.norm(people - [x, y], axis=1) > RADIUS_M + 0.01]
    discs = [shapely.Point(p).buffer(RADIUS_M, quad_segs=64) for p in people]
    solid = shapely.union_all([ROOM.obstacles, *discs])
    got = ranges_of(x, y, heading, people)
    for r in range(RAYS):
        angle = heading - math.pi + 2 * math.pi * r / RAYS
        cos, sin = math.cos(angle), math.sin(angle)
        ray = shapely.LineString([(x, y), (x + RANGE_M * cos, y + RANGE_M * sin)])
        want = min(RANGE_M, here.distance(ray.intersection(solid)) if ray.intersects(solid) else 99)
        if abs(got[r] - want) < 0.01:
            continue
        # Rays that graze a corner or disc may pass on either side of it.
        either = [
            shapely.LineString([(x, y), (x + RANGE_M * c, y + RANGE_M * s)])
            for c, s in ((math.cos(angle + e), math.sin(angle + e)) for e in (-0.01, 0.01))
        ]
        near = [here.distance(o.intersection(solid)) if o.intersects(solid) else RANGE_M
                for o in either]  # fmt: skip
        assert min(near) - 0.3 <= got[r] <= max(near) + 0.3


def test_noise_has_the_asked_size_and_does_not_depend_on_other_worlds() -> None:
    keys, steps = np.array([5, 9], np.uint64), np.array([3, 4])
    both = np.full((2, 5000), 3.0)
    disturb(np.arange(2), keys, steps, 0.1, 0.2, RANGE_M, both)
    alone = np.full((1, 5000), 3.0)
    disturb(np.arange(1), keys[1:], steps[1:], 0.1, 0.2, RANGE_M, alone)
    np.testing.assert_array_equal(alone[0], both[1])
    kept = both[both < RANGE_M]
    assert abs(1 - len(kept) / both.size - 0.2) < 0.02
    assert abs(kept.std() - 0.1) < 0.005
    assert abs(kept.mean() - 3.0) < 0.01


def test_social_numbers_are_those_of_the_docstring() -> None:
    person = Person(start=(-3.0, 2.0), goal=(9.0, 2.0), speed=1.0, velocity=(1.0, 0.0))
    worlds = lonely(person, nearest=2, visible=False)
    drive(worlds, AHEAD)
    seen = worlds.observe()[0]
    assert seen.shape == worlds.observation_space.shape == (OWN + PROBES + 12,)
    np.testing.assert_allclose(seen[:OWN], [1, 0, 0.96, 0.96, 1, 0], atol=1e-6)
    np.testing.assert_array_equal(seen[OWN : OWN + PROBES], 1.0)
    gap = (math.hypot(2.0, 2.0) - 0.6) / 10
    want = [0.2, 0.2, 0, 0, gap, 1.0, *[0.0] * 6]
    np.testing.assert_allclose(seen[OWN + PROBES :], want, atol=1e-6)


def test_a_scan_shows_walls_and_people_and_begins_at_the_back() -> None:
    worlds = lonely(
        Person(start=(-5.0, 2.0), goal=(-5.0, 2.0), speed=0.0, entered=True),
        scene=square(10.0, box(-8, -1, -7, 1)),
        observation="lidar", rays=4, goal=(-5.0, 8.0),
    )  # fmt: skip
    worlds.view.heading[0] = 0.0
    scanned = worlds.observe()[0, OWN:]
    assert scanned[0] == pytest.approx(0.2)  # the wall, 2 m behind
    assert scanned[1:3].tolist() == [1.0, 1.0]
    drive(worlds, STAND)


def test_the_state_is_in_metres_in_the_frame_of_the_scene() -> None:
    worlds = lonely(
        Person(start=(1.0, 3.0), goal=(9.0, 3.0), velocity=(1.0, 0.0)),
        observation="state", nearest=3,
    )  # fmt: skip
    drive(worlds, AHEAD)
    seen = {name: of[0] for name, of in worlds.observe().items()}
    assert worlds.observation_space.contains(seen)
    np.testing.assert_allclose(seen["robot"], [-4.6, 0, 1, 0, 0, 1, 0, 0.3, 5, 0], atol=1e-6)
    np.testing.assert_allclose(seen["goal"], [5, 0, 9.6], atol=1e-6)
    np.testing.assert_allclose(seen["people"][0], [1.4, 3, 1, 0, 0.3], atol=1e-6)
    assert seen["there"].tolist() == [1, 0, 0]
