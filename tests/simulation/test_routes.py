"""Ways around walls: as short as they can be, never through a wall, and never without an end."""

import math
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from scipy.sparse.csgraph import dijkstra
from worlds import FAR, Person, Point, actions_of, box, events, square

from crowdbench.errors import SettingError
from crowdbench.policies import Policy, SocialForce, SpeedModel, StateView, Straight
from crowdbench.registry import spawn_model
from crowdbench.scene import Scene, list_scenes, load_scene
from crowdbench.simulation import Settings, Simulation, routes
from crowdbench.simulation.observations import GOAL_RANGE_M
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.state import GOAL, HORIZON

DT = 0.4
CLEAR_M = 0.3
"""Ways turn this far off the walls at least where walls leave so much room."""


def facing(scene: Scene, *worlds: list[Person]) -> Simulation:
    """Worlds of people who have just entered."""
    most = max(len(people) for people in worlds)
    simulation = Simulation(scene, worlds=len(worlds), settings=Settings(max_alive=most, rays=1))
    simulation.reset([events(*people) for people in worlds], horizon=FAR)
    return simulation


def ready(scene: Scene, policy: Policy | None = None) -> Policy:
    policy = policy or Straight()
    policy.reset(scene, np.random.default_rng(0))
    return policy


def walk(
    scene: Scene, person: Person, policy: Policy | None = None, frames: int = 300
) -> tuple[np.ndarray, int]:
    """The path of someone, and how it ended (0 if it did not)."""
    simulation, policy = facing(scene, [person]), ready(scene, policy)
    slots = simulation.slots
    path = [slots.position[0, 0].astype(np.float64)]
    for _ in range(frames):
        simulation.step(actions_of(policy, simulation))
        path.append(slots.position[0, 0].astype(np.float64))
        if slots.ended[0, 0]:
            break
    return np.array(path), int(slots.ended[0, 0])


