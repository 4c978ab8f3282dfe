"""Walls stop people and rays: nobody walks through them, nobody sees through them."""

import math

import numpy as np
import pytest
import shapely
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from worlds import (
    Person,
    box,
    directions,
    place,
    simulate,
    square,
    standing,
    step,
    wall_distances,
)

from crowdbench.scene import Scene, load_scene
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import OBSERVATION, head_of
from crowdbench.simulation.rules import crossing, walk
from crowdbench.simulation.walls import CELL_M, FAR_M, walls_near

HEAD = head_of(OBSERVATION)

DT = 0.4
CORNER = square(10.0, box(2, -9, 3, 5), box(-9, 4, 2, 5))  # walls on the right and above


def polygon(centre: tuple[float, float], radii: list[float], turn: float) -> shapely.Polygon:
    """A simple polygon: corners at even angles around its centre."""
    angle = turn + 2 * np.pi * np.arange(len(radii)) / len(radii)
    way = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    return shapely.Polygon(np.array(centre) + np.array(radii)[:, None] * way)


def corners(shape: shapely.Polygon) -> tuple[tuple[float, float], ...]:
    return tuple((float(x), float(y)) for x, y in shape.exterior.coords[:-1])


coordinates = st.floats(-8, 8).map(lambda x: round(x, 3))
polygons = st.builds(
    polygon,
    st.tuples(coordinates, coordinates),
    st.lists(st.floats(0.3, 4), min_size=3, max_size=7),
    st.floats(0, 6),
)
boxes = st.builds(
    lambda x, y, width, height: shapely.box(x, y, x + width, y + height),
    coordinates,
    coordinates,
    st.floats(0.1, 5),
    st.floats(0.1, 5),
)
obstacles = st.lists(polygons | boxes, min_size=1, max_size=4)


def free_points(shapes: list[shapely.Polygon], count: int, seed: int) -> np.ndarray:
    xy = np.random.default_rng(seed).uniform(-9.9, 9.9, (40 * count, 2)).astype(np.float32)
    near = shapely.union_all(shapes).buffer(0.01)
    return xy[~shapely.intersects_xy(near, xy[:, 0], xy[:, 1])][:count]


@settings(max_examples=40, deadline=None, derandomize=True)
@given(shapes=obstacles, seed=st.integers(0, 2**32 - 1))
def test_nobody_walks_through_a_wall(shapes: list[shapely.Polygon], seed: int) -> None:
    start = free_points(shapes, 30, seed)
    simulation = standing(square(10.0, *map(corners, shapes)), start)
    rng = np.random.default_rng(seed)
    solid = shapely.union_all(shapes)
    actions = np.zeros(simulation.slots.position.shape, np.float32)
    for number in range(80):
        if number % 10 == 0:  # keep on pushing for a while
            actions[0] = rng.uniform(-1, 1, (actions.shape[1], 2))
        there = simulation.slots.alive[0].copy()
        before = simulation.slots.position[0].copy()
        simulation.step(actions)
        straight = there & ~simulation.slots.hit_wall[0]
        ways = np.stack([before, simulation.slots.position[0]], axis=1)[straight]
        through = shapely.intersects(solid, shapely.linestrings(ways))
        xy = simulation.slots.position[0, there]
        assert not through.any()
        assert not shapely.intersects_xy(solid, xy[:, 0], xy[:, 1]).any()


@settings(max_examples=40, deadline=None, derandomize=True)
@given(ring=polygons, seed=st.integers(0, 2**32 - 1))
def test_nobody_leaves_a_closed_ring_of_walls(ring: shapely.Polygon, seed: int) -> None:
    start = ring.buffer(-0.01).representative_point()
    assume(not start.is_empty)
    x, y = start.x, start.y
    edges = square(10.0, corners(ring)).wall_segments
    near = np.arange(len(edges), dtype=np.int32)
    for move in np.random.default_rng(seed).uniform(-2, 2, (300, 2)):
        x, y, _ = walk(float(np.float32(x)), float(np.float32(y)), *move, edges, near, 0, len(near))
        assert shapely.contains_xy(ring, np.float32(x), np.float32(y))


