"""The settings that the environments have in common, and rewards of a user's own."""

from dataclasses import fields, replace
from pathlib import Path
from typing import get_type_hints

import numpy as np
import pytest
import torch
from given import Given, env_of, run, stand
from worlds import Person, square

import crowdbench
from crowdbench import EnvConfig
from crowdbench.envs.config import EnvSettings
from crowdbench.errors import OwnCodeError, SettingError
from crowdbench.simulation.reward import PARTS, Reward, Rewarder
from crowdbench.simulation.state import CrowdState

PAIR = (Person(start=(0.0, 0.0), goal=(9.0, 0.0)), Person(start=(0.0, 3.0), goal=(9.0, 3.0)))
DOCS = Path(__file__).parents[2] / "docs"


def test_a_config_and_the_same_keywords_make_the_same_environment() -> None:
    asked = {"spawn": Given(*PAIR), "horizon_s": 8.0, "rays": 4, "max_alive": 4}
    config = EnvConfig(**asked)
    seen = [
        crowdbench.parallel_env(square(), *given, max_persons=8, **keywords).reset(seed=1)[0]
        for given, keywords in (((config,), {}), ((), asked))
    ]
    for agent, numbers in seen[0].items():
        assert numbers.tobytes() == seen[1][agent].tobytes()


def test_keywords_replace_the_values_of_a_config() -> None:
    config = EnvConfig(horizon_s=8.0, rays=4)
    env = crowdbench.parallel_env("plaza-v0", config, rays=16)
    assert (env.frames, len(env.observation_space("person_0").low)) == (20, 6 + 16)
    assert config.rays == 4


@pytest.mark.parametrize(
    ("wrong", "nearest"), [("horizon", "horizon_s"), ("max_person", "max_persons")]
)
def test_a_wrong_keyword_is_answered_with_the_nearest_one(wrong: str, nearest: str) -> None:
    with pytest.raises(SettingError, match=rf"setting '{wrong}'.*spawn.*Did you mean `{nearest}`"):
        crowdbench.parallel_env("plaza-v0", **{wrong: 1})


def test_type_checkers_know_every_field_as_a_keyword() -> None:
    assert get_type_hints(EnvSettings) == get_type_hints(EnvConfig)


def test_each_environment_names_its_own_keywords() -> None:
    pytest.importorskip("torchrl")
    from crowdbench.torchrl_env import CrowdEnv

    with pytest.raises(
        SettingError, match=r"CrowdEnv: .*worlds, seed, device, render_mode\. Did .*`worlds`"
    ):
        CrowdEnv("plaza-v0", world=2)
    with pytest.raises(SettingError, match="'max_persons'"):
        CrowdEnv("plaza-v0", max_persons=2)


def test_values_out_of_range_are_refused_before_a_scene_is_loaded() -> None:
    with pytest.raises(SettingError, match="Did you mean `stationary`"):
        EnvConfig(start="stationery")  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="expected 'error' or 'drop'"):
        EnvConfig(on_full=None)  # type: ignore[arg-type]
    with pytest.raises(SettingError, match="expected Reward or a function"):
        EnvConfig(reward=1.0)  # type: ignore[arg-type]


def test_the_page_lists_every_field() -> None:
    text = (DOCS / "environment.md").read_text()
    table = text[text.index("| field |") : text.index("## Agents")]
    assert [f.name for f in fields(EnvConfig) if f"`{f.name}`" not in table] == []


def eastward(crowd: CrowdState) -> np.ndarray:
    """Two parts: metres per second to the east, and 1 for everyone, whether he acted or not."""
    return np.stack([crowd.slots.velocity[..., 0], np.ones(crowd.slots.alive.shape)], axis=-1)


def test_a_function_is_the_reward_of_the_parallel_environment() -> None:
    env = env_of(*PAIR, reward=eastward)
    env.reset()
    _, rewards, _, _, infos = env.step(run(env, (0.2, 0.0)))
    speed = infos["person_0"]["reward_parts"][0]
    assert speed > 0.3
    assert infos["person_0"]["reward_parts"] == [speed, 1.0]
    assert rewards == pytest.approx(dict.fromkeys(("person_0", "person_1"), speed + 1.0))


