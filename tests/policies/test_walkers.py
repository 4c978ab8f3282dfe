"""What the walkers do with what they see."""

from dataclasses import replace

import numpy as np
import pytest
from worlds import FAR, Person, actions_of, box, events, ready, simulate, square, walked

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import SettingError
from crowdbench.policies import (
    Policy,
    Random,
    ReplayPolicy,
    SocialForce,
    SpeedModel,
    StateView,
    Straight,
)
from crowdbench.policies.social_force import PUBLISHED, GroupForce, repulsion, wall_force
from crowdbench.simulation import Settings, Simulation

DT = 0.4
OPEN = square()
WALKERS = (Straight(), Random(), SocialForce(), GroupForce(), SpeedModel())


@pytest.mark.parametrize("policy", WALKERS, ids=lambda p: p.name)
def test_a_policy_acts_for_nobody(policy: Policy) -> None:
    simulation = simulate(OPEN, Person(time_s=9 * DT))
    assert not actions_of(ready(policy, OPEN), simulation).any()


@pytest.mark.parametrize("policy", WALKERS, ids=lambda p: p.name)
def test_walkers_are_policies(policy: object) -> None:
    assert isinstance(policy, Policy)


def test_straight_walkers_keep_their_speed_and_direction() -> None:
    path = walked(Straight(), OPEN, Person(start=(-4, -3), goal=(4, 3), speed=1.5), frames=10)
    along = 1.5 * DT * np.arange(11)[:, None]
    np.testing.assert_allclose(path[:, 0], [-4, -3] + along * [0.8, 0.6], atol=1e-5)


def test_straight_walkers_arrive() -> None:
    simulation = simulate(OPEN, Person(goal=(3.1, 0), speed=1.0))
    policy = ready(Straight(), OPEN)
    while simulation.slots.alive.any():
        simulation.step(actions_of(policy, simulation))
    # The first step whose way comes within 0.3 m of the goal.
    assert int(simulation.clock.frame[0]) == np.ceil((3.1 - 0.3) / (1.0 * DT))


def test_straight_walkers_do_not_pass_their_goal() -> None:
    path = walked(Straight(), OPEN, Person(goal=(0.5, 0), speed=4.0), frames=1)
    np.testing.assert_allclose(path[1, 0], [0.5, 0], atol=1e-6)


def test_straight_walkers_at_their_goal_stand_still() -> None:
    path = walked(Straight(), OPEN, Person(start=(1, 1), goal=(1, 1)), frames=1)
    assert path[1, 0].tolist() == [1, 1]


def crowd_of(size: int) -> StateView:
    index, place = np.arange(size), np.zeros((size, 2), np.float32)
    frame, speed = np.zeros(size, np.int64), np.ones(size, np.float32)
    return StateView(np.zeros(size, np.int64), index, index, index, frame, *[place] * 4,
                     speed, index, 0 * speed)  # fmt: skip


def test_random_actions_fill_the_action_space() -> None:
    actions = ready(Random(), OPEN).act(crowd_of(4000))
    assert (np.abs(actions) <= 1).all()
    np.testing.assert_allclose(np.quantile(actions, [0, 0.25, 0.5, 0.75, 1]), [-1, -0.5, 0, 0.5, 1],
                               atol=0.05)  # fmt: skip


def test_random_actions_come_from_the_seed() -> None:
    seen = crowd_of(5)
    assert (ready(Random(), OPEN).act(seen) == ready(Random(), OPEN).act(seen)).all()


def recording(path: np.ndarray, first: int = 0) -> Trajectories:
    rows = np.arange(len(path))
    return from_rows(scene="drawn", dt_s=DT, person_id=np.zeros_like(rows), frame=rows + first,
                     xy=path, where="test")  # fmt: skip


def test_replay_walks_the_recorded_path() -> None:
    path = np.array([[0, 0], [0.5, 0.2], [0.4, 0.9], [1.0, 1.5], [2.0, 1.0]], np.float32)
    person = Person(goal=(9, 9), scripted=True, leave_frame=4)
    np.testing.assert_allclose(
        walked(ReplayPolicy(recording(path)), OPEN, person, frames=4)[:, 0], path, atol=1e-5
    )


def test_replay_stands_at_the_end_of_its_record() -> None:
    path = np.array([[0, 0], [0.5, 0.2]], np.float32)
    there = walked(ReplayPolicy(recording(path)), OPEN, Person(goal=(9, 9)), frames=4)
    np.testing.assert_allclose(there[1:, 0], [path[1]] * 4, atol=1e-5)


