"""The crowd as PettingZoo's AECEnv: the same, with agents who act one after the other."""

import numpy as np
import pytest
from pettingzoo.test import api_test

import crowdbench
from crowdbench.errors import SettingError


@pytest.mark.parametrize("scene", ["plaza-v0", "zara1-v0"])
def test_it_passes_pettingzoos_api_test(scene: str) -> None:
    # People come and go in it, and with zara1 the place is empty now and then.
    api_test(crowdbench.aec_env(scene, horizon_s=200.0), num_cycles=40)


def test_it_is_the_parallel_crowd() -> None:
    together, in_turn = (
        make("plaza-v0", horizon_s=20.0, rays=8)
        for make in (crowdbench.parallel_env, crowdbench.aec_env)
    )
    observations, _ = together.reset(seed=5)
    in_turn.reset(seed=5)
    while together.agents:
        there = list(together.agents)
        for agent in there:
            assert in_turn.agent_selection == agent
            assert (in_turn.observe(agent) == observations[agent]).all()
            in_turn.step(observations[agent][3:5])
        observations, rewards, terminated, truncated, infos = together.step(
            {agent: observations[agent][3:5] for agent in there}
        )
        while in_turn.agents and in_turn.agent_selection not in together.agents:
            agent = in_turn.agent_selection
            seen, reward, *ends, info = in_turn.last()
            assert (seen == observations[agent]).all()
            assert (reward, *ends) == (rewards[agent], terminated[agent], truncated[agent])
            assert info == infos[agent]
            in_turn.step(None)
    assert not in_turn.agents
    ours, same = together.trajectories(), in_turn.unwrapped.trajectories()
    assert np.array_equal(ours.xy, same.xy)


def test_what_does_not_fit_is_said() -> None:
    with pytest.raises(SettingError, match="Did you mean `horizon_s`"):
        crowdbench.aec_env("plaza-v0", horizon=3.0)
