"""Nothing that an environment returns is NaN or infinite, whoever enters and however they walk."""

from dataclasses import replace

import numpy as np
import pytest
from given import env_of, stand
from worlds import Person

from crowdbench import list_scenes, parallel_env
from crowdbench.envs.parallel_env import CrowdParallelEnv
from crowdbench.registry import fitted_models
from crowdbench.scene import load_scene
from crowdbench.simulation.observations import BUILT_IN

HORIZON_S = 600.0
MORE_STEPS = {"gc-v0": 200}
"""Fewer in Grand Central, where hundreds of people who never arrive make a step slow."""
EXTREME = float(np.finfo(np.float32).max)
MODELS = [(scene, model) for scene in list_scenes() for model in fitted_models(load_scene(scene))]


def actions_of(env: CrowdParallelEnv, rng: np.random.Generator) -> dict[str, np.ndarray]:
    """A third of the people act at random, a third stands, a third acts as hard as it can."""
    actions = {}
    for name in env.agents:
        drawn = rng.uniform(-1, 1, 2)
        kind = int(name.removeprefix("person_")) % 3
        action = (drawn, np.zeros(2), np.sign(drawn) * EXTREME)[kind]
        actions[name] = action.astype(np.float32)
    return actions


def assert_finite(env: CrowdParallelEnv, steps: int, seed: int) -> int:
    """Let people walk through whole episodes for at least so many steps; returns the persons."""
    rng = np.random.default_rng(seed)
    persons = 0
    while steps > 0:
        observations, infos = env.reset(seed=seed)
        seen = set(env.agents)
        while env.agents and steps > 0:
            observations, rewards, _, _, infos = env.step(actions_of(env, rng))
            assert np.isfinite(list(rewards.values())).all(), rewards
            for name, observation in observations.items():
                assert (np.abs(observation) <= 1).all(), (name, observation)  # false for NaN
                assert np.isfinite(infos[name].get("reward_parts", 0.0)).all(), infos[name]
            seen |= set(env.agents)
            steps -= 1
        assert (np.abs(env.state()) <= 1).all()
        persons += len(seen)
        seed += 1
    return persons


@pytest.mark.parametrize(
    ("scene", "model", "observation"),
    [(scene, model, BUILT_IN[k % len(BUILT_IN)]) for k, (scene, model) in enumerate(MODELS)],
)
def test_rewards_observations_and_states_are_finite(
    scene: str, model: str, observation: str
) -> None:
    env = parallel_env(scene, spawn=model, observation=observation, horizon_s=HORIZON_S)
    assert assert_finite(env, steps=400, seed=0) > 0


@pytest.mark.nightly
@pytest.mark.parametrize("observation", BUILT_IN)
@pytest.mark.parametrize(("scene", "model"), MODELS)
def test_they_are_for_many_more_steps(scene: str, model: str, observation: str) -> None:
    # The warm-up of Grand Central would take longer than the steps.
    env = parallel_env(
        scene, spawn=model, observation=observation, horizon_s=HORIZON_S, start="empty"
    )
    assert assert_finite(env, steps=MORE_STEPS.get(scene, 1_000), seed=1) > 0


@pytest.mark.parametrize(
    "entering", [Person(via=(0.0, 0.0), wait_s=60.0, speed=1.2), Person(speed=1.2)]
)
@pytest.mark.parametrize(
    "before", [Person(via=(5.0, 0.0), wait_s=9.0, leave_frame=3), Person(goal=(0.1, 0.0))]
)
def test_who_enters_after_empty_frames_is_paid_as_anyone(before: Person, entering: Person) -> None:
    """Whatever the way on which its slot's last owner was."""
    env, alone = env_of(before, replace(entering, time_s=20.0), max_alive=1), env_of(entering)
    env.reset()
    while "person_1" not in env.agents:
        _, _, _, _, infos = env.step(stand(env))
    assert infos["person_1"]["frames_skipped"] > 0
    alone.reset()
    for _ in range(3):
        expected = alone.step(stand(alone))[1]["person_0"]
        assert env.step(stand(env))[1]["person_1"] == expected