def test_a_move_aimed_at_a_joint_of_two_walls_finds_no_slit() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5000):
        joint, turn = rng.uniform(-5, 5, 2), rng.uniform(0, 2 * np.pi)
        apart = rng.uniform(0.1, 1.5, 2)
        ends = joint + 3 * np.array(
            [[np.cos(a), np.sin(a)] for a in (turn - apart[0], turn + apart[1])]
        )
        start = joint - rng.uniform(0.1, 1) * np.array([np.cos(turn), np.sin(turn)])
        move = rng.uniform(1.01, 3) * (joint - start)
        met = [crossing(*start, *move, *joint, *ends[0]), crossing(*start, *move, *ends[1], *joint)]
        assert min(met) <= 1


def test_a_move_that_ends_at_a_wall_is_not_rounded_to_its_other_side() -> None:
    # Just below 14.098 float32 has only numbers 1e-6 apart, and the next one lies above.
    wall, near = np.array([[14.098, -5.0, 14.098, 5.0]]), np.array([0], np.int32)
    start = np.float32(13.25)
    for gap_m in np.linspace(0, 2e-6, 201):
        x, _, _ = walk(float(start), 0.0, 14.098 - gap_m - start, 0.0, wall, near, 0, 1)
        assert np.float32(x) < 14.098


def test_a_wall_stops_who_walks_at_it() -> None:
    simulation = simulate(CORNER, Person(start=(1.5, 0.0), goal=(9, 0)))
    step(simulation, {0: (5.0, 0.0)})
    np.testing.assert_allclose(simulation.slots.position[0, 0], [2.0, 0.0], atol=2e-3)


def test_who_meets_a_wall_slides_along_it() -> None:
    simulation = simulate(CORNER, Person(start=(1.5, 0.0), goal=(9, 0)))
    step(simulation, {0: (2.5, -2.5)})
    np.testing.assert_allclose(simulation.slots.position[0, 0], [2.0, -1.0], atol=2e-3)


def test_the_velocity_is_the_way_walked_not_the_one_commanded() -> None:
    simulation = simulate(CORNER, Person(start=(1.5, 0.0), goal=(9, 0)))
    step(simulation, {0: (2.5, -2.5)})
    np.testing.assert_allclose(simulation.slots.velocity[0, 0], [0.5 / DT, -2.5], atol=5e-3)


def test_who_walks_into_a_corner_stops_in_it() -> None:
    simulation = simulate(CORNER, Person(start=(1.0, 3.5), goal=(9, 0)))
    for _ in range(3):
        step(simulation, {0: (3.0, 2.0)})
    np.testing.assert_allclose(simulation.slots.position[0, 0], [2.0, 4.0], atol=5e-3)
    assert np.abs(simulation.slots.velocity[0, 0]).max() < 0.02


def test_who_stands_at_a_wall_can_walk_away_from_it() -> None:
    simulation = simulate(CORNER, Person(start=(1.5, 0.0), goal=(9, 0)))
    step(simulation, {0: (5.0, 0.0)})
    step(simulation, {0: (-2.5, 0.0)})
    np.testing.assert_allclose(simulation.slots.position[0, 0], [1.0, 0.0], atol=2e-3)
    assert not simulation.slots.hit_wall[0, 0]


def test_a_hit_is_marked_for_who_met_a_wall_and_no_one_else() -> None:
    people = [Person(start=(1.5, y), goal=(9, 0)) for y in (-2.0, 0.0, 2.0)]
    simulation = simulate(CORNER, *people)
    step(simulation, {0: (0.5, 0.0), 1: (5.0, 0.0), 2: (0.0, -1.0)})
    assert simulation.slots.hit_wall[0, :3].tolist() == [False, True, False]


def seen_distances(scene: Scene, xy: np.ndarray, rays: int, range_m: float) -> np.ndarray:
    """What one person sees who is put at each point in turn."""
    simulation = Simulation(scene, settings=Settings(max_alive=1, rays=rays, ray_range_m=range_m))
    simulation.slots.alive[0, 0] = True
    seen = np.empty((len(xy), rays))
    for n, point in enumerate(xy):
        place(simulation, point[None])
        seen[n] = simulation.observe()[0, 0, HEAD:] * range_m
    return seen


