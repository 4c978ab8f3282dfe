"""Ids: whoever imports crowdbench can make its environments by gymnasium and by PettingZoo."""

import subprocess
import sys

import gymnasium
import pettingzoo
import pytest
from conftest import need_sb3

import crowdbench
from crowdbench.envs.parallel_env import CrowdParallelEnv
from crowdbench.envs.person_env import PersonEnv

REGISTERS = hasattr(pettingzoo, "register")
IDS = {f"crowdbench/{scene}" for scene in crowdbench.list_scenes()}


def printed_by(code: str) -> list[str]:
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.split()


@pytest.mark.parametrize(
    "imports",
    [
        "import crowdbench, gymnasium",
        "import gymnasium, crowdbench",
        "import importlib.util; import crowdbench; importlib.util.find_spec('gymnasium'); "
        "import gymnasium; crowdbench.envs.registration.register_on_import()",
        # What `make` does with a name in front of the id.
        "import gymnasium; gymnasium.envs.registration._find_spec('crowdbench:crowdbench/eth-v0')",
    ],
    ids=["before", "after", "looked for", "named"],
)
def test_every_scene_is_registered_whenever_gymnasium_is_imported(imports: str) -> None:
    code = f"{imports}; print(*[i for i in gymnasium.registry if i.startswith('crowdbench/')])"
    assert set(printed_by(code)) >= IDS


def test_a_library_that_was_watched_has_its_own_loader_again() -> None:
    code = (
        "import crowdbench, gymnasium; from importlib.resources import files; "
        "print(type(gymnasium.__loader__).__name__, type(gymnasium.__spec__.loader).__name__, "
        "files('gymnasium').joinpath('__init__.py').is_file())"
    )
    assert printed_by(code) == ["SourceFileLoader", "SourceFileLoader", "True"]


def test_gymnasium_makes_one_by_the_name_of_the_package() -> None:
    env = gymnasium.make("crowdbench:crowdbench/plaza-v0", horizon_s=60.0)
    assert isinstance(env.unwrapped, PersonEnv)
    assert env.unwrapped.scene.id == "plaza-v0"
    env.reset(seed=0)
    env.close()


@pytest.mark.skipif(not REGISTERS, reason="PettingZoo has `make` from 1.27 on")
def test_pettingzoo_makes_both_kinds() -> None:
    assert set(pettingzoo.parallel_registry) >= IDS
    env = pettingzoo.make("parallel", "crowdbench/plaza-v0", horizon_s=60.0)
    assert isinstance(env, CrowdParallelEnv)
    in_turn = pettingzoo.make("aec", "crowdbench/plaza_v0", horizon_s=60.0, render_mode="rgb_array")
    env.reset(seed=3)
    in_turn.reset(seed=3)
    assert env.agents == in_turn.agents
    assert in_turn.unwrapped.scene.id == "plaza-v0"
    assert in_turn.render().shape[2] == 3


def test_stable_baselines_takes_an_id() -> None:
    need_sb3()
    from stable_baselines3 import PPO

    model = PPO("MlpPolicy", "crowdbench/plaza-v0", n_steps=64, device="cpu", seed=0)
    model.learn(64)
    assert model.num_timesteps == 64
