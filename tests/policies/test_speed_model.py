"""The collision-free speed model: what it is made of, and how people walk with it."""

from collections.abc import Callable

import numpy as np
import pytest
from worlds import Person, actions_of, box, ready, simulate, square, walked

from crowdbench.policies import SpeedModel
from crowdbench.policies.speed_model import (
    FOUND,
    PUBLISHED,
    _gap,
    _push_by_people,
    _push_by_walls,
)

DT = 0.4
OPEN = square()
LENGTH_M = PUBLISHED.length_m
PAUSE_M = LENGTH_M + PUBLISHED.repulsion_range_m * np.log(PUBLISHED.repulsion)
"""Distance at which one person's repulsion is as strong as the pull of the way: T = 1 s, ℓ = 0.4 m,
a = 8, D = 0.1 m."""


def standing(x: float, y: float = 0.0) -> Person:
    """Somebody who waits for the whole test."""
    return Person(start=(x, y), goal=(x + 9, y), via=(x, y), wait_s=300.0)


@pytest.mark.parametrize("gaps", [PUBLISHED, FOUND])
def test_who_is_alone_walks_at_its_preferred_speed_from_the_first_step(gaps: object) -> None:
    path = walked(SpeedModel(gaps), OPEN, Person(start=(-4, -3), goal=(4, 3), speed=1.5), frames=10)
    along = 1.5 * DT * np.arange(11)[:, None]
    np.testing.assert_allclose(path[:, 0], [-4, -3] + along * [0.8, 0.6], atol=1e-5)


def test_nobody_walks_beyond_its_goal() -> None:
    simulation = simulate(OPEN, Person(start=(0, 0), goal=(0.5, 0), speed=4.0))
    step_m = actions_of(ready(SpeedModel(), OPEN), simulation)[0, 0] * 5.0 * DT
    np.testing.assert_allclose(step_m, [0.5, 0], atol=1e-6)


@pytest.mark.parametrize(
    ("other", "gap"),
    [
        ((2.0, 0.0), 2.0 - LENGTH_M),
        ((1.2, 0.9 * LENGTH_M), np.hypot(1.2, 0.9 * LENGTH_M) - LENGTH_M),
        ((1.2, -1.1 * LENGTH_M), np.inf),  # it would be passed
        ((-0.5, 0.0), np.inf),  # it is behind
        ((0.1, 0.0), 0.1 - LENGTH_M),  # bodies overlap
    ],
)
def test_the_gap_is_the_free_way_up_to_whoever_would_be_touched(
    other: tuple[float, float], gap: float
) -> None:
    position = np.array([[0.0, 0.0], other, (0.0, 5.0)])
    got = _gap(0, 1.0, 0.0, position, np.array([1, 2]), np.zeros(3), PUBLISHED)
    assert got == pytest.approx(gap)


def test_people_and_walls_repel_as_published() -> None:
    position = np.array([[0.0, 0.0], [0.3, 0.4]])
    for wider in (0.0, 0.2):  # somebody's body that begins nearer by as much
        push = _push_by_people(0, position, np.array([1]), np.array([0.0, wider]), PUBLISHED)
        strength = 8 * np.exp((0.4 + wider - 0.5) / 0.1)
        np.testing.assert_allclose(push, -strength * np.array([0.6, 0.8]))
    wall = np.array([[-1.0, -0.25, 1.0, -0.25]])
    near = np.zeros(1, np.int32)
    push = _push_by_walls(0.0, 0.0, wall, near, near, PUBLISHED)
    np.testing.assert_allclose(push, [0, 5 * np.exp((0.2 - 0.25) / 0.02)])


def test_the_speed_is_the_gap_by_the_time_gap() -> None:
    # The other one stands 1 m ahead, where the repulsion is weak: d(gap)/dt = −gap / T.
    people = Person(start=(0, 0), goal=(9, 0), speed=2.0), standing(1.0)
    path = walked(SpeedModel(PUBLISHED), OPEN, *people, frames=1)
    gap_m = (1 - LENGTH_M) * (1 - 0.05) ** 8  # eight steps of 0.05 s, T = 1 s
    assert 1 - path[1, 0, 0] - LENGTH_M == pytest.approx(gap_m, abs=1e-5)


