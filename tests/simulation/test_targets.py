"""Via points: when they are visited, how long they remain the target, and what that changes."""

import numpy as np
import pytest
from given import env_of, run, stand
from worlds import Person, actions_of, box, ended, simulate, square, step

from crowdbench.policies import Policy, Random, SocialForce, SpeedModel, StateView, Straight
from crowdbench.run.episode import generator
from crowdbench.scene import Scene
from crowdbench.simulation import Simulation
from crowdbench.simulation.reward import PARTS, Reward
from crowdbench.simulation.state import GOAL, TIMEOUT, TO_GOAL, TO_VIA, WAITING

DT = 0.4
OPEN = square(50.0)


def stages(simulation: Simulation, velocity: tuple[float, float], steps: int) -> list[int]:
    found = []
    for _ in range(steps):
        step(simulation, {0: velocity})
        found.append(int(simulation.slots.stage[0, 0]))
    return found


def test_the_via_point_is_the_target_until_its_wait_is_over() -> None:
    person = Person(goal=(20.0, 0.0), via=(4.0, 0.0), wait_s=2.0)
    simulation = simulate(OPEN, person)
    assert simulation.slots.target[0, 0].tolist() == [4.0, 0.0]
    # Three metres at 0.4 m a step lead to 1 m from it; then five frames of waiting.
    found = stages(simulation, (1.0, 0.0), 8)
    assert found == [TO_VIA] * 7 + [WAITING]
    assert stages(simulation, (0.0, 0.0), 5) == [WAITING] * 4 + [TO_GOAL]
    assert simulation.slots.target[0, 0].tolist() == [20.0, 0.0]


def test_without_a_wait_the_goal_is_next_at_once() -> None:
    simulation = simulate(OPEN, Person(goal=(20.0, 0.0), via=(2.0, 0.0)))
    assert stages(simulation, (1.0, 0.0), 3) == [TO_VIA, TO_VIA, TO_GOAL]


def test_whoever_walks_over_a_via_point_within_a_step_has_visited_it() -> None:
    simulation = simulate(OPEN, Person(goal=(20.0, 0.0), via=(1.0, 0.0), start=(-0.1, 0.0)))
    assert stages(simulation, (5.0, 0.0), 1) == [TO_GOAL]


@pytest.mark.parametrize(("aside", "visited"), [(2.5, True), (3.5, False)])
def test_a_via_point_that_is_passed_nearby_has_been_visited(aside: float, visited: bool) -> None:
    simulation = simulate(OPEN, Person(start=(0.0, aside), goal=(30.0, 0.0), via=(10.0, 0.0)))
    found = stages(simulation, (2.0, 0.0), 14)  # to x = 11.2 m, parallel to the way
    assert (found[-1] == TO_GOAL) == visited


def test_a_via_point_that_comes_no_closer_is_given_up_after_30_s() -> None:
    wall = box(5.0, -50.0, 5.5, 50.0)  # the point behind it cannot be reached
    simulation = simulate(square(50.0, wall), Person(goal=(-9.0, 0.0), via=(10.0, 0.0), wait_s=9.0))
    found = stages(simulation, (1.0, 0.0), 100)
    # It stops coming closer at the wall, after 13 steps; CLOSER_M of these count for two.
    assert TO_GOAL not in found[:75]
    assert found[-1] == TO_GOAL
    assert WAITING not in found


def test_the_goal_does_not_end_a_trip_before_the_via_point_has_been_visited() -> None:
    round_trip = Person(start=(0.0, 0.0), goal=(0.5, 0.0), via=(3.0, 0.0))
    simulation = simulate(OPEN, round_trip)
    for _ in range(5):
        step(simulation, {0: (1.0, 0.0)})
        assert not ended(simulation)
    how: dict[int, int] = {}
    for _ in range(5):
        step(simulation, {0: (-1.0, 0.0)})
        how |= ended(simulation)
    assert how == {0: GOAL}


def test_the_time_limit_grows_by_the_wait() -> None:
    scene = square(dwell_p99_s=2.0)  # a limit of 4 s, ten frames
    simulation = simulate(scene, Person(via=(0.0, 0.0), wait_s=2.0), Person())
    over = {}
    for frame in range(1, 16):
        step(simulation)
        over |= {person: (frame, how) for person, how in ended(simulation).items()}
    assert over == {1: (10, TIMEOUT), 0: (15, TIMEOUT)}


def test_observations_point_to_the_target() -> None:
    simulation = simulate(OPEN, Person(start=(0.0, 0.0), goal=(9.0, 0.0), via=(0.0, 6.0)))
    seen = simulation.observe()[0, 0]
    np.testing.assert_allclose(seen[2:5], [6 / 30, 0, 1], atol=1e-6)
    stages(simulation, (0.0, 2.0), 7)
    seen = simulation.observe()[0, 0]
    assert seen[3] > 0.8
    assert seen[4] < 0