def length(path: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def shortest(scene: Scene, start: Point, goal: Point, clear_m: float) -> float:
    """Length of the shortest way that keeps off all walls, by brute force; inf if there is none."""
    grown = scene.obstacles.buffer(clear_m, join_style="mitre", mitre_limit=2.0)
    points = np.concatenate([[start, goal], shapely.get_coordinates(grown)])
    points = points[scene.inside(points)]
    solid = grown.buffer(-1e-6)
    shapely.prepare(solid)
    a, b = np.triu_indices(len(points), 1)
    lines = shapely.linestrings(np.stack([points[a], points[b]], axis=1))
    free = ~shapely.intersects(solid, lines)
    edges = np.zeros((len(points), len(points)))
    edges[a[free], b[free]] = shapely.length(lines[free])
    return float(dijkstra(edges, directed=False, indices=0)[1])


def reachable(scene: Scene, start: Point, goal: Point) -> bool:
    """Whether a way with room on both sides joins two free places."""
    grown = scene.obstacles.buffer(CLEAR_M, join_style="mitre", mitre_limit=2.0)
    ends = shapely.points([start, goal])
    return not shapely.intersects(grown, ends).any() and np.isfinite(
        shortest(scene, start, goal, CLEAR_M)
    )


@st.composite
def polygons(draw: st.DrawFn) -> tuple[Point, ...]:
    """A box, a U or a triangle with corners on a grid of half metres, where lines often touch."""
    half = st.integers(-14, 14).map(lambda k: k / 2)
    size = st.integers(2, 10).map(lambda k: k / 2)
    x, y, w, h = draw(half), draw(half), draw(size), draw(size)
    kind = draw(st.sampled_from(["box", "U", "triangle"]))
    if kind == "box":
        return box(x, y, x + w, y + h)
    if kind == "triangle":
        return ((x, y), (x + w, y), (x + draw(size) / 2, y + h))
    w, h = w + 2, h + 1
    corners = [(0, 0), (w, 0), (w, h), (w - 0.5, h), (w - 0.5, 0.5), (0.5, 0.5), (0.5, h), (0, h)]
    turn = draw(st.sampled_from([(1, 0), (0, 1), (-1, 0), (0, -1)]))
    return tuple((x + u * turn[0] - v * turn[1], y + u * turn[1] + v * turn[0]) for u, v in corners)


SPOTS = st.tuples(*[st.integers(-17, 17).map(lambda k: k / 2)] * 2)


@settings(max_examples=60, deadline=None)
@given(st.lists(polygons(), min_size=1, max_size=4), SPOTS, SPOTS)
def test_straight_walkers_take_the_shortest_way(
    walls: list[tuple[Point, ...]], start: Point, goal: Point
) -> None:
    scene = square(9.0, *walls)
    assume(start != goal and reachable(scene, start, goal))
    path, ended = walk(scene, Person(start=start, goal=goal, speed=2.0))
    assert ended == GOAL
    assert length(path) <= 1.02 * shortest(scene, start, goal, CLEAR_M) + 0.1
    # It ends within the goal radius.
    assert length(path) >= shortest(scene, start, goal, 0.0) - 0.3 - 1e-3
    assert not shapely.intersects(scene.obstacles, shapely.LineString(path))


@settings(max_examples=60, deadline=None)
@given(st.lists(polygons(), min_size=1, max_size=4), SPOTS, SPOTS)
def test_a_goal_in_sight_is_walked_at_straight(
    walls: list[tuple[Point, ...]], start: Point, goal: Point
) -> None:
    scene = square(9.0, *walls)
    line = shapely.LineString([start, goal])
    assume(start != goal and not shapely.dwithin(scene.obstacles, line, 1e-6))
    simulation = facing(scene, [Person(start=start, goal=goal)])
    seen = StateView.of(simulation)
    assert seen.towards(Routes.on(scene)).tolist() == seen.goal.tolist()


def seen_from(scene: Scene, *people: Person, version: str) -> np.ndarray:
    """What people who have just entered see."""
    asked = Settings(max_alive=len(people), rays=8, observation=version)
    simulation = Simulation(scene, settings=asked)
    simulation.reset([events(*people)], horizon=FAR)
    return simulation.observe()[0]


@settings(max_examples=60, deadline=None)
@given(st.lists(polygons(), min_size=1, max_size=4), SPOTS, SPOTS)
@example([((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))], (4.5, 0.5), (-6.0, -1.0))
def test_lidar_2_sees_the_shortest_way(
    walls: list[tuple[Point, ...]], start: Point, goal: Point
) -> None:
    scene = square(9.0, *walls)
    assume(start != goal and reachable(scene, start, goal))
    person = Person(start=start, goal=goal, speed=2.0)
    (plain,), (seen,) = (seen_from(scene, person, version=f"lidar-{v}") for v in (1, 2))
    assert seen[[0, 1, *range(6, 14)]].tolist() == plain[[0, 1, *range(5, 13)]].tolist()
    assert seen[5] == np.float32(2.0 / scene.motion.max_speed_mps)
    way = float(seen[2]) * GOAL_RANGE_M
    assert shortest(scene, start, goal, 0.0) - 1e-3 <= way
    assert way <= 1.02 * shortest(scene, start, goal, CLEAR_M) + 0.1
    assert np.hypot(seen[3], seen[4]) == pytest.approx(1.0)
    # A step in the direction that it sees makes the way as much shorter, as far as nothing hides.
    ahead = np.array(start) + 0.01 * seen[3:5]
    assume(shapely.Point(ahead).distance(scene.obstacles) > 1e-6)
    (after,) = seen_from(scene, replace(person, start=tuple(ahead.tolist())), version="lidar-2")
    # Or shorter still, where a better way comes into sight: ways are the shortest but for 2 % and
    # 0.1 m.
    nearer = way - float(after[2]) * GOAL_RANGE_M
    assert 0.01 - 2e-4 <= nearer <= 0.01 + 0.02 * way + 0.1


def crosses(a: Point, b: Point, walls: np.ndarray) -> bool:
    """Whether an edge of a wall crosses the line, of all of them."""
    d = np.subtract(b, a)
    p, q = walls[:, :2] - a, walls[:, 2:] - a
    e = q - p
    sides = (d[0] * p[:, 1] - d[1] * p[:, 0]) * (d[0] * q[:, 1] - d[1] * q[:, 0])
    here = p[:, 1] * e[:, 0] - p[:, 0] * e[:, 1]
    there = here - (d[1] * e[:, 0] - d[0] * e[:, 1])
    return bool(((sides <= 0) & (here * there < 0)).any())


def next_by_hand(routes: Routes, walls: np.ndarray, at: Point, goal: Point) -> list[float]:
    """Next corner of the shortest way, and how far it is from there, of all corners and walls."""
    if not crosses(at, goal, walls):
        return [*goal, 0.0]
    corners, between = routes._corners, routes._between
    ends = [c for c in range(len(corners)) if not crosses(goal, corners[c], walls)]
    off = [math.hypot(*(corners[c] - goal)) for c in ends]
    to_goal = [min((o + w for o, w in zip(off, row[ends], strict=True)), default=np.inf)
               for row in between]  # fmt: skip
    near = [math.hypot(*(corner - at)) for corner in corners]
    ways = sorted((n + w, c) for c, (n, w) in enumerate(zip(near, to_goal, strict=True)))
    for way, c in ways:
        if near[c] > 0.05 and way < np.inf and not crosses(at, corners[c], walls):
            return [*corners[c].tolist(), to_goal[c]]
    return [*goal, 0.0]


@settings(max_examples=100, deadline=None)
@given(
    st.lists(polygons(), min_size=1, max_size=4),
    SPOTS,
    st.lists(st.tuples(SPOTS, st.booleans()), min_size=2, max_size=12),
)
def test_what_is_kept_of_ways_and_sights_changes_nothing(
    walls: list[tuple[Point, ...]], goal: Point, stops: list[tuple[Point, bool]]
) -> None:
    # A person who wanders about in small steps, and now and then is put elsewhere.
    scene = square(9.0, *walls)
    routes, segments = Routes.on(scene), scene.wall_segments
    nobody = np.zeros(1, np.int64)
    at = np.array(stops[0][0])
    for stop, jumps in stops[1:]:
        for step in range(8):
            at = np.array(stop) if jumps else at + 0.06 * (np.array(stop) - at) + 1e-3 * step
            target, beyond = routes.next_of(nobody, nobody, at[None], np.array([goal], np.float64))
            found = [*target[0].tolist(), float(beyond[0])]
            # The order of additions may change the last bit of a distance.
            by_hand = next_by_hand(routes, segments, at, np.array(goal))
            assert found == pytest.approx(by_hand, rel=1e-12, abs=1e-12)


def test_a_goal_in_sight_looks_the_same_in_both_versions() -> None:
    scene = square(9.0, box(-2, -1, 2, 1))
    person = Person(start=(-4.0, -4.0), goal=(4.0, -3.0))
    one, two = (seen_from(scene, person, version=f"lidar-{v}")[0] for v in (1, 2))
    assert two[:5].tolist() == one[:5].tolist()


def test_the_last_observation_of_a_life_knows_the_way_too() -> None:
    scene = square(9.0, box(-2, -1, 2, 1))
    asked = Settings(max_alive=1, rays=8, observation="lidar-2")
    simulation = Simulation(scene, settings=asked)
    simulation.reset([events(Person(start=(0, -4), goal=(0, 4)))], horizon=1)
    first = simulation.observe()[0, 0].copy()
    simulation.step(np.zeros((1, 1, 2), np.float32))
    assert simulation.slots.ended[0, 0] == HORIZON
    assert simulation.observe()[0, 0, 2:].tolist() == first[2:].tolist()


@pytest.mark.parametrize("version", ["lidar-0", "lidar", ""])
def test_an_unknown_version_of_the_observation_is_refused(version: str) -> None:
    with pytest.raises(SettingError, match="one of lidar-1, lidar-2, lidar-3"):
        Settings(observation=version)


@pytest.mark.parametrize("policy", [Straight(), SocialForce(), SpeedModel()], ids=lambda p: p.name)
@pytest.mark.parametrize("start", [(0.0, -4.0), (0.0, 1.0), (-8.0, 3.0)])
@pytest.mark.parametrize("turn", range(4))
def test_walkers_come_out_of_and_into_a_u(policy: Policy, start: Point, turn: int) -> None:
    # Open to the top, and turned by quarters; the goal lies below it or inside.
    shape = [(-3, -2), (3, -2), (3, 4), (2.5, 4), (2.5, -1.5), (-2.5, -1.5), (-2.5, 4), (-3, 4)]
    c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][turn]

    def turned(x: float, y: float) -> Point:
        return (c * x - s * y, s * x + c * y)

    scene = square(10.0, tuple(turned(x, y) for x, y in shape))
    goal = (0.0, -4.0) if start == (0.0, 1.0) else (0.0, 1.0)
    path, ended = walk(scene, Person(start=turned(*start), goal=turned(*goal), speed=1.3), policy)
    assert ended == GOAL
    assert scene.walkable(path).all()