def test_people_stop_behind_somebody_who_stands() -> None:
    people = Person(start=(-6, 0), goal=(9, 0), speed=1.3), standing(0.0)
    path = walked(SpeedModel(PUBLISHED), OPEN, *people, frames=40)
    # It swings by some centimetres, since the direction turns over where both are equal.
    np.testing.assert_allclose(-path[-20:, 0, 0], PAUSE_M, atol=0.07)
    assert path[-1, 1].tolist() == [0, 0]


def test_people_queue_behind_somebody_who_stands() -> None:
    walls = box(-9, 0.35, 5, 1.35), box(-9, -1.35, 5, -0.35)  # nobody can pass
    scene = square(10.0, *walls)
    people = [Person(start=(-1.5 - k, 0), goal=(9, 0), speed=1.3) for k in range(5)]
    path = walked(SpeedModel(PUBLISHED), scene, standing(0.0), *people, frames=60)[-1, :, 0]
    apart = -np.diff(path)
    assert (apart > LENGTH_M).all()
    assert (apart < PAUSE_M + 0.05).all()


def test_who_meets_a_crowd_keeps_its_distance() -> None:
    rng = np.random.default_rng(2)
    grid = np.stack(np.meshgrid(np.arange(4), np.arange(3)), axis=-1).reshape(-1, 2) * 0.9
    here = [Person(start=tuple(p - np.array([5, 1])), goal=(9, g), speed=1.3) for p, g in
            zip(grid, rng.uniform(-3, 3, len(grid)), strict=True)]  # fmt: skip
    there = [Person(start=tuple(p + np.array([2, -1.2])), goal=(-9, g), speed=1.3) for p, g in
             zip(grid, rng.uniform(-3, 3, len(grid)), strict=True)]  # fmt: skip
    path = walked(SpeedModel(PUBLISHED), OPEN, *here, *there, frames=25)
    apart = np.linalg.norm(path[:, :, None] - path[:, None], axis=3)
    upper = np.triu_indices(path.shape[1], 1)
    assert np.nanmin(apart[:, *upper]) > LENGTH_M - 0.01
    assert np.nanmean(path[-1, :12, 0] - path[0, :12, 0]) > 3  # and they get on


def crossing(turn: float = 0.0) -> list[Person]:
    """Ten people close to each other, turned around the origin."""
    rng = np.random.default_rng(6)
    c, s = np.cos(turn), np.sin(turn)
    rotate = np.array([[c, -s], [s, c]])
    draws = rng.uniform([-1.5, -1.5, -8, -8], [1.5, 1.5, 8, 8], (10, 4))
    return [
        Person(start=tuple(rotate @ d[:2]), goal=tuple(rotate @ d[2:]), speed=1.3) for d in draws
    ]


def actions(people: list[Person]) -> np.ndarray:
    return actions_of(ready(SpeedModel(), OPEN), simulate(OPEN, *people))[0, : len(people)]


@pytest.mark.parametrize("turn", [0.3, np.pi / 2, 2.5])
def test_no_direction_is_special(turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    turned = actions(crossing()) @ np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(actions(crossing(turn)), turned, atol=1e-4)


@pytest.mark.parametrize("order", [np.argsort, np.flip])
def test_the_numbering_of_people_does_not_matter(
    order: Callable[[np.ndarray], np.ndarray],
) -> None:
    people = crossing()
    shuffled = order(np.random.default_rng(1).permutation(len(people)))
    other = actions([people[k] for k in shuffled])
    np.testing.assert_allclose(other, actions(people)[shuffled], atol=1e-5)


@pytest.mark.parametrize("beside_m", [0.0, 1e-3])
def test_people_in_one_place_get_finite_velocities(beside_m: float) -> None:
    people = [Person(start=(0, y), goal=(0, 0)) for y in (0.0, beside_m)]
    assert np.isfinite(actions(people)).all()
