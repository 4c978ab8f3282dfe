"""What a person sees: itself, the walls and the discs of others."""

import numpy as np
import pytest
from worlds import (
    Person,
    box,
    directions,
    disc_distances,
    events,
    place,
    simulate,
    slot_of,
    square,
    standing,
    step,
    wall_distances,
)

from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.observations import CONTACT, OBSERVATION, head_of

HEAD = head_of(OBSERVATION)

DT = 0.4
RADIUS = 0.3
OPEN = square()
# Corners where nobody stands exactly, and no ray runs exactly along an edge.
BLOCKS = square(
    10.0,
    box(-6.21, -1.13, -4.17, 3.19),
    box(1.07, 1.23, 2.57, 2.11),
    box(5.03, -8.09, 8.27, -7.51),
    box(0.03, 6.07, 0.13, 9.01),
)


def rays_of(simulation: Simulation, person: int) -> np.ndarray:
    """Ray distances of a person who is there, in units of the range."""
    return simulation.observe()[0, slot_of(simulation, person), HEAD:]


def crowd(count: int, range_m: float, seed: int) -> np.ndarray:
    """A random crowd, part of it on the borders of the cells that persons are sorted into."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-11.9, 11.9, (count, 2))
    cell_m = range_m / 2
    borders = np.round((xy[::3] + 12) / cell_m) * cell_m - 12
    xy[::3] = np.clip(borders, -12, 12)
    return xy.astype(np.float32)


@pytest.mark.parametrize("rays", [1, 5, 32])
@pytest.mark.parametrize(
    ("count", "range_m"), [(2, 10.0), (60, 10.0), (60, 3.0), (300, 4.0), (40, 40.0)]
)
def test_rays_meet_what_a_caster_without_short_cuts_meets(
    count: int, range_m: float, rays: int
) -> None:
    xy = crowd(count, range_m, seed=count)
    simulation = standing(BLOCKS, xy, rays=rays, ray_range_m=range_m)
    seen = simulation.observe()[0, :, HEAD:] * range_m
    walls = wall_distances(BLOCKS, xy, rays, range_m)
    # A ray that grazes a disc may meet or miss it: float32 cannot tell.
    nearest, farthest = (
        np.minimum(walls, disc_distances(xy, rays, RADIUS + margin)) for margin in (1e-5, -1e-5)
    )
    assert (seen >= nearest - 1e-4).all()
    assert (seen <= farthest + 1e-4).all()


@pytest.mark.parametrize("rays", [2, 8, 32])
def test_each_ray_has_a_direction_of_its_own(rays: int) -> None:
    around = 5 * directions(rays)
    for k in range(rays):
        simulation = standing(OPEN, np.array([[0, 0], around[k]]), rays=rays)
        assert np.flatnonzero(rays_of(simulation, 0) < 1).tolist() == [k]


def test_a_disc_is_seen_at_its_edge() -> None:
    simulation = standing(OPEN, np.array([[0.0, 0.0], [0.0, -5.0]]), ray_range_m=10.0)
    np.testing.assert_allclose(rays_of(simulation, 0)[24] * 10, 5.0 - RADIUS, atol=1e-5)


@pytest.mark.parametrize(("distance_m", "seen"), [(4.29, True), (4.31, False)])
def test_others_are_seen_as_far_as_the_range_reaches(distance_m: float, seen: bool) -> None:
    simulation = standing(OPEN, np.array([[0, 0], [distance_m, 0]]), ray_range_m=4.0)
    assert (rays_of(simulation, 0)[0] < 1) == seen


def test_who_stands_in_anothers_disc_sees_nothing_in_that_half_plane() -> None:
    # Between two rays, so that none is exactly sideways.
    angle = 2 * np.pi * 4.5 / 32
    neighbour = 0.2 * np.array([np.cos(angle), np.sin(angle)])
    simulation = standing(OPEN, np.stack([np.zeros(2), neighbour]))
    towards = directions(32) @ neighbour > 0
    assert rays_of(simulation, 0).tolist() == np.where(towards, 0.0, 1.0).tolist()


def one_ends_and_another_enters() -> Simulation:
    """Person 0 at (0, 0) has just ended, 1 stands at (3, 0), 2 has just entered at (0, 3)."""
    simulation = simulate(
        OPEN,
        Person(start=(0, 0), goal=(0, 0)),
        Person(start=(3, 0)),
        Person(time_s=DT, start=(0, 3)),
        settings=Settings(max_alive=3),
    )
    step(simulation)
    return simulation


def test_the_living_do_not_see_who_ended() -> None:
    simulation = one_ends_and_another_enters()
    west = 16
    assert rays_of(simulation, 1)[west] == 1


def test_the_living_see_who_has_just_entered() -> None:
    simulation = one_ends_and_another_enters()
    north_west = 12
    assert rays_of(simulation, 1)[north_west] < 1


def test_who_ended_sees_those_who_were_there_and_not_who_enters() -> None:
    simulation = one_ends_and_another_enters()
    assert simulation.slots.ended[0].tolist() == [1, 0, 0]
    east = 0
    last = simulation.observe()[0, 0, HEAD:]
    assert np.flatnonzero(last < 1).tolist() == [east]


def test_people_who_end_together_see_each_other() -> None:
    people = [Person(start=(x, 0), goal=(x, 0)) for x in (0.0, 3.0)]
    simulation = simulate(OPEN, *people)
    step(simulation)
    assert simulation.observe()[0, 0, HEAD] < 1


def test_the_first_observation_of_a_life_is_that_of_anyone_who_stands_there() -> None:
    newborn = Person(start=(2, 1), goal=(5, 5), velocity=(1, -2))
    simulation = simulate(
        BLOCKS,
        Person(start=(-3, 0), goal=(-3, 0)),
        Person(start=(3, 3)),
        Person(time_s=2 * DT, start=newborn.start, goal=newborn.goal, velocity=newborn.velocity),
        settings=Settings(max_alive=2),
    )
    simulation.observe()
    step(simulation)
    simulation.observe()
    step(simulation)  # the third person takes the first one's slot
    fresh = simulate(BLOCKS, newborn, Person(start=(3, 3)), settings=Settings(max_alive=2))
    assert simulation.observe()[0, 0].tobytes() == fresh.observe()[0, 0].tobytes()


def test_a_person_sees_its_velocity_and_the_way_to_its_goal() -> None:
    simulation = simulate(OPEN, Person(start=(1, 2), goal=(4, 6), velocity=(2.5, -1.0)))
    head = simulation.observe()[0, 0, :HEAD]
    np.testing.assert_allclose(head, [0.5, -0.2, 5 / 30, 0.6, 0.8, 0.2], atol=1e-6)


def test_the_third_version_sees_the_bounds_and_else_what_the_second_sees() -> None:
    person = Person(start=(-7.0, 1.0), goal=(9.0, 1.0))
    two, three = (
        simulate(BLOCKS, person, settings=Settings(observation=f"lidar-{v}")).observe()[0, 0]
        for v in (2, 3)
    )
    b = BLOCKS.bounds
    away = [-7.0 - b.x_min_m, b.x_max_m + 7.0, 1.0 - b.y_min_m, b.y_max_m - 1.0]
    assert min(away) < 10 < max(away)
    np.testing.assert_allclose(three[6:10], np.minimum(away, 10) / 10, atol=1e-6)
    assert np.delete(three, range(6, 10)).tolist() == two.tolist()


@pytest.mark.parametrize("base", ["lidar-2", "social-1"])
def test_the_last_values_are_what_bodies_took_away(base: str) -> None:
    scene = square(body_radius_m=0.15)
    people = [Person(start=(0.0, 0.0)), Person(start=(-0.5, -0.5), velocity=(0.5, 0.5))]
    asked = Settings(max_alive=2, observation=f"{base}-contact")
    simulation = simulate(scene, *people, settings=asked)
    plain = simulation.showing(asked.shown._replace(observation=base))
    for _ in range(3):
        seen, of_base = simulation.observe(), plain.observe()
        assert seen[..., :-2].tobytes() == of_base.tobytes()
        if simulation.slots.spawned.any():
            assert not seen[..., CONTACT].any()
        simulation.step(np.array([[[0, 0], [0.2, 0.2]]], np.float32), own_frame=False)
    seen = simulation.observe()[0, :, CONTACT]
    slots = simulation.slots
    lost = (slots.commanded - slots.velocity)[0, 1].astype(np.float64) / 5
    assert np.hypot(*lost) > 0.25  # it has been stopped
    cos, sin = slots.heading[0, 1]
    own = [lost[0] * cos + lost[1] * sin, lost[1] * cos - lost[0] * sin]
    np.testing.assert_allclose(seen[1], lost if base == "lidar-2" else own, atol=1e-6)
    assert seen[0].tolist() == [0, 0]


def test_without_bodies_only_walls_take_anything_away() -> None:
    asked = Settings(max_alive=3, observation="lidar-2-contact")
    places = [(0.0, 0.0), (-0.1, 0.0), (-5.0, 0.0)]
    people = [Person(start=place, velocity=(1.0, 0.0)) for place in places]
    simulation = simulate(square(10.0, box(1, -2, 2, 2)), *people, settings=asked)
    for _ in range(4):
        simulation.step(np.array([[[0.2, 0.0]] * 3], np.float32))
    seen = simulation.observe()[0, :, CONTACT]
    np.testing.assert_allclose(seen, [[0.2, 0.0], [0.2, 0.0], [0.0, 0.0]], atol=1e-6)


def test_far_goals_look_equally_far() -> None:
    simulation = simulate(square(100.0), Person(goal=(-60, 0)))
    head = simulation.observe()[0, 0, :HEAD]
    np.testing.assert_allclose(head[2:5], [1, -1, 0], atol=1e-6)


def test_at_the_goal_its_direction_is_along_x() -> None:
    simulation = simulate(OPEN, Person(start=(1, 2), goal=(1, 2)))
    assert simulation.observe()[0, 0, 2:5].tolist() == [0, 1, 0]


def test_every_value_lies_between_minus_one_and_one() -> None:
    rng = np.random.default_rng(0)
    people = [
        Person(
            time_s=DT * (k // 4),
            start=tuple(rng.uniform(-3.5, 0.9, 2)),
            goal=tuple(rng.uniform(-60, 60, 2)),
            velocity=tuple(rng.uniform(-20, 20, 2)),
        )
        for k in range(60)
    ]
    asked = Settings(max_alive=64, observation="lidar-3")
    simulation = simulate(BLOCKS, *people, settings=asked)
    for _ in range(40):
        observation = simulation.observe()
        there = simulation.slots.alive | (simulation.slots.ended != 0)
        assert np.abs(observation[there]).max() <= 1
        simulation.step(rng.uniform(-1, 1, (1, 64, 2)).astype(np.float32))


def test_worlds_do_not_see_each_other() -> None:
    simulation = Simulation(OPEN, worlds=2, settings=Settings(max_alive=2))
    simulation.reset([events(Person()), events(Person(start=(1, 0)))], horizon=9)
    assert (simulation.observe()[:, 0, HEAD:] == 1).all()


def test_an_observation_follows_who_moves() -> None:
    simulation = standing(OPEN, np.array([[0.0, 0.0], [5.0, 0.0]]))
    before = rays_of(simulation, 0)[0]
    place(simulation, np.array([[0.0, 0.0], [4.0, 0.0]]))
    assert rays_of(simulation, 0)[0] * 10 == pytest.approx(before * 10 - 1, abs=1e-5)
