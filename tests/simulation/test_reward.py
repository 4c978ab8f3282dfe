"""The reward: each of its parts by hand, and their sum in the environment."""

import functools

import numpy as np
import pytest
from given import env_of, run, stand
from worlds import BODY_M, Person, box, events, square

from crowdbench.envs.parallel_env import CrowdParallelEnv
from crowdbench.errors import SettingError
from crowdbench.simulation import Settings, Simulation
from crowdbench.simulation.contact import HEADWAY_S
from crowdbench.simulation.reward import PARTS, Reward, Rewarder, total

STEP_S = 0.4
RADIUS = BODY_M


def only_of(**weights: float) -> Reward:
    return Reward(**{**dict.fromkeys(PARTS, 0.0), **weights})


def only(part: str, weight: float = 1.0) -> Reward:
    return only_of(**{part: weight})


def parts(env: CrowdParallelEnv, infos: dict, name: str = "person_0") -> dict[str, float]:
    return dict(zip(PARTS, infos[name]["reward_parts"], strict=True))


def test_progress_is_metres_up_to_the_preferred_speed_and_arrival_a_step_of_it() -> None:
    env = env_of(
        Person(start=(0.0, 0.0), goal=(3.9, 0.0), speed=1.5),
        reward=only_of(progress=1.0, arrival=1.0),
    )
    env.reset()
    rewards = [env.step(run(env))[1]["person_0"] for _ in range(2)]  # 2 m each
    np.testing.assert_allclose(rewards, [0.6, 0.6 + 0.6], atol=1e-6)


def test_who_was_held_up_is_paid_the_same_metres_later() -> None:
    env = env_of(Person(goal=(9.0, 0.0), speed=1.5), reward=only("progress"))
    env.reset()
    assert env.step(stand(env))[1]["person_0"] == 0.0
    # 1.2 m have fallen due, 2 m are walked.
    assert env.step(run(env))[1]["person_0"] == pytest.approx(1.2, abs=1e-6)
    assert env.step(run(env, (-1.0, 0.0)))[1]["person_0"] == pytest.approx(-1.2, abs=1e-6)


def test_a_slot_s_next_person_has_a_schedule_of_its_own() -> None:
    people = (
        Person(start=(0.0, 0.0), goal=(0.5, 0.0), speed=1.0),
        Person(time_s=0.8, start=(0.0, 0.0), goal=(9.0, 0.0), speed=1.0),
    )
    env = env_of(*people, max_alive=1, reward=only("progress"))
    env.reset()
    env.step(run(env, (0.2, 0.0)))  # the first arrives 0.2 m ahead; the second enters
    assert env.agents == ["person_1"]
    assert env.step(run(env, (0.2, 0.0)))[1]["person_1"] == pytest.approx(0.4, abs=1e-6)


def test_progress_follows_the_way_around_walls() -> None:
    scene = square(10.0, box(1.0, -5.0, 2.0, 5.0))
    people = Person(start=(0.0, 0.0), goal=(4.0, 0.0), speed=1.5)
    for observation, expected in (("lidar-2", 0.6), ("lidar-1", 4.0 - np.hypot(3.88, 0.588))):
        env = env_of(people, scene=scene, reward=only("progress"), observation=observation)
        seen, _ = env.reset()
        way = seen["person_0"][3:5] if observation == "lidar-2" else np.array([0.2, 0.98])
        got = env.step({"person_0": (0.3 * way).astype(np.float32)})[1]["person_0"]
        assert got == pytest.approx(expected, abs=1e-3)