def test_replay_refuses_arrivals_that_it_has_no_record_of() -> None:
    simulation = simulate(OPEN, Person(), Person())
    with pytest.raises(SettingError, match="spawn model replay"):
        actions_of(ready(ReplayPolicy(recording(np.zeros((3, 2)))), OPEN), simulation)


def potential(r: np.ndarray, s: np.ndarray) -> float:
    """V(b) of Helbing & Molnár (1995), eqs. 3, 4 and 13: V⁰ = 2.1 m²/s², σ = 0.3 m."""
    both = np.linalg.norm(r) + np.linalg.norm(r - s)
    return 2.1 * np.exp(-np.sqrt(both**2 - s @ s) / 2 / 0.3)


def downhill(function: object, at: np.ndarray) -> np.ndarray:
    """Minus the numerical gradient."""
    h = 1e-5
    return np.array([(function(at - h * e) - function(at + h * e)) / (2 * h) for e in np.eye(2)])


@pytest.mark.parametrize("seed", range(20))
def test_repulsion_is_the_gradient_of_the_published_potential(seed: int) -> None:
    rng = np.random.default_rng(seed)
    r, s = rng.uniform(-1.5, 1.5, 2), rng.uniform(-2.5, 2.5, 2)
    expected = downhill(lambda x: potential(x, s), r)
    np.testing.assert_allclose(repulsion(*r, *s, PUBLISHED), expected, rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("at", [(1.2, 0.3), (-0.4, -0.2), (1.3, 1.4), (0.5, 1.1)])
def test_a_wall_pushes_along_the_gradient_of_the_published_potential(
    at: tuple[float, float],
) -> None:
    scene = square(10.0, box(0, 0, 1, 1))

    def wall_potential(x: np.ndarray) -> float:
        gap = np.linalg.norm(np.maximum(0, np.maximum(-x, x - 1)))
        return 10.0 * np.exp(-gap / 0.2)

    walls = np.array(scene.wall_of_segment, np.int32)
    got = wall_force(*at, scene.wall_segments, walls, np.arange(len(walls)), PUBLISHED)
    np.testing.assert_allclose(got, downhill(wall_potential, np.array(at)), rtol=1e-4)


def test_each_wall_pushes_once_however_many_edges_it_has() -> None:
    segments = np.array([[0, 0, 1, 0], [1, 0, 2, 0], [0, 5, 2, 5.0]])
    one_wall = np.zeros(2, np.int32)
    one = wall_force(1.0, 0.5, segments[:1] * [[1, 1, 2, 1]], one_wall[:1], np.arange(1), PUBLISHED)
    split = wall_force(1.0, 0.5, segments[:2], one_wall, np.arange(2), PUBLISHED)
    assert split == one


def test_walls_out_of_reach_are_left_out_and_make_no_difference() -> None:
    person = Person(start=(-3.0, 0.4), goal=(8.0, 0.4), velocity=(1.2, 0.0))
    near, far = box(-2, 0.6, -1, 1.6), box(8, 8, 9, 9)
    with_far, without = (
        walked(SocialForce(), square(10.0, *walls), person, frames=10)
        for walls in ((far, near), (near,))
    )
    assert with_far.tolist() == without.tolist()


HEAD_ON = (
    Person(start=(-4, 0.05), goal=(9, 0.05), speed=1.3, velocity=(1.3, 0)),
    Person(start=(4, -0.05), goal=(-9, -0.05), speed=1.3, velocity=(-1.3, 0)),
)


@pytest.mark.parametrize(("policy", "touch"), [(Straight(), True), (SocialForce(PUBLISHED), False)])
def test_who_meets_head_on(policy: Policy, touch: bool) -> None:
    path = walked(policy, OPEN, *HEAD_ON, frames=14)
    gap_m = np.linalg.norm(path[:, 0] - path[:, 1], axis=1)
    assert path[-1, 0, 0] > path[-1, 1, 0]  # they have passed each other
    assert (gap_m.min() < 2 * OPEN.motion.person_radius_m) == touch


def crowd(turn: float = 0.0) -> list[Person]:
    """Twelve people close to each other, turned around the origin."""
    rng = np.random.default_rng(5)
    c, s = np.cos(turn), np.sin(turn)
    rotate = np.array([[c, -s], [s, c]])
    draws = rng.uniform([-2, -2, -8, -8, -1, -1], [2, 2, 8, 8, 1, 1], (12, 6))
    return [
        Person(start=tuple(rotate @ d[:2]), goal=tuple(rotate @ d[2:4]), speed=1.3,
               velocity=tuple(rotate @ d[4:]))
        for d in draws
    ]  # fmt: skip


def social_actions(*worlds: list[Person]) -> np.ndarray:
    simulation = Simulation(OPEN, worlds=len(worlds), settings=Settings(max_alive=12))
    simulation.reset([events(*people) for people in worlds], horizon=FAR)
    return ready(SocialForce(PUBLISHED), OPEN).act(StateView.of(simulation))


@pytest.mark.parametrize("turn", [0.3, np.pi / 2, 2.5])
def test_no_direction_is_special_to_social_force(turn: float) -> None:
    c, s = np.cos(turn), np.sin(turn)
    turned = social_actions(crowd()) @ np.array([[c, s], [-s, c]])
    np.testing.assert_allclose(social_actions(crowd(turn)), turned, atol=1e-4)


def test_social_force_acts_on_each_world_alone() -> None:
    one, other = crowd(), crowd(1.0)[:7]
    together = social_actions(one, other)
    assert together.tolist() == [*social_actions(one).tolist(), *social_actions(other).tolist()]


def test_a_lone_social_walker_relaxes_to_its_preferred_speed() -> None:
    path = walked(SocialForce(), OPEN, Person(start=(-8, 0), goal=(9, 0), speed=1.4), frames=20)
    speed = np.diff(path[:, 0, 0]) / DT
    assert speed[0] < 0.7
    assert speed[-1] == pytest.approx(1.4, rel=1e-3)


def test_social_walkers_are_never_faster_than_1_3_times_their_preference() -> None:
    people = [Person(start=(0.3 * k, 0), goal=(9, 0), speed=1.0) for k in range(6)]
    path = walked(SocialForce(), OPEN, *people, frames=10)
    steps = np.linalg.norm(np.diff(path, axis=0), axis=2)
    assert steps.max() <= 1.3 * DT + 1e-5


@pytest.mark.parametrize("beside_m", [0.0, 1e-3])
def test_people_in_one_place_leave_social_force_finite(beside_m: float) -> None:
    people = [Person(start=(0, y), goal=(0, 0)) for y in (0.0, beside_m)]
    simulation = simulate(OPEN, *people)
    assert np.isfinite(actions_of(ready(SocialForce(), OPEN), simulation)).all()


def test_who_is_behind_counts_half() -> None:
    ahead, behind = (
        social_actions([Person(goal=(9, 0), velocity=(1, 0)), Person(start=(x, 0), goal=(x, 0))])[0]
        for x in (0.6, -0.6)
    )
    alone = social_actions([Person(goal=(9, 0), velocity=(1, 0))])[0]
    assert alone[0] - ahead[0] > 1.2 * (behind[0] - alone[0]) > 0


def grouped(*people: Person, groups: list[int], frames: int = 15) -> np.ndarray:
    """Positions (frames + 1, N, 2) of people whom `GroupForce` walks in these groups."""
    simulation = simulate(OPEN, *people, settings=Settings(max_alive=len(people)))
    of_groups = replace(simulation.events[0], group=np.array(groups, np.int32))
    simulation.reset([of_groups], horizon=1000)
    policy = ready(GroupForce(), OPEN)
    path = [simulation.slots.position[0].copy()]
    for _ in range(frames):
        simulation.step(actions_of(policy, simulation))
        path.append(simulation.slots.position[0].copy())
    return np.array(path)


def test_people_who_are_alone_feel_the_same_forces_with_and_without_groups() -> None:
    people = crowd()
    alone = walked(SocialForce(PUBLISHED), OPEN, *people, frames=3)
    np.testing.assert_array_equal(grouped(*people, groups=[-1] * len(people), frames=3), alone)


@pytest.mark.parametrize("apart_m", [0.7, 3.0])
def test_companions_come_together_and_strangers_move_apart(apart_m: float) -> None:
    pair = [Person(start=(-8, y), goal=(9, y)) for y in (-apart_m / 2, apart_m / 2)]
    together, strangers = (
        np.abs(np.diff(grouped(*pair, groups=groups)[-1, :, 1]))[0] for groups in ([3, 3], [3, -1])
    )
    assert 0.5 < together < 1.1  # a group of two is drawn together from 1 m on
    assert strangers > max(apart_m - 0.01, 1.0)


def test_companions_who_overlap_move_apart() -> None:
    pair = [Person(start=(-8, y), goal=(9, y)) for y in (-0.1, 0.1)]
    last = grouped(*pair, groups=[0, 0])[-1]
    assert np.linalg.norm(last[1] - last[0]) > 0.5