def random_scene(seed: int) -> Scene:
    rng = np.random.default_rng(seed)
    shapes = [
        polygon(tuple(rng.uniform(-9, 9, 2)), list(rng.uniform(0.2, 3, rng.integers(3, 8))), turn)
        for turn in rng.uniform(0, 6, 12)
    ]
    return square(10.0, *map(corners, shapes))


def points_of(scene: Scene, count: int) -> np.ndarray:
    """Points all over the bounds and the step beyond, on the cells' borders, not in walls."""
    b, step_m = scene.bounds, scene.motion.max_speed_mps * scene.dt_s
    rng = np.random.default_rng(3)
    low, high = np.array([b.x_min_m, b.y_min_m]) - step_m, np.array([b.x_max_m, b.y_max_m]) + step_m
    xy = rng.uniform(low, high, (count, 2))
    xy[::4] = low + 0.5 * np.round((xy[::4] - low) / 0.5)
    xy = xy.astype(np.float32)
    # At an edge itself rounding decides what is seen.
    edges = shapely.multilinestrings(scene.wall_segments.reshape(-1, 2, 2))
    return xy[shapely.distance(edges, shapely.points(xy.astype(float))) > 1e-3]


@pytest.mark.parametrize("rays", [1, 7, 32, 64])
@pytest.mark.parametrize("scene", [load_scene("eth-v0"), random_scene(1)], ids=["eth", "random"])
def test_walls_are_seen_as_if_every_segment_were_tried(scene: Scene, rays: int) -> None:
    xy = points_of(scene, 1500)
    seen = seen_distances(scene, xy, rays, 10.0)
    np.testing.assert_allclose(seen, wall_distances(scene, xy, rays, 10.0), atol=1e-4)


@pytest.mark.parametrize("range_m", [0.7, 4.0, 30.0])
def test_walls_are_seen_where_shapely_meets_them(range_m: float) -> None:
    scene = random_scene(2)
    xy = points_of(scene, 300)
    edges = shapely.multilinestrings(scene.wall_segments.reshape(-1, 2, 2))
    ends = xy[:, None] + range_m * directions(32)
    origins = np.broadcast_to(xy[:, None], ends.shape).astype(float)
    rays = shapely.linestrings(np.stack([origins, ends], axis=2))
    meet = shapely.intersection(rays, edges)
    expected = shapely.distance(shapely.points(origins), meet)  # NaN where nothing is met
    expected = np.where(np.isnan(expected), range_m, expected)
    np.testing.assert_allclose(seen_distances(scene, xy, 32, range_m), expected, atol=1e-4)


@settings(max_examples=40, deadline=None, derandomize=True)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(0, 12), reach_m=st.floats(0.2, 3.0))
def test_walls_near_cells_are_all_that_are_near(seed: int, count: int, reach_m: float) -> None:
    rng = np.random.default_rng(seed)
    at = rng.uniform(-2, 32, (count, 2))
    segments = np.hstack([at, at + rng.normal(0, 3, (count, 2))])
    origin, columns, rows = np.zeros(2), 60, 50
    start, near, free, clear = walls_near(segments, origin, columns, rows, reach_m)
    x, y = (CELL_M * (np.arange(n) + 0.5) for n in (columns, rows))
    points = shapely.points(np.tile(x, rows), np.repeat(y, columns))
    lines = shapely.linestrings(segments.reshape(-1, 2, 2))
    distance = shapely.distance(points[:, None], lines[None, :])
    half, far_m = CELL_M * math.sqrt(0.5), max(FAR_M, 4 * reach_m) if count else np.inf
    least, rest = distance.copy(), distance.copy()
    rest[distance <= reach_m + half] = np.inf
    for c in range(columns * rows):
        listed = near[start[c] : start[c + 1]]
        assert (np.diff(listed) > 0).all()
        off = np.abs(distance[c] - reach_m - half)
        expected = np.flatnonzero(distance[c] <= reach_m + half)
        assert {*listed.tolist()} ^ {*expected.tolist()} <= {*np.flatnonzero(off < 1e-9).tolist()}
    for found, of in ((clear, least), (free, rest)):
        np.testing.assert_allclose(
            found, np.minimum(of.min(axis=1, initial=np.inf) - half, far_m), atol=1e-9
        )