@pytest.mark.parametrize("policy", [Straight(), SocialForce(), SpeedModel()], ids=lambda p: p.name)
def test_everyone_finds_the_way_around_the_kiosk(policy: Policy) -> None:
    scene = load_scene("plaza-v0")
    x, y = np.mean(next(w.corners_m for w in scene.walls if w.name == "kiosk"), axis=0)
    angle = np.arange(16) * np.pi / 8
    around = np.stack([x + 1.6 * np.cos(angle), y + 1.6 * np.sin(angle)], axis=1)
    for start, goal in zip(around, np.roll(around, 8, axis=0), strict=True):
        person = Person(start=tuple(start), goal=tuple(goal), speed=1.3)
        path, ended = walk(scene, person, policy)
        assert ended == GOAL
        assert scene.walkable(path).all()
        assert length(path) < np.pi / 2 * 3.2 + 0.5  # half of the circle that they stand on


@pytest.mark.parametrize("name", list_scenes())
def test_in_each_scene_straight_walkers_arrive(name: str) -> None:
    scene = load_scene(name)
    model = spawn_model("poisson-gmm", scene)
    drawn = model.sample(7200.0, scene, np.random.default_rng(0))[np.arange(200)]
    one_by_one = [
        replace(drawn[np.array([k])], time_s=np.zeros(1), speed=np.ones(1, np.float32))
        for k in range(len(drawn))
    ]
    simulation = Simulation(scene, worlds=len(one_by_one), settings=Settings(max_alive=1, rays=1))
    simulation.reset(one_by_one, horizon=FAR)
    policy, ended = ready(scene), np.zeros(len(one_by_one), np.int64)
    while simulation.slots.alive.any():
        simulation.step(actions_of(policy, simulation))
        ended += simulation.slots.ended[:, 0]
        assert scene.walkable(simulation.slots.position[:, 0].astype(np.float64)).all()
    assert (ended == GOAL).all()


