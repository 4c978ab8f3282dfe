"""What `social-1` shows, against a slow reference without the kernel's short cuts."""

from dataclasses import replace

import numpy as np
import pytest
import shapely
from worlds import Person, box, events, poisson, simulate, slot_of, square, standing, step

from crowdbench.errors import ActionError
from crowdbench.policies import Straight
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene, Wall
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.free_space import CELL_M, free_space
from crowdbench.simulation.observations import (
    GOAL_DIRECTION,
    GOAL_DISTANCE,
    OBSERVATIONS,
    head_of,
    size_of,
)
from crowdbench.simulation.observations import PREFERRED_SPEED as SPEED_BEFORE_RAYS
from crowdbench.simulation.social import (
    AGE,
    AGE_S,
    APPROACH,
    COMPANION,
    HEADING,
    NEAREST,
    NEIGHBOURS,
    OFFSET,
    PASS_DISTANCE,
    PASS_M,
    PASS_S,
    PASS_TIME,
    PREFERRED_SPEED,
    PRESENT,
    PROBE_POINTS,
    PROBES,
    RANGE_M,
    ROUTE_DIRECTION,
    ROUTE_LENGTH,
    SIZE,
    STOOD,
    STOOD_S,
    STOP,
    VELOCITY,
    WAIT_LEFT,
    WAIT_S,
    WALKED,
    WALKED_M,
    in_own_frame,
    neighbours_of,
)
from crowdbench.simulation.state import TO_GOAL, WAITING

DT, FAST = 0.4, 5.0
PARTS = (
    VELOCITY, HEADING, ROUTE_DIRECTION, ROUTE_LENGTH, PREFERRED_SPEED, STOP, WAIT_LEFT, AGE, WALKED,
    STOOD, PROBES, NEIGHBOURS,
)  # fmt: skip
BLOCKS = square(
    8.0,
    box(-6.21, -1.13, -4.17, 3.19),
    box(1.07, 1.23, 2.57, 2.11),
    box(5.03, -7.09, 6.27, -6.51),
    box(0.03, 6.07, 0.13, 7.01),
)
SOCIAL = Settings(max_alive=40, observation="social-1")