def test_routes_lead_around_walls_to_each_target() -> None:
    scene = square(20.0, box(-1.0, -8.0, 1.0, 8.0))
    person = Person(start=(-5.0, 0.0), goal=(-5.0, -1.0), via=(5.0, 0.0), speed=1.5)
    simulation, policy = simulate(scene, person), Straight()
    policy.reset(scene, generator(0, 0, "policy"))
    furthest = 0.0
    while simulation.slots.alive[0, 0]:
        simulation.step(actions_of(policy, simulation))
        furthest = max(furthest, float(simulation.slots.position[0, 0, 0]))
    assert simulation.slots.ended[0, 0] == GOAL
    assert furthest > 3.9


@pytest.mark.parametrize("policy", [Straight(), SocialForce(), SpeedModel()])
def test_walkers_stay_at_a_via_point_for_the_wait(policy: Policy) -> None:
    person = Person(start=(0.0, 0.0), goal=(9.0, 0.0), via=(4.0, 0.0), wait_s=8.0, speed=1.2)
    simulation = simulate(OPEN, person)
    policy.reset(OPEN, generator(0, 0, "policy"))
    path = []
    while simulation.slots.alive[0, 0]:
        simulation.step(actions_of(policy, simulation))
        path.append(simulation.slots.position[0, 0].copy())
    near = np.linalg.norm(np.array(path) - [4.0, 0.0], axis=1) <= 1.0
    assert 8.0 <= near.sum() * DT <= 10.5
    assert np.linalg.norm(np.diff(np.array(path)[near][6:-3], axis=0), axis=1).max() < 0.1


def test_nobody_is_forced_to_visit_or_to_stand() -> None:
    simulation, policy = simulate(OPEN, Person(via=(3.0, 3.0), wait_s=30.0)), Random()
    policy.reset(OPEN, generator(0, 0, "policy"))
    before = simulation.slots.position[0, 0].copy()
    for _ in range(20):
        simulation.step(actions_of(policy, simulation))
        assert not np.array_equal(before, simulation.slots.position[0, 0])
        before = simulation.slots.position[0, 0].copy()


def test_state_policies_see_target_and_goal() -> None:
    simulation = simulate(OPEN, Person(goal=(9.0, 0.0), via=(3.0, 0.0)), Person(goal=(8.0, 0.0)))
    view = StateView.of(simulation)
    assert view.target.tolist() == [[3.0, 0.0], [8.0, 0.0]]
    assert view.goal.tolist() == [[9.0, 0.0], [8.0, 0.0]]


def reward_of(
    person: Person, velocities: list[tuple[float, float] | None], scene: Scene | None = None
) -> list[list[float]]:
    env = env_of(person, scene=scene, reward=Reward(progress=1.0, arrival=0.0, pace=-1.0))
    env.reset()
    found = []
    for velocity in velocities:
        infos = env.step(stand(env) if velocity is None else run(env, velocity))[4]
        found.append(infos["person_0"]["reward_parts"])
    return found


def test_progress_continues_when_the_target_changes() -> None:
    # run() takes shares of the maximum speed of 5 m/s: 0.2 is 1 m/s.
    person = Person(start=(0.0, 0.0), goal=(9.0, 0.0), via=(2.0, 0.0), speed=1.0)
    found = reward_of(person, [(0.2, 0.0)] * 8)
    progress = [dict(zip(PARTS, parts, strict=True))["progress"] for parts in found]
    np.testing.assert_allclose(progress, 0.4, atol=1e-5)


def test_giving_up_is_no_progress() -> None:
    # The way around the wall is far longer than the straight line through it.
    wall = box(5.0, -20.0, 5.5, 20.0)
    person = Person(start=(4.0, 0.0), goal=(-9.0, 0.0), via=(8.5, 0.0), wait_s=9.0, speed=1.0)
    found = reward_of(person, [None] * 90, square(50.0, wall))
    progress = [parts[PARTS.index("progress")] for parts in found]
    np.testing.assert_allclose(progress, 0.0, atol=1e-5)


def test_whoever_stands_while_waiting_loses_nothing_and_whoever_runs_does() -> None:
    person = Person(start=(0.0, 0.0), goal=(9.0, 0.0), via=(1.2, 0.0), wait_s=4.0, speed=1.0)
    stood = reward_of(person, [(0.2, 0.0), None, None, None])
    ran = reward_of(person, [(0.2, 0.0), (0.2, 0.0), (-0.2, 0.0), (0.2, 0.0)])
    at = PARTS.index("progress"), PARTS.index("stop")
    for of_step in stood[1:]:
        np.testing.assert_allclose([of_step[k] for k in at], 0.0, atol=1e-6)
    assert all(of_step[at[1]] < -0.2 for of_step in ran[1:])
    assert sum(of_step[at[0]] for of_step in ran[1:]) <= 0.8 + 1e-6