def test_of_two_ways_as_long_the_one_in_sight_is_taken() -> None:
    # A post hides the corner on one side; the ways around the box are equally long to the bit.
    lengths = []
    for side in (-1, 1):
        post = tuple((side * x, y) for x, y in box(0.6, -2.6, 0.85, -2.4))
        scene = square(9.0, box(-1, -1, 1, 1), post)
        path, ended = walk(scene, Person(start=(0, -4), goal=(0, 4), speed=1.3))
        assert ended == GOAL
        assert np.sign(path[:, 0][np.abs(path[:, 0]).argmax()]) == -side
        lengths.append(length(path))
    assert lengths[0] == pytest.approx(lengths[1], abs=1e-3)


def test_who_stands_on_a_corner_walks_on() -> None:
    scene = square(9.0, box(-2, -1, 2, 1), box(-1, 3, 1, 5))
    corners = Routes.on(scene)._corners
    assert len(corners) == 8
    for corner in corners:
        for beside in (0.0, 0.02, 0.049):
            person = Person(start=tuple(corner + beside), goal=tuple(-corner), speed=1.3)
            path, ended = walk(scene, person)
            assert ended == GOAL
            assert length(path) <= shortest(scene, person.start, person.goal, CLEAR_M) + 0.1


def test_who_stands_on_a_corner_to_the_bit_is_not_sent_there() -> None:
    scene = square(9.0, box(-2, -1, 2, 1), box(-1, 3, 1, 5))
    found = Routes.on(scene)
    corners = found._corners.astype(np.float32)
    routes = Routes(corners.astype(np.float64), found._between, found._sight)
    people = [Person(start=tuple(c), goal=tuple(-c)) for c in corners.astype(np.float64)]
    seen = StateView.of(facing(scene, people))
    off = np.linalg.norm(seen.towards(routes) - seen.position, axis=1)
    assert off.min() > 0.1


def test_a_goal_that_no_way_leads_to_is_walked_at_straight() -> None:
    cup = ((-3, -3), (3, -3), (3, 3), (2.9, 3), (2.9, -2.9), (-2.9, -2.9), (-2.9, 3), (-3, 3))
    scene = square(9.0, cup, box(-3, 2.9, 3, 3))
    for goal in ((0.0, 0.0), (2.95, 0.5)):  # enclosed, and in the wall itself
        path, ended = walk(scene, Person(start=(-6, -1), goal=goal), frames=60)
        assert ended == 0
        way = np.array(goal) - path[0]
        np.testing.assert_allclose(path[1] - path[0], DT * way / np.linalg.norm(way), atol=1e-5)


