"""ORCA walkers avoid each other and walls, and remember nobody."""

import sys
from dataclasses import replace

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from worlds import (
    FAR,
    Person,
    actions_of,
    alive,
    box,
    events,
    poisson,
    ready,
    simulate,
    square,
    walked,
)

from crowdbench.baselines.orca import BODY_M, NUDGE_MPS, ORCA
from crowdbench.errors import SettingError
from crowdbench.policies import Policy, StateView, Straight
from crowdbench.registry import policy as named
from crowdbench.run.rollout import rollout
from crowdbench.simulation import Settings, Simulation

DT = 0.4
OPEN = square()
TOUCH_M = 2 * BODY_M


def nearest_m(path: np.ndarray) -> float:
    """The least distance between two who are there."""
    a, b = np.triu_indices(path.shape[1], 1)
    return float(np.nanmin(np.linalg.norm(path[:, a] - path[:, b], axis=2)))


def test_it_is_a_policy_under_its_own_name() -> None:
    walker = named("crowdbench.baselines.orca:ORCA", "plaza-v0")
    assert isinstance(walker, Policy)
    assert walker.name == "orca"


def test_without_pyrvo_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyrvo", None)
    with pytest.raises(SettingError, match=r"no pyrvo.*\[orca\]"):
        ORCA()


def test_who_is_alone_walks_like_straight_and_arrives() -> None:
    person = Person(start=(-4, -3), goal=(4.1, 3), speed=1.5)
    alone, straight = (walked(p, OPEN, person, frames=20) for p in (ORCA(), Straight()))
    np.testing.assert_allclose(alone, straight, atol=20 * DT * NUDGE_MPS)
    assert np.isnan(alone[-1]).all()


def test_nobody_passes_the_goal() -> None:
    simulation = simulate(OPEN, Person(goal=(0.5, 0), speed=4.0, velocity=(4.0, 0)))
    step = actions_of(ready(ORCA(), OPEN), simulation)[0, 0] * OPEN.motion.max_speed_mps * DT
    np.testing.assert_allclose(step, [0.5, 0.0], atol=1.1 * NUDGE_MPS * DT)


@pytest.mark.parametrize("beside_m", [0.0, 0.05])
def test_who_meet_head_on_pass_without_a_touch(beside_m: float) -> None:
    people = (
        Person(start=(-4, beside_m), goal=(9, beside_m), speed=1.3, velocity=(1.3, 0)),
        Person(start=(4, -beside_m), goal=(-9, -beside_m), speed=1.3, velocity=(-1.3, 0)),
    )
    path = walked(ORCA(), OPEN, *people, frames=14)
    assert path[-1, 0, 0] > path[-1, 1, 0]
    assert nearest_m(path) > TOUCH_M - 0.01


def test_a_circle_of_people_change_places() -> None:
    angle = 2 * np.pi * np.arange(10) / 10
    ring = 5.0 * np.column_stack([np.cos(angle), np.sin(angle)])
    people = [Person(start=tuple(p), goal=tuple(-p), speed=1.3) for p in ring]
    path = walked(ORCA(), OPEN, *people, frames=60)
    assert np.isnan(path[-1]).all()
    assert nearest_m(path) > TOUCH_M - 0.02


PLACE = st.tuples(st.integers(-6, 6), st.integers(-6, 6))


@settings(max_examples=25)
@given(st.lists(st.tuples(PLACE, PLACE), min_size=2, max_size=8, unique_by=lambda p: p[0]))
def test_who_do_not_overlap_never_do(lines: list[tuple[tuple[int, int], tuple[int, int]]]) -> None:
    people = [Person(start=start, goal=goal, speed=1.3) for start, goal in lines]
    path = walked(ORCA(), OPEN, *people, frames=20)
    if (~np.isnan(path[:, :, 0])).sum(axis=1).max() > 1:
        assert nearest_m(path) > TOUCH_M - 0.05


@settings(max_examples=25)
@given(st.lists(st.tuples(PLACE, PLACE, PLACE), min_size=1, max_size=30))
def test_actions_are_finite_and_no_faster_than_1_3_times_the_preference(
    people: list[tuple[tuple[int, int], ...]],
) -> None:
    crowd = [
        Person(start=(x / 20, y / 20), goal=goal, velocity=velocity)
        for (x, y), goal, velocity in people
    ]
    simulation = simulate(OPEN, *crowd, settings=Settings(max_alive=len(crowd)))
    speed = np.linalg.norm(actions_of(ready(ORCA(), OPEN), simulation)[0], axis=1)
    assert (speed * OPEN.motion.max_speed_mps <= 1.3 + 1e-3).all()


def test_who_stand_in_one_place_come_apart() -> None:
    people = [Person(start=(0, 0), goal=(8, 0)) for _ in range(3)]
    path = walked(ORCA(), OPEN, *people, frames=6)
    assert nearest_m(path[-1:]) > TOUCH_M - 0.01


WALL = box(-0.5, -3, 0.5, 3)


@pytest.mark.parametrize("corners", [WALL, WALL[::-1]], ids=["anticlockwise", "clockwise"])
def test_people_get_around_a_wall_and_keep_off_it(corners: tuple) -> None:
    scene = square(10.0, corners)
    people = [Person(start=(-4, y), goal=(5, -y), speed=1.2) for y in (-2.0, -1.0, 0.1, 1.0, 2.0)]
    path = walked(ORCA(), scene, *people, frames=60)
    assert np.isnan(path[-1]).all()
    assert (
        shapely.distance(scene.obstacles, shapely.points(path[~np.isnan(path[..., 0])])).min()
        > BODY_M - 0.02
    )  # at corners; beside walls 0.2


