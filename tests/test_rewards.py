"""The reward: each of its parts by hand, and their sum in the environment."""

import numpy as np
import pytest
from given import env_of, run, stand
from worlds import Person, box, square

from crowdbench.environment import CrowdParallelEnv
from crowdbench.errors import SettingError
from crowdbench.rewards import PARTS, Reward

STEP_S = 0.4


def only(part: str, weight: float = 1.0) -> Reward:
    return Reward(**{name: weight if name == part else 0.0 for name in PARTS})


def parts(env: CrowdParallelEnv, infos: dict, name: str = "person_0") -> dict[str, float]:
    return dict(zip(PARTS, infos[name]["reward_parts"], strict=True))


def test_progress_is_metres_and_arrival_is_once() -> None:
    env = env_of(
        Person(start=(0.0, 0.0), goal=(3.9, 0.0)), reward=Reward(overlap=0.0, wall=0.0, effort=0.0)
    )
    env.reset()
    rewards = [env.step(run(env))[1]["person_0"] for _ in range(2)]
    np.testing.assert_allclose(rewards, [2.0, 1.9 - 0.1 + 1.0], atol=1e-6)


@pytest.mark.parametrize(("gap", "depth"), [(0.0, 1.0), (0.3, 0.5), (0.6, 0.0), (2.0, 0.0)])
def test_overlap_is_as_deep_as_discs_overlap(gap: float, depth: float) -> None:
    people = (Person(start=(0.0, 0.0)), Person(start=(0.0, gap)))
    env = env_of(*people, reward=only("overlap", -2.0))
    env.reset()
    rewards = env.step(stand(env))[1]
    np.testing.assert_allclose(list(rewards.values()), [-2.0 * depth] * 2, atol=1e-6)


def test_walls_cost_where_they_are_met() -> None:
    scene = square(10.0, box(1.0, -5.0, 2.0, 5.0))
    env = env_of(Person(start=(0.0, 0.0)), scene=scene, reward=only("wall", -0.3))
    env.reset()
    assert env.step(stand(env))[1]["person_0"] == 0.0
    assert env.step(run(env))[1]["person_0"] == pytest.approx(-0.3)


@pytest.mark.parametrize("speed_mps", [0.0, 1.33, 5.0])
def test_effort_is_the_energy_of_walking(speed_mps: float) -> None:
    env = env_of(Person(start=(-9.0, 0.0), goal=(9.0, 0.0)), reward=only("effort", -1.0))
    env.reset()
    velocity = np.array([speed_mps / env.scene.motion.max_speed_mps, 0.0], np.float32)
    reward = env.step({"person_0": velocity})[1]["person_0"]
    assert reward == pytest.approx(-(2.23 + 1.26 * speed_mps**2) * STEP_S, rel=1e-5)


def test_per_metre_the_least_effort_is_at_133_cm_a_second() -> None:
    speeds = np.linspace(0.5, 3.0, 251)
    assert speeds[np.argmin((2.23 + 1.26 * speeds**2) / speeds)] == pytest.approx(1.33, abs=0.01)


def test_the_parts_are_told_and_add_up() -> None:
    scene = square(10.0, box(3.0, -5.0, 4.0, 5.0))
    people = [Person(start=(0.0, 0.2 * k), goal=(0.0, 8.0)) for k in range(5)]
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


def test_who_is_born_has_no_reward() -> None:
    env = env_of(Person(), Person(time_s=0.4, start=(0.0, 5.0)))
    env.reset()
    _, rewards, *_, infos = env.step(stand(env))
    assert rewards["person_1"] == 0.0
    assert "reward_parts" not in infos["person_1"]


@pytest.mark.parametrize("weight", [float("nan"), float("inf")])
def test_weights_are_numbers(weight: float) -> None:
    with pytest.raises(SettingError, match="effort"):
        Reward(effort=weight)
