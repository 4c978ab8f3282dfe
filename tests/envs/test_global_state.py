"""The state for centralised critics: everyone who is present, by slot."""

import numpy as np
from given import env_of, run
from worlds import Person, square

import crowdbench
from crowdbench.envs.global_state import (
    POSITION,
    PREFERRED_SPEED,
    PRESENT,
    SIZE,
    TARGET,
    VELOCITY,
    WAITS,
)


def test_the_state_is_that_of_everyone_present() -> None:
    people = (
        Person(start=(0.0, 0.0), goal=(10.0, 0.0), speed=1.5),
        Person(start=(-5.0, 5.0), via=(-5.0, 5.0), wait_s=9.0),
    )
    env = env_of(*people, scene=square(20.0), max_alive=4)
    env.reset()
    assert env.state_space.shape == (4, SIZE)
    assert env.state_space.contains(env.state())
    env.step(run(env, (0.2, 0.0)))  # 1 m/s of 5 m/s
    state = env.state()
    half = 20.0
    assert state[:, PRESENT].ravel().tolist() == [1, 1, 0, 0]
    np.testing.assert_allclose(state[0, POSITION], [0.4 / half, 0.0], atol=1e-6)
    np.testing.assert_allclose(state[0, VELOCITY], [0.2, 0.0], atol=1e-6)
    np.testing.assert_allclose(state[0, TARGET], [10.0 / half, 0.0], atol=1e-6)
    np.testing.assert_allclose(state[:2, PREFERRED_SPEED].ravel(), [0.3, 0.2], atol=1e-6)
    assert state[:2, WAITS].ravel().tolist() == [0, 1]
    assert not state[2:].any()


def test_the_state_stays_in_its_space_for_a_whole_episode() -> None:
    env = crowdbench.parallel_env("plaza-v0", horizon_s=30.0, max_alive=32)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    while env.agents:
        env.step({name: rng.uniform(-1, 1, 2).astype(np.float32) for name in env.agents})
        state = env.state()
        assert env.state_space.contains(state)
        assert state[:, PRESENT].sum() == len(env.agents)


def test_torchrl_has_the_same_state() -> None:
    from crowdbench.torchrl_env import CrowdEnv

    env = CrowdEnv("plaza-v0", worlds=2, max_alive=32, horizon_s=20.0, seed=0)
    found = env.rollout(20)
    state = env.state()
    assert state.shape == (2, 32, SIZE)
    mask = found["next", "agents", "mask"][:, -1]
    assert (state[..., 0].bool() == mask).all()