@pytest.mark.parametrize("thick_m", [0.1, 0.5])
def test_thin_walls_are_walls(thick_m: float) -> None:
    scene = square(10.0, box(0, -3, thick_m, 3))
    path = walked(ORCA(), scene, Person(start=(-2, 0), goal=(3, 0)), frames=40)
    assert np.isnan(path[-1]).all()
    assert (
        shapely.distance(
            scene.obstacles, shapely.points(path[:-1][~np.isnan(path[:-1, 0, 0]), 0])
        ).min()
        > BODY_M - 0.02
    )


def test_a_wall_alongside_repels_nobody() -> None:
    beside = Person(start=(-3, 0), goal=(9, 0), velocity=(1, 0))
    scene = square(10.0, box(-9, -2, 9, -0.25), box(-9, 0.25, 9, 2))
    between, free = (walked(ORCA(), s, beside, frames=10) for s in (scene, OPEN))
    assert between.tobytes() == free.tobytes()


def test_who_is_inside_a_wall_is_not_held_there() -> None:
    inside = simulate(square(10.0, box(-2, -2, 2, 2)), Person(start=(0, 0), goal=(8, 0)))
    actions = actions_of(ready(ORCA(), inside.scene), inside)
    assert actions[0, 0, 0] * inside.scene.motion.max_speed_mps == pytest.approx(
        1.0, abs=1.1 * NUDGE_MPS
    )


def test_a_crowd_gets_through_a_gap_and_nobody_into_a_wall() -> None:
    scene = square(10.0, box(-0.5, -9, 0.5, -0.6), box(-0.5, 0.6, 0.5, 9))
    people = [Person(start=(-2 - x, y - 2), goal=(6, y - 2), speed=1.0 + 0.1 * y)
              for x in range(4) for y in range(5)]  # fmt: skip
    path = walked(ORCA(), scene, *people, frames=100)
    there = path[~np.isnan(path[..., 0])].astype(np.float64)
    assert scene.walkable(there).all()
    assert np.isnan(path[-1]).all()


def test_people_who_come_and_go_leave_nothing_behind() -> None:
    scene = square(10.0, box(-1, -1, 1, 1), dwell_p99_s=20.0)
    arrivals = poisson(scene, rate_per_s=1.0).sample(120.0, scene, np.random.default_rng(3))
    assert len(arrivals) > 100
    simulation = Simulation(scene, settings=Settings(max_alive=64))
    simulation.reset([arrivals], horizon=FAR)
    old, most, fewest = ready(ORCA(), scene), 0, FAR
    for frame in range(300):
        actions = actions_of(old, simulation)
        assert (actions == actions_of(ready(ORCA(), scene), simulation)).all()
        most = max(most, len(alive(simulation)))
        fewest = min(fewest, len(alive(simulation))) if frame > 50 else fewest
        if most:
            assert old._crowds[0].simulator.get_num_agents() == most
        simulation.step(actions)
    assert fewest < most < 60


def crowd(seed: int, size: int = 12) -> list[Person]:
    """People close to each other."""
    draws = np.random.default_rng(seed).uniform([-2, -2, -8, -8], [2, 2, 8, 8], (size, 4))
    return [Person(start=tuple(d[:2]), goal=tuple(d[2:]), speed=1.3) for d in draws]


def actions_in(policy: Policy, *worlds: list[Person]) -> np.ndarray:
    simulation = Simulation(OPEN, worlds=len(worlds), settings=Settings(max_alive=12))
    simulation.reset([events(*people) for people in worlds], horizon=FAR)
    return policy.act(StateView.of(simulation))


def test_worlds_do_not_see_each_other() -> None:
    one, other = crowd(1), crowd(2, 7)
    together = actions_in(ready(ORCA(), OPEN), one, other, one)
    alone = [actions_in(ready(ORCA(), OPEN), people).tolist() for people in (one, other, one)]
    assert together.tolist() == [row for actions in alone for row in actions]


def test_who_is_far_away_makes_no_difference() -> None:
    near = [Person(start=(x, 0.1 * x), goal=(-x, 1), speed=1.2) for x in (-3.0, -1.0, 1.5)]
    visitors = [replace(p, start=(-8, -9 + k), goal=(-9, -9 + k), leave_frame=5 + k)
                for k, p in enumerate(crowd(4, 3))]  # fmt: skip
    lonely = walked(ORCA(), OPEN, *near, frames=20)
    visited = walked(ORCA(), OPEN, *near, *visitors, frames=20)
    assert visited[:, :3].tobytes() == lonely.tobytes()


@pytest.mark.parametrize("seed", [0, 7])
def test_a_crowd_is_the_same_each_time_whatever_the_random_numbers(seed: int) -> None:
    first, again = (actions_in(ready(ORCA(), OPEN, s), crowd(5)) for s in (0, seed))
    assert first.tobytes() == again.tobytes()


def test_the_same_seed_gives_the_same_bytes() -> None:
    scene = square(10.0, box(-1, -1, 1, 1), dwell_p99_s=20.0)
    policy = ORCA()
    first, again = (
        rollout(scene, poisson(scene), policy, seed=4, horizon_s=60.0) for _ in range(2)
    )
    assert len(first) > 20
    assert first.xy.tobytes() == again.xy.tobytes()