def crowd(seed: int, count: int = 40) -> list[Person]:
    """A dense crowd with groups, stops and entries of any velocity."""
    rng = np.random.default_rng(seed)
    people = []
    for k in range(count):
        start, goal, via = rng.uniform(-7.5, 7.5, (3, 2))
        people.append(
            Person(
                time_s=DT * (k // 8),
                start=tuple(start),
                goal=tuple(goal),
                speed=float(rng.uniform(0.5, 2)),
                velocity=tuple(rng.normal(0, rng.choice([0.1, 1.5, 9.0]), 2)),
                group=int(rng.integers(-1, 3)),
                via=tuple(via) if rng.random() < 0.6 else (np.nan, np.nan),
                wait_s=float(rng.choice([0.0, 2.0, 90.0])),
            )
        )
    return people


class Memory:
    """What a person remembers, from its velocities alone."""

    def __init__(self, simulation: Simulation, slot: int) -> None:
        slots = simulation.slots
        way = slots.velocity[0, slot].astype(float)
        if np.hypot(*way) < 0.3:
            way = slots.target[0, slot].astype(float) - slots.position[0, slot]
        self.heading = way / np.hypot(*way) if way.any() else np.array([1.0, 0.0])
        self.steps = self.stood = 0
        self.walked = 0.0

    def walk(self, velocity: np.ndarray) -> None:
        speed = np.hypot(*velocity.astype(float))
        self.steps += 1
        self.walked += speed * DT
        self.stood += speed < 0.3
        if speed >= 0.3:
            self.heading = velocity / speed


def free(scene: Scene, points: np.ndarray) -> np.ndarray:
    """Exact distances of points to walls and bounds."""
    b = scene.bounds
    x, y = points.T
    bound = np.min([x - b.x_min_m, b.x_max_m - x, y - b.y_min_m, b.y_max_m - y], axis=0)
    wall = shapely.distance(scene.obstacles, shapely.points(points)) if scene.walls else np.inf
    return np.clip(np.minimum(bound, wall), 0, 2)


def closest(at: np.ndarray, moves: np.ndarray) -> tuple[float, float]:
    """Time and distance of the closest pass, by search on finer and finer grids."""
    first, last = 0.0, PASS_S
    for _ in range(6):
        times = np.linspace(first, last, 21)
        apart = np.hypot(*(at[:, None] + moves[:, None] * times))
        k = int(apart.argmin())
        first, last = times[max(0, k - 1)], times[min(20, k + 1)]
    return times[k], apart[k]


def others(simulation: Simulation, i: int, own: np.ndarray, people: list[Person]) -> np.ndarray:
    """(8, 8) neighbours of the person in slot i, whose frame has the rows `own`."""
    slots = simulation.slots
    there = slots.alive[0] | (slots.ended[0] != 0)
    seen = there & ~slots.spawned[0] if slots.ended[0, i] else slots.alive[0].copy()
    seen[i] = False
    found = []
    for j in np.flatnonzero(seen):
        at = slots.position[0, j].astype(float) - slots.position[0, i]
        if np.hypot(*at) >= RANGE_M:
            continue
        moves = slots.velocity[0, j].astype(float) - slots.velocity[0, i]
        time_s, apart_m = closest(at, moves)
        groups = [people[int(slots.event[0, k])].group for k in (i, j)]
        row = [
            *np.clip(own @ at / RANGE_M, -1, 1),
            *np.clip(own @ moves / FAST, -1, 1),
            time_s / PASS_S,
            min(1.0, apart_m / PASS_M),
            float(groups[0] == groups[1] >= 0),
            1.0,
        ]
        found.append((np.hypot(*at), j, row))
    rows = [row for _, _, row in sorted(found)[:NEAREST]]
    return np.array(rows + [[0.0] * 8] * (NEAREST - len(rows)))


@pytest.mark.parametrize("seed", range(3))
def test_each_part_is_what_a_slow_reference_says(seed: int) -> None:
    people = crowd(seed)
    simulation = simulate(BLOCKS, *people, settings=SOCIAL)
    rng = np.random.default_rng(seed)
    slots, memories = simulation.slots, {}
    ended = stops = standing_still = 0
    for _ in range(25):
        seen = simulation.observe()[0]
        there = np.flatnonzero(slots.alive[0] | (slots.ended[0] != 0))
        assert np.abs(seen[there]).max() <= 1
        for i in there:
            person, event = int(slots.person[0, i]), people[int(slots.event[0, i])]
            if person not in memories:
                memories[person] = Memory(simulation, i)
            else:
                memories[person].walk(slots.velocity[0, i])
            memory = memories[person]
            cos, sin = memory.heading
            own = np.array([[cos, sin], [-sin, cos]])
            me = seen[i]
            stop = slots.stage[0, i] != TO_GOAL and event.wait_s > 0
            wait_s = np.ceil(event.wait_s / DT - 1e-6) * DT
            if slots.stage[0, i] == WAITING:
                wait_s = (slots.until[0, i] - simulation.clock.frame[0]) * DT
            expected = {
                "velocity": (VELOCITY, own @ slots.velocity[0, i] / FAST),
                "heading": (HEADING, memory.heading),
                "speed": (PREFERRED_SPEED, event.speed / FAST),
                "stop": (STOP, stop),
                "wait": (WAIT_LEFT, stop * min(1.0, wait_s / WAIT_S)),
                "age": (AGE, memory.steps * DT / AGE_S),
                "walked": (WALKED, min(1.0, memory.walked / WALKED_M)),
                "stood": (STOOD, memory.stood * DT / STOOD_S),
            }
            for name, (part, value) in expected.items():
                np.testing.assert_allclose(me[part], np.clip(value, -1, 1), atol=3e-6, err_msg=name)
            points = slots.position[0, i].astype(float) + PROBE_POINTS @ own
            np.testing.assert_allclose(
                me[PROBES], free(BLOCKS, points) / 2, atol=CELL_M / np.sqrt(2) / 2
            )
            np.testing.assert_allclose(
                neighbours_of(me), others(simulation, i, own, people), atol=1e-4
            )
            ended += slots.ended[0, i] != 0
            stops += stop
            standing_still += memory.stood > 0
        simulation.step(rng.normal(0, rng.choice([0.03, 0.3]), (1, 40, 2)).astype(np.float32))
    assert min(ended, stops, standing_still) > 0


@pytest.mark.parametrize("seed", range(2))
def test_the_way_and_the_distances_are_those_of_the_second_version(seed: int) -> None:
    two, social = (
        simulate(BLOCKS, *crowd(seed), settings=replace(SOCIAL, observation=name))
        for name in ("lidar-2", "social-1")
    )
    rng = np.random.default_rng(seed)
    around = 0
    for _ in range(20):
        before, seen = two.observe()[0], social.observe()[0]
        slots = social.slots
        for one, other in zip(two.slots, slots, strict=True):
            assert one.tobytes() == other.tobytes()
        there = np.flatnonzero(slots.alive[0] | (slots.ended[0] != 0))
        assert two.remaining[0, there].tolist() == social.remaining[0, there].tolist()
        near = np.where(two.nearest < RANGE_M, two.nearest, np.inf)
        assert near[0, there].tolist() == social.nearest[0, there].tolist()
        before, seen = before[there], seen[there]
        assert seen[:, ROUTE_LENGTH].tolist() == before[:, GOAL_DISTANCE].tolist()
        assert seen[:, PREFERRED_SPEED].tolist() == before[:, SPEED_BEFORE_RAYS].tolist()
        cos, sin = seen[:, HEADING].T
        x, y = seen[:, ROUTE_DIRECTION].T
        towards = np.stack([x * cos - y * sin, x * sin + y * cos], axis=1)
        away = before[:, GOAL_DISTANCE.start] > 0
        np.testing.assert_allclose(towards[away], before[away][:, GOAL_DIRECTION], atol=1e-6)
        around += (social._beyond[0, there] > 0).sum()
        actions = rng.normal(0, 0.3, (1, 40, 2)).astype(np.float32)
        two.step(actions)
        social.step(actions, own_frame=False)
    assert around > 0


def turned(point: tuple[float, float]) -> tuple[float, float]:
    """A quarter turn to the left."""
    return (-point[1], point[0])


def test_a_turned_world_looks_the_same() -> None:
    people = crowd(7)
    other = replace(
        BLOCKS,
        walls=tuple(Wall(w.name, tuple(turned(c) for c in w.corners_m)) for w in BLOCKS.walls),
    )
    moved = [
        replace(p, **{k: turned(getattr(p, k)) for k in ("start", "goal", "via", "velocity")})
        for p in people
    ]
    one = simulate(BLOCKS, *people, settings=SOCIAL)
    two = simulate(other, *moved, settings=SOCIAL)
    rng = np.random.default_rng(0)
    for _ in range(15):
        seen, again = one.observe()[0], two.observe()[0]
        assert one.slots.alive.tolist() == two.slots.alive.tolist()
        there = one.slots.alive[0] | (one.slots.ended[0] != 0)
        cos, sin = seen[there][:, HEADING].T
        np.testing.assert_allclose(again[there][:, HEADING].T, [-sin, cos], atol=1e-4)
        rest = np.delete(np.arange(SIZE), HEADING)
        np.testing.assert_allclose(again[there][:, rest], seen[there][:, rest], atol=1e-4)
        actions = rng.normal(0, 0.3, (1, 40, 2)).astype(np.float32)
        one.step(actions)
        two.step(actions)


def test_every_value_belongs_to_one_part() -> None:
    assert [k for part in PARTS for k in range(part.start, part.stop)] == list(range(SIZE))
    assert size_of("social-1", 32) == size_of("social-1", 1) == head_of("social-1") == SIZE
    seen = np.arange(2 * SIZE).reshape(2, SIZE)
    assert neighbours_of(seen).shape == (2, NEAREST, 8)
    assert neighbours_of(seen)[1, 1, PRESENT].tolist() == [SIZE + NEIGHBOURS.start + 15]
    slices = (OFFSET, APPROACH, PASS_TIME, PASS_DISTANCE, COMPANION, PRESENT)
    assert [k for part in slices for k in range(part.start, part.stop)] == list(range(8))
    assert [name for name, version in OBSERVATIONS.items() if version.own_frame] == ["social-1"]


def only(*people: Person, **settings: int) -> Simulation:
    return simulate(square(), *people, settings=Settings(observation="social-1", **settings))


def heading_of(simulation: Simulation) -> list[float]:
    return simulation.observe()[0, 0, HEADING].round(4).tolist()


def test_the_heading_is_remembered_while_a_person_stands() -> None:
    simulation = only(Person(start=(0, 0), goal=(0, 5), velocity=(0.1, 0.2)))
    assert heading_of(simulation) == [0, 1]  # towards the target, for want of speed
    for velocity, expected in (
        ((0.31, 0.0), [1, 0]),
        ((0.0, 0.0), [1, 0]),
        ((0.0, -0.29), [1, 0]),
        ((0.0, -0.31), [0, -1]),
    ):
        simulation.step(np.array([[velocity] + [(0, 0)] * 255], np.float32) / FAST, own_frame=False)
        assert heading_of(simulation) == expected
    seen = simulation.observe()[0, 0]
    assert seen[STOOD] * STOOD_S == pytest.approx(2 * DT)
    assert seen[AGE] * AGE_S == pytest.approx(4 * DT)
    assert seen[WALKED] * WALKED_M == pytest.approx((0.31 + 0.29 + 0.31) * DT, abs=1e-5)


def test_whoever_enters_on_the_move_heads_there() -> None:
    assert heading_of(only(Person(goal=(0, 5), velocity=(-3.0, 0.0)))) == [-1, 0]


def test_a_heading_without_speed_and_target_is_along_x() -> None:
    assert heading_of(only(Person(start=(1, 1), goal=(1, 1)))) == [1, 0]


def test_the_next_person_in_a_slot_remembers_nothing() -> None:
    simulation = only(
        Person(start=(0, 0), goal=(2, 0)),
        Person(time_s=4 * DT, start=(0, 3), goal=(0, 5)),
        max_alive=1,
    )
    simulation.step(np.zeros((1, 1, 2), np.float32))
    simulation.step(np.full((1, 1, 2), [0.1, 0.0], np.float32))
    simulation.step(np.full((1, 1, 2), [1.0, 0.0], np.float32))
    assert simulation.slots.ended[0, 0]
    simulation.step(np.zeros((1, 1, 2), np.float32))
    seen = simulation.observe()[0, 0]
    assert simulation.slots.spawned[0, 0]
    assert [*seen[AGE], *seen[WALKED], *seen[STOOD], *seen[HEADING]] == [0, 0, 0, 0, 1]


def test_the_end_of_a_warm_up_is_not_a_new_life() -> None:
    simulation = Simulation(square(), settings=Settings(max_alive=2, observation="social-1"))
    person = replace(events(Person(speed=1.0)), time_s=np.array([-4.0]))
    simulation.reset([person], horizon=50, first_frame=-10)
    for _ in range(10):
        step(simulation, {0: (0.5, 0.0)})
    before = simulation.observe()[0, 0].copy()
    simulation.number_anew()
    assert simulation.observe()[0, 0].tolist() == before.tolist()
    assert before[WALKED] * WALKED_M == pytest.approx(2.0, abs=1e-5)
    assert before[AGE] * AGE_S == pytest.approx(4.0)


def test_a_stop_is_shown_until_its_wait_is_over() -> None:
    simulation = only(Person(via=(2.0, 0.0), wait_s=2.0, goal=(8.0, 0.0), velocity=(1.0, 0.0)))
    shown = []
    for _ in range(10):
        seen = simulation.observe()[0, 0]
        shown.append((float(seen[STOP][0]), round(float(seen[WAIT_LEFT][0]) * WAIT_S, 3)))
        step(simulation, {0: (1.0, 0.0) if len(shown) < 4 else (0.0, 0.0)})
    # Within 1 m of the via point after the third step; then 5 frames.
    assert shown[:3] == [(1.0, 2.0)] * 3
    assert shown[3:9] == [(1, 2.0), (1, 1.6), (1, 1.2), (1, 0.8), (1, 0.4), (0, 0.0)]


def test_a_via_point_without_a_wait_is_no_stop() -> None:
    seen = only(Person(via=(4.0, 0.0), wait_s=0.0)).observe()[0, 0]
    assert [*seen[STOP], *seen[WAIT_LEFT]] == [0, 0]
    assert seen[ROUTE_LENGTH] * 30 == pytest.approx(4.0)


def test_of_equally_near_people_the_lower_slot_is_first() -> None:
    angle = 2 * np.pi * np.arange(4) / 4 + 1e-9
    ring = 4.0 * np.round(np.stack([np.cos(angle), np.sin(angle)], axis=1), 6)
    xy = np.concatenate([[[0.0, 0.0]], ring, ring[::-1], ring])  # 12 people, 4 m away
    seen = standing(square(), xy, observation="social-1").observe()[0, 0]
    heading = seen[HEADING]
    assert heading.tolist() == [1, 0]
    np.testing.assert_allclose(neighbours_of(seen)[:, OFFSET] * RANGE_M, xy[1:9], atol=1e-5)


def test_people_who_walk_together_are_never_going_to_meet() -> None:
    pair = [Person(start=(0, y), velocity=(1.0, 0.0), group=3) for y in (0.0, 1.0)]
    alone = Person(start=(5.0, 0.5), velocity=(-1.0, 0.0))
    companion, stranger = neighbours_of(only(*pair, alone).observe()[0, 0])[:2]
    np.testing.assert_allclose(companion, [0, 1 / 6, 0, 0, 0, 1 / 3, 1, 1], atol=1e-6)
    expected = [5 / 6, 0.5 / 6, -2 / 5, 0, 2.5 / 5, 0.5 / 3, 0, 1]
    np.testing.assert_allclose(stranger, expected, atol=1e-6)


def test_free_space_is_nothing_beyond_walls_and_bounds() -> None:
    scene = square(4.0, box(-3, -3, -1, -1))
    seen = standing(scene, np.array([[-2.0, -2.0], [3.9, 0.0]]), observation="social-1").observe()
    assert seen[0, 0, PROBES][0] == 0
    outside = (np.array([3.9, 0.0]) + PROBE_POINTS @ np.diag([-1, -1]))[:, 0] >= 4
    assert outside.any()
    assert (seen[0, 1, PROBES][outside] == 0).all()  # it heads to the origin


def test_the_grid_of_a_large_scene_has_larger_cells() -> None:
    large = square(1500.0, box(-3, -3, -1, -1))
    grid = free_space(large.walls, large.bounds)
    assert len(grid.distance) < 1.1 * 2**20
    again = [free_space(BLOCKS.walls, BLOCKS.bounds) for _ in range(2)]
    assert again[0].distance is again[1].distance  # computed once


@pytest.mark.parametrize("scale", [0.3, 3.0])
def test_own_actions_are_turned_world_actions(scale: float) -> None:
    own, world = (simulate(BLOCKS, *crowd(3), settings=SOCIAL) for _ in range(2))
    rng = np.random.default_rng(3)
    for _ in range(20):
        actions = (scale * rng.normal(0, 1, (1, 40, 2))).astype(np.float32)
        headings = world.observe()[..., HEADING] * world.slots.alive[..., None]
        own.observe()
        world.step(actions, own_frame=False)
        own.step(in_own_frame(actions, headings))
        assert own.slots.alive.tolist() == world.slots.alive.tolist()
        there = own.slots.alive[0]
        np.testing.assert_allclose(
            own.slots.position[0, there], world.slots.position[0, there], atol=1e-4
        )


@pytest.mark.parametrize(
    ("action", "velocity"),
    [
        ((1, 0), (0, 5)),
        ((0, 0.2), (-1, 0)),
        ((4, 0), (0, 5)),
        ((1, 1), (-(12.5**0.5), 12.5**0.5)),
        ((0.5, -7), (5 / 1.25**0.5, 2.5 / 1.25**0.5)),  # clipped to (0.5, −1), then to the speed
    ],
)
def test_actions_are_clipped_before_they_are_turned(
    action: tuple[float, float], velocity: tuple[float, float]
) -> None:
    simulation = only(Person(goal=(0, 9)), max_alive=1)
    simulation.step(np.array([[action]], np.float32))
    np.testing.assert_allclose(simulation.slots.velocity[0, 0], velocity, atol=1e-5)


def test_some_may_act_in_the_world_frame() -> None:
    simulation = only(*[Person(start=(x, 0), goal=(x, 9)) for x in (0.0, 3.0)], max_alive=2)
    actions = np.full((1, 2, 2), [0.1, 0.0], np.float32)
    simulation.step(actions, own_frame=np.array([[False, True]]))
    np.testing.assert_allclose(simulation.slots.velocity[0], [[0.5, 0], [0, 0.5]], atol=1e-6)
    rays = simulate(square(), Person(goal=(0, 9)), settings=Settings(max_alive=1))
    rays.step(actions[:, :1])
    np.testing.assert_allclose(rays.slots.velocity[0], [[0.5, 0]], atol=1e-6)


def test_actions_of_another_shape_are_refused_in_either_frame() -> None:
    for name in ("lidar-2", "social-1"):
        simulation = simulate(square(), Person(), settings=Settings(observation=name))
        with pytest.raises(ActionError, match="one velocity command per world and slot"):
            simulation.step(np.zeros((1, 3, 2), np.float32))


class Onward:
    """Walks on the path to the target at the preferred speed, in the frame of its observation."""

    name, sees = "onward", "observation"

    def __init__(self, observation: str, direction: slice, speed: slice) -> None:
        self.observation, self._direction, self._speed = observation, direction, speed

    def reset(self, scene: Scene, rng: np.random.Generator) -> None: ...

    def act(self, seen: np.ndarray) -> np.ndarray:
        return seen[:, self._direction] * seen[:, self._speed]


def test_a_rollout_acts_in_the_frame_of_the_policy() -> None:
    world = Onward("lidar-2", GOAL_DIRECTION, SPEED_BEFORE_RAYS)
    own = Onward("social-1", ROUTE_DIRECTION, PREFERRED_SPEED)
    one, other = (rollout(BLOCKS, poisson(BLOCKS), p, seed=0, horizon_s=60.0) for p in (world, own))
    assert other.offsets.tolist() == one.offsets.tolist()
    np.testing.assert_allclose(other.xy, one.xy, atol=1e-3)
    state = rollout(BLOCKS, poisson(BLOCKS), Straight(), seed=0, horizon_s=60.0, settings=SOCIAL)
    plain = rollout(BLOCKS, poisson(BLOCKS), Straight(), seed=0, horizon_s=60.0)
    assert state.xy.tobytes() == plain.xy.tobytes()


def test_the_slices_agree_with_the_person_who_sees_them() -> None:
    simulation = only(Person(start=(1, 2), goal=(1, 6), velocity=(2.5, 0.0), speed=1.5))
    seen = simulation.observe()[0, slot_of(simulation, 0)]
    np.testing.assert_allclose(seen[VELOCITY], [0.5, 0], atol=1e-6)
    np.testing.assert_allclose(seen[ROUTE_DIRECTION], [0, 1], atol=1e-6)  # to its left
    np.testing.assert_allclose(seen[PREFERRED_SPEED], 0.3, atol=1e-6)
