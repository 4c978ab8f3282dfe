"""One default observation, whichever way an environment is made."""

import inspect
from collections.abc import Callable

import numpy as np
import pytest

import crowdbench
from crowdbench.policies import PolicyCard
from crowdbench.run.acting import settings_for
from crowdbench.scene import Scene
from crowdbench.simulation import Settings
from crowdbench.simulation.observations import OBSERVATION, size_of

SIZE = size_of(OBSERVATION, 32)


class Unspecific:
    """A policy that does not say what it sees."""

    name, sees = "unspecific", "observation"

    def reset(self, scene: Scene, rng: np.random.Generator) -> None:
        pass

    def act(self, seen: np.ndarray) -> np.ndarray:
        return np.zeros((len(seen), 2), np.float32)


def default_of(function: Callable[..., object]) -> object:
    return inspect.signature(function).parameters["observation"].default


def test_everything_has_the_same_default_and_it_shows_the_preferred_speed() -> None:
    assert OBSERVATION == "lidar-2"
    assert crowdbench.EnvConfig().observation == OBSERVATION
    assert default_of(crowdbench.demonstrations) == OBSERVATION
    assert Settings().shown.observation == OBSERVATION
    assert settings_for(Unspecific()).observation == OBSERVATION
    env = crowdbench.parallel_env("plaza-v0", horizon_s=10.0)
    assert env.observation_space("person_0").shape == (SIZE,)
    card = PolicyCard(name="x", observation=OBSERVATION, scene="plaza-v0", split="full")
    assert card.inputs == SIZE


def test_so_has_the_torchrl_view() -> None:
    torchrl_env = pytest.importorskip("crowdbench.envs.torchrl_env")
    env = torchrl_env.CrowdEnv("plaza-v0", horizon_s=10.0)
    assert env.observation_spec["agents", "observation"].shape[-1] == SIZE


def test_so_has_the_stable_baselines_view() -> None:
    from conftest import need_imitation

    need_imitation()
    from crowdbench.envs.vec_env import CrowdVecEnv

    env = CrowdVecEnv("plaza-v0", horizon_s=10.0, max_alive=8)
    assert env.observation_space.shape == (SIZE,)