BOX = square(9.0, box(-1, -1, 1, 1))
TO_THE_RIGHT = Person(start=(-3, -0.9), goal=(3, -0.9))
TO_THE_LEFT = Person(start=(3, 0.8), goal=(-3, 0.8))
UP = Person(start=(-0.9, -3), goal=(-0.9, 3))


def test_a_slot_that_another_person_takes_over_leads_it_its_own_way() -> None:
    alone, _ = walk(BOX, UP)
    simulation = Simulation(BOX, settings=Settings(max_alive=1, rays=1))
    simulation.reset([events(TO_THE_RIGHT, replace(UP, time_s=20.0))], horizon=FAR)
    policy, slots, path = ready(BOX), simulation.slots, []
    for _ in range(90):
        simulation.step(actions_of(policy, simulation))
        if slots.person[0, 0] == 1 and len(path) < len(alone):
            path.append(slots.position[0, 0].astype(np.float64))
    assert np.array_equal(path, alone)


def test_persons_of_several_worlds_do_not_share_their_ways() -> None:
    worlds = [[TO_THE_RIGHT, UP], [UP, TO_THE_LEFT], [TO_THE_LEFT, TO_THE_RIGHT]]
    together, alone = facing(BOX, *worlds), [facing(BOX, people) for people in worlds]
    of_all, of_each = ready(BOX), [ready(BOX) for _ in worlds]
    for _ in range(20):
        together.step(actions_of(of_all, together))
        for simulation, policy in zip(alone, of_each, strict=True):
            simulation.step(actions_of(policy, simulation))
        each = np.concatenate([simulation.slots.position for simulation in alone])
        assert np.array_equal(together.slots.position, each)


def test_more_persons_than_before_keep_their_ways() -> None:
    # The table of ways grows when a later slot is taken; those who were there know theirs.
    across = Person(start=(-3, 0), goal=(3, -0.1))
    late = [replace(TO_THE_LEFT, time_s=0.8, goal=(-3, 0.1 * k)) for k in range(5)]
    simulation = facing(BOX, [across, *late])
    policy, path = ready(BOX), []
    for _ in range(14):
        simulation.step(actions_of(policy, simulation))
        path.append(simulation.slots.position[0, 0].astype(np.float64))
    assert np.array_equal(path, walk(BOX, across, frames=14)[0][1:])


def test_a_new_episode_knows_nothing_of_the_one_before() -> None:
    policy = Straight()
    walk(BOX, TO_THE_RIGHT, policy)
    again, _ = walk(BOX, UP, policy)  # another person 0 in slot 0
    assert np.array_equal(again, walk(BOX, UP)[0])


def test_a_policy_that_comes_into_another_scene_takes_its_walls() -> None:
    policy = Straight()
    walk(BOX, TO_THE_RIGHT, policy)
    free, _ = walk(square(9.0), TO_THE_RIGHT, policy)
    np.testing.assert_allclose(free[:, 1], -0.9, atol=1e-6)


def test_ways_in_a_large_place_are_the_same_with_few_remembered_walls(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = square(10.0, *(box(x, y, x + 1.5, y + 1.5) for x in (-6, -1, 4) for y in (-5, 0, 5)))
    rng = np.random.default_rng(0)
    at = rng.uniform(-9.5, 9.5, (400, 2, 2))
    at = at[scene.walkable(at[:, 0]) & scene.walkable(at[:, 1])]
    who = np.zeros(len(at), np.int64), np.arange(len(at))

    def ways() -> tuple[np.ndarray, np.ndarray]:
        monkeypatch.setattr(routes, "_GRAPHS", {})
        found = Routes.on(scene)
        return found.next_of(*who, at[:, 0], at[:, 1])

    usual = ways()
    monkeypatch.setattr(routes, "MOST_GUESSES", 100)
    coarse = ways()
    assert Routes.on(scene).tables.sight.guess_m > 5.0
    for one, other in zip(usual, coarse, strict=True):
        np.testing.assert_array_equal(one, other)