def test_the_torchrl_environment_takes_a_function_and_counts_its_parts() -> None:
    pytest.importorskip("torchrl")
    from torchrl.envs.utils import check_env_specs

    from crowdbench.torchrl_env import CrowdEnv, SlotEnv

    asked = {"spawn": Given(*PAIR), "max_alive": 4, "rays": 4, "horizon_s": 8.0, "seed": 0}
    for kind in (CrowdEnv, SlotEnv):
        check_env_specs(kind(square(), reward=eastward, **asked))
    env = CrowdEnv(square(), reward=eastward, **asked)
    now = env.reset()
    now["agents", "action"] = torch.full((1, 4, 2), 0.2)
    after = env.step(now)["next", "agents"]
    acted = now["agents", "mask"]
    assert acted.sum() == 2
    assert (after["reward_parts"][..., 1] == acted).all()  # zero where nobody acted
    assert (after["reward"][..., 0] == after["reward_parts"].sum(dim=-1)).all()


def test_the_vector_environment_takes_a_function() -> None:
    pytest.importorskip("stable_baselines3")
    from crowdbench.vec_env import CrowdVecEnv

    config = EnvConfig(spawn=Given(*PAIR), horizon_s=8.0, rays=4, max_alive=4, reward=eastward)
    env = CrowdVecEnv(square(), 2, config, worlds=1, seed=0)
    env.reset()
    _, rewards, _, infos = env.step(np.full((2, 2), 0.2, np.float32))
    np.testing.assert_allclose(rewards, [sum(info["reward_parts"]) for info in infos])
    assert (rewards > 1.3).all()


def test_the_vector_environment_drops_people_if_asked_to() -> None:
    pytest.importorskip("stable_baselines3")
    from crowdbench.vec_env import CrowdVecEnv

    asked = {"spawn": Given(*PAIR), "horizon_s": 8.0, "rays": 4, "worlds": 1, "max_alive": 1}
    assert CrowdVecEnv(square(), 1, on_full="drop", **asked).reset().shape == (1, 10)


def test_a_part_is_added_to_the_usual_reward_in_every_episode() -> None:
    weights = Reward(pace=-0.4)
    usual = Rewarder(weights)

    def longer(crowd: CrowdState) -> np.ndarray:
        parts = usual(crowd)
        return np.concatenate([parts, np.full((*parts.shape[:2], 1), 0.5)], axis=-1)

    plain, own = env_of(*PAIR, reward=weights), env_of(*PAIR, reward=longer)
    for _ in range(2):  # with schedules of its own in each
        plain.reset(seed=0)
        own.reset(seed=0)
        for step in range(3):
            actions = (stand, run)[step % 2]
            of_plain = plain.step(actions(plain))[4]["person_0"]["reward_parts"]
            of_own = own.step(actions(own))[4]["person_0"]["reward_parts"]
            assert of_own == [*of_plain, 0.5]
    assert len(of_plain) == len(PARTS)


def test_a_new_episode_is_told_from_the_one_before() -> None:
    seen = []

    def reward(crowd: CrowdState) -> np.ndarray:
        seen.append(int(crowd.episode[0]))
        return crowd.slots.speed[..., None]

    env = env_of(*PAIR, reward=reward)
    for _ in range(2):
        env.reset()
        env.step(stand(env))
    assert seen[1] == seen[0] + 1


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda crowd: crowd.slots.speed, r"shape \(1, 8\).*Return reward\[\.\.\., None\]"),
        (lambda crowd: crowd.slots.speed[..., None] * np.nan, "2 values that are not finite"),
        (lambda crowd: 1 / 0, r"ZeroDivisionError.*test_config\.py"),
    ],
)
def test_what_is_wrong_with_a_function_is_said(function: object, message: str) -> None:
    env = env_of(*PAIR, reward=function)
    env.reset()
    with pytest.raises(OwnCodeError, match=rf"reward: got .*{message}"):
        env.step(stand(env))


def test_a_config_can_be_changed_and_is_checked_again() -> None:
    with pytest.raises(SettingError, match="horizon_s"):
        replace(EnvConfig(), horizon_s=-1.0)
