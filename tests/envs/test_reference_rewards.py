"""What shipped policies earn in an environment."""

import numpy as np
import pytest
from given import Given
from worlds import Person, square

import crowdbench
from crowdbench.envs.parallel_env import parallel_env
from crowdbench.envs.reference_rewards import REFERENCES
from crowdbench.errors import SettingError
from crowdbench.simulation.observations import GOAL_DIRECTION, PREFERRED_SPEED


def test_a_straight_walker_earns_its_way_and_the_arrival() -> None:
    walker = Given(Person(start=(-4.0, 0.0), goal=(4.0, 0.0), speed=1.0, velocity=(1.0, 0.0)))
    [earned] = crowdbench.reference_rewards(
        square(), spawn=walker, policies=["straight"], worlds=1, max_alive=4, horizon_s=40.0
    ).values()
    radius = square().motion.goal_radius_m
    # All of the way to the disc around the goal, at the preferred speed, and one step for arriving.
    assert earned.per_trip == pytest.approx(8.0 - radius + 0.4, abs=0.41)
    assert 0.38 < earned.per_step < 0.5


def test_rewards_are_those_of_the_environment() -> None:
    [earned] = crowdbench.reference_rewards(
        "plaza-v0", policies=["straight"], worlds=1, seconds=60.0, seed=3
    ).values()
    env = parallel_env("plaza-v0", horizon_s=60.0)
    observations, _ = env.reset(seed=3)
    steps, trips, born = [], [], set()
    collected: dict[str, float] = {}
    first = set(observations)
    while env.agents:
        actions = {
            agent: observations[agent][PREFERRED_SPEED] * observations[agent][GOAL_DIRECTION]
            for agent in env.agents
        }
        observations, rewards, terminations, truncations, _ = env.step(actions)
        for agent, reward in rewards.items():
            if agent not in actions:
                born.add(agent)
                collected[agent] = 0.0
                continue
            steps.append(reward)
            collected[agent] = collected.get(agent, 0.0) + reward
            if (terminations[agent] or truncations[agent]) and agent in born - first:
                trips.append(collected[agent])
    assert earned.per_step == pytest.approx(np.mean(steps), rel=0.05)
    assert len(trips) > 3


def test_walkers_to_goals_earn_more_than_random_ones_and_seeds_repeat() -> None:
    earned = crowdbench.reference_rewards("eth-v0", seconds=60.0, worlds=2)
    assert tuple(earned) == REFERENCES
    assert earned["straight"].per_trip > earned["random"].per_trip
    assert earned["social-force"].per_step > 0 > earned["random"].per_step
    assert earned == crowdbench.reference_rewards("eth-v0", seconds=60.0, worlds=2)


def test_without_a_trip_there_is_no_mean_over_trips() -> None:
    [earned] = crowdbench.reference_rewards("plaza-v0", policies=["straight"], seconds=0.8).values()
    assert np.isnan(earned.per_trip)
    assert np.isfinite(earned.per_step)
    [earned] = crowdbench.reference_rewards(
        square(), spawn=Given(), policies=["straight"], worlds=1, max_alive=4, horizon_s=4.0
    ).values()
    assert np.isnan(earned).all()


def test_what_does_not_fit_is_said() -> None:
    with pytest.raises(SettingError, match="seconds"):
        crowdbench.reference_rewards("plaza-v0", seconds=0.0)
    with pytest.raises(SettingError, match="spawning"):
        crowdbench.reference_rewards("plaza-v0", spawning="poisson-gmm")