@functools.cache
def paid(preferred_mps: float, *speeds_mps: float, body_radius_m: float = 0.0) -> np.ndarray:
    """What each step of a life pays by the default reward; two at each speed, then at the last."""
    person = Person(start=(-4.0, 0.0), goal=(4.0, 0.0), speed=preferred_mps)
    env = env_of(person, scene=square(body_radius_m=body_radius_m), horizon_s=60.0)
    env.reset()
    rewards: list[float] = []
    while env.agents:
        speed = speeds_mps[min(len(rewards) // 2, len(speeds_mps) - 1)]
        actions = run(env, (speed / env.scene.motion.max_speed_mps, 0.0))
        rewards.append(env.step(actions)[1]["person_0"])
    return np.array(rewards)


def discounted(rewards: np.ndarray, gamma: float) -> float:
    return float(np.sum(rewards * gamma ** np.arange(len(rewards))))


@pytest.mark.parametrize("gamma", [0.0, 0.5, 0.9, 0.98, 0.99, 1.0])
@pytest.mark.parametrize("preferred_mps", [0.8, 1.4])
@pytest.mark.parametrize("body_radius_m", [0.0, RADIUS])
def test_the_preferred_speed_pays_most_whatever_the_discount(
    gamma: float, preferred_mps: float, body_radius_m: float
) -> None:
    factors = np.array([0.0, 0.3, 0.6, 0.8, 0.9, 0.95, 1.0, 1.05, 1.1, 1.3, 1.7, 2.5, 3.5])
    lives = [paid(preferred_mps, preferred_mps * f, body_radius_m=body_radius_m) for f in factors]
    returns = [discounted(life, gamma) for life in lives]
    assert factors[np.argmax(returns)] == 1.0


@pytest.mark.parametrize("seed", range(5))
def test_no_sequence_of_speeds_pays_more(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mixed = paid(1.25, *rng.uniform(0.0, 3.0, rng.integers(2, 7)).round(2).tolist(), 1.25)
    for gamma in (0.5, 0.9, 0.99, 1.0):
        assert discounted(mixed, gamma) <= discounted(paid(1.25, 1.25), gamma) + 1e-5


@pytest.mark.parametrize(("gap", "depth"), [(0.0, 1.0), (0.3, 0.5), (0.6, 0.0), (2.0, 0.0)])
def test_overlap_is_as_deep_as_discs_overlap(gap: float, depth: float) -> None:
    people = (Person(start=(0.0, 0.0)), Person(start=(0.0, gap)))
    env = env_of(*people, reward=only("overlap", -2.0))
    env.reset()
    rewards = env.step(stand(env))[1]
    np.testing.assert_allclose(list(rewards.values()), [-2.0 * depth * STEP_S] * 2, atol=1e-6)


def test_walls_cost_where_they_are_met() -> None:
    scene = square(10.0, box(1.0, -5.0, 2.0, 5.0))
    env = env_of(Person(start=(0.0, 0.0)), scene=scene, reward=only("wall", -0.3))
    env.reset()
    assert env.step(stand(env))[1]["person_0"] == 0.0
    assert env.step(run(env))[1]["person_0"] == pytest.approx(-0.3 * STEP_S)


@pytest.mark.parametrize(("speed_mps", "cost"), [(1.4, 0.0), (1.9, 0.5), (0.9, 0.5), (5.0, 0.98)])
def test_pace_costs_nothing_at_the_preferred_speed_and_is_bounded(
    speed_mps: float, cost: float
) -> None:
    env = env_of(Person(start=(-9.0, 0.0), goal=(9.0, 0.0), speed=1.4), reward=only("pace", -1.0))
    env.reset()
    velocity = np.array([speed_mps / env.scene.motion.max_speed_mps, 0.0], np.float32)
    reward = env.step({"person_0": velocity})[1]["person_0"]
    assert reward == pytest.approx(-cost * 1.4 * STEP_S, abs=2e-3)


@pytest.mark.parametrize(
    ("velocity", "off_m", "cost"),
    [
        ((0.0, 0.0), 0.0, 0.0),
        ((0.0, 0.0), 0.9, 0.0),
        ((0.0, 0.0), 2.0, 0.5),
        ((0.5, 0.0), 0.0, 0.5),
        ((0.5, 0.0), 2.0, 0.75),
    ],
)
def test_who_waits_stands_at_the_stop(
    velocity: tuple[float, float], off_m: float, cost: float
) -> None:
    env = env_of(
        Person(via=(0.0, 0.0), wait_s=60.0, speed=1.2), reward=only_of(stop=-1.0, pace=-1.0)
    )
    env.reset()
    env._simulation.slots.position[0, 0] = 0.0, off_m
    action = np.array(velocity, np.float32) / env.scene.motion.max_speed_mps
    reward = env.step({"person_0": action})[1]["person_0"]
    assert reward == pytest.approx(-cost * 1.2 * STEP_S, abs=4e-3)


@pytest.mark.parametrize(
    ("gap_m", "cost"), [(0.7, 0.0), (1.5, 0.0), (2.5, 0.5), (3.5, 0.8), (40.0, 0.999)]
)
def test_companions_keep_together(gap_m: float, cost: float) -> None:
    scene = square(60.0)
    people = (
        Person(start=(0.0, 0.0), group=3),
        Person(start=(0.0, gap_m), group=3),
        Person(start=(1.0, gap_m / 2)),
        Person(start=(0.0, -45.0), group=4),
    )
    env = env_of(*people, scene=scene, reward=only("companions", -1.0))
    env.reset()
    rewards = list(env.step(stand(env))[1].values())
    np.testing.assert_allclose(rewards[:2], [-cost * STEP_S] * 2, atol=2e-3)
    assert rewards[2:] == [0.0, 0.0]  # nobody is with them


def test_the_nearest_companion_counts() -> None:
    places = [0.0, 1.0, 4.0, 5.0, 5.5, 9.0]
    people = [Person(start=(0.0, y), group=1) for y in places]
    scene = square(60.0)
    env = env_of(*people, scene=scene, reward=only("companions", -1.0))
    env.reset()
    rewards = np.array(list(env.step(stand(env))[1].values()))
    beyond = np.maximum(0, np.array([1.0, 1.0, 1.0, 0.5, 0.5, 3.5]) - 1.5)
    np.testing.assert_allclose(rewards, -STEP_S * beyond**2 / (1 + beyond**2), atol=1e-5)


def test_companions_of_other_worlds_do_not_count() -> None:
    worlds = [
        events(Person(start=(0.0, 0.0), group=1), Person(start=(0.0, 9.0), group=1)),
        events(Person(start=(0.0, 3.0), group=1), Person(start=(0.0, 3.5), group=1)),
    ]
    simulation = Simulation(square(60.0), worlds=2, settings=Settings(max_alive=4))
    simulation.reset(worlds, horizon=10)
    rewarder = Rewarder(only("companions", -1.0))
    simulation.observe()
    simulation.step(np.zeros((2, 4, 2), np.float32))
    simulation.observe()
    found = rewarder(simulation)[..., PARTS.index("companions")]
    assert (found[0, :2] < -0.3).all()
    assert not found[1].any()


def test_the_parts_are_told_and_add_up() -> None:
    scene = square(10.0, box(3.0, -5.0, 4.0, 5.0), body_radius_m=RADIUS)
    people = [
        Person(start=(0.0, 0.2 * k), goal=(0.0, 8.0), via=(0.0, 0.5), wait_s=4.0, group=k // 2)
        for k in range(5)
    ]
    env = env_of(*people, scene=scene)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    seen = set()
    while env.agents:
        actions = {n: rng.uniform(-1, 1, 2).astype(np.float32) for n in env.agents}
        _, rewards, *_, infos = env.step(actions)
        for name in actions:
            of_name = parts(env, infos, name)
            seen |= {part for part, value in of_name.items() if value}
            assert rewards[name] == pytest.approx(sum(of_name.values()), abs=1e-5)
    assert seen == set(PARTS)


def queue(*gaps_m: float, **weights: float) -> CrowdParallelEnv:
    """People who touch or follow each other with these gaps, all on their way to the east."""
    x = -np.cumsum([0.0, *(gap + 2 * RADIUS for gap in gaps_m)])
    people = [Person(start=(float(at), 0.0), goal=(9.0, 0.0), speed=1.25) for at in x]
    reward = only_of(**weights) if weights else Reward()
    return env_of(*people, scene=square(body_radius_m=RADIUS), reward=reward)


def walking(*speeds_mps: float) -> dict[str, np.ndarray]:
    """Actions with which people walk to the east."""
    return {f"person_{k}": np.array([v / 5, 0], np.float32) for k, v in enumerate(speeds_mps)}


@pytest.mark.parametrize(
    ("command_mps", "cost"),
    [(0.0, 0.0), (0.625, 0.5), (1.25, 1.0), (2.5, 1.0)],
    ids=["stands", "at half of its speed", "at its speed", "faster"],
)
def test_pushing_costs_what_bodies_took_away(command_mps: float, cost: float) -> None:
    env = queue(0.0, contact=-0.3)
    env.reset()
    rewards = env.step(walking(0.0, command_mps))[1]
    assert rewards["person_0"] == 0.0  # nobody is in its way
    assert rewards["person_1"] == pytest.approx(-0.3 * STEP_S * cost, rel=0.05)


def test_contact_is_the_share_of_the_way_that_was_lost() -> None:
    env = queue(0.3, contact=-1.0)
    env.reset()
    reward = env.step(walking(0.0, 1.25))[1]["person_1"]
    slots = env._simulation.slots
    lost = 1 - slots.velocity[0, 1, 0] / 1.25
    assert 0.2 < lost < 0.8
    assert slots.held[0, 1] == pytest.approx(lost, abs=1e-5)
    assert reward == pytest.approx(-STEP_S * lost, abs=1e-5)


def test_walls_are_not_contact_with_people() -> None:
    scene = square(10.0, box(1.0, -5.0, 2.0, 5.0), body_radius_m=RADIUS)
    # One alone, and two side by side, whom the same wall stops.
    people = (Person(start=(0.85, 0.0)), Person(start=(0.85, 3.0)), Person(start=(0.85, 3.32)))
    env = env_of(*people, scene=scene, reward=only_of(wall=-1.0, contact=-1.0))
    env.reset()
    for _ in range(5):  # while they try all directions
        *_, infos = env.step(run(env, (0.25, 0.0)))
        for name in env.agents:
            assert parts(env, infos, name)["contact"] == 0.0
    slots = env._simulation.slots
    assert slots.blocked[0, :3].min() > 0.2
    assert parts(env, infos)["wall"] == pytest.approx(-STEP_S)


def test_in_a_queue_standing_costs_no_more_than_pushing() -> None:
    found = []
    for command_mps in (0.0, 0.3, 0.8, 1.25):
        env = queue(0.0, 0.0)
        env.reset()
        *_, infos = env.step(walking(0.0, 0.0, command_mps))
        of_last = parts(env, infos, "person_2")
        assert of_last["pace"] == pytest.approx(0.0, abs=1e-6)
        found.append(of_last["pace"] + of_last["contact"])
    assert found[0] == pytest.approx(0.0, abs=1e-9)
    assert found == sorted(found, reverse=True)
    assert found[3] < -0.09


def test_who_stands_without_somebody_ahead_pays_for_its_pace() -> None:
    env = queue(0.0, 2.0)
    env.reset()
    *_, infos = env.step(walking(0.0, 0.0, 0.0))
    slow = -0.8 * 1.25 * STEP_S * 6.25 / 7.25
    paces = [parts(env, infos, name)["pace"] for name in env.agents]
    np.testing.assert_allclose(paces, [slow, 0.0, slow], atol=1e-5)


def test_who_follows_pays_for_what_it_is_slower_than_those_ahead_admit() -> None:
    gap_m = 0.2
    for speed_mps, cost in ((0.8, 0.0), (0.3, 0.5)):  # both at the same speed keep the gap
        env = queue(gap_m, pace=-1.0)
        env.reset()
        reward = env.step(walking(speed_mps, speed_mps))[1]["person_1"]
        due_mps = gap_m / HEADWAY_S
        assert due_mps == pytest.approx(0.8)
        assert reward == pytest.approx(-cost * 1.25 * STEP_S, abs=2e-3)


def test_a_queue_follows_the_way_around_walls() -> None:
    # The goal is straight behind the wall, and the way to it leads along the wall to the south.
    scene = square(10.0, box(1.0, -2.0, 2.0, 8.0), body_radius_m=RADIUS)
    people = [Person(start=(0.8, y), goal=(4.0, 0.0), speed=1.25) for y in (-0.3, 0.0)]
    env = env_of(*people, scene=scene, reward=only("pace"))
    env.reset()
    rewards = env.step(stand(env))[1]
    assert rewards["person_0"] > 0.3
    assert rewards["person_1"] == pytest.approx(0.0, abs=1e-9)


def test_without_bodies_nothing_is_contact_and_no_pace_is_excused() -> None:
    people = [Person(start=(-0.3 * k, 0.0), goal=(9.0, 0.0), speed=1.25) for k in range(2)]
    env = env_of(*people)
    env.reset()
    *_, infos = env.step(walking(0.0, 0.0))
    for name in env.agents:
        assert parts(env, infos, name)["contact"] == 0.0
        assert parts(env, infos, name)["pace"] == pytest.approx(-0.8 * 0.5 * 6.25 / 7.25)


def test_a_zero_at_the_end_does_not_change_the_sum() -> None:
    seven = np.random.default_rng(0).normal(size=(500, 7)).astype(np.float32)
    eight = np.pad(seven, ((0, 0), (0, 1)))
    assert total(eight).tobytes() == total(seven).tobytes() == seven.sum(axis=1).tobytes()


def test_who_is_born_has_no_reward() -> None:
    env = env_of(Person(), Person(time_s=0.4, start=(0.0, 5.0)))
    env.reset()
    _, rewards, *_, infos = env.step(stand(env))
    assert rewards["person_1"] == 0.0
    assert "reward_parts" not in infos["person_1"]


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_weights_are_numbers(weight: float) -> None:
    with pytest.raises(SettingError, match="pace"):
        Reward(pace=weight)
