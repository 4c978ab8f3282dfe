"""The PettingZoo view: the API's contract, in whole episodes of the scenes."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test

from crowdbench.environment import CrowdParallelEnv, parallel_env
from crowdbench.policies import StateView, Straight
from crowdbench.rollouts import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn import Replay
from crowdbench.trajectories import OUTCOMES

SCENES = ("eth-v0", "plaza-v0")


@dataclass(frozen=True)
class Step:
    """What one call of `step` did."""

    before: list[str]
    after: list[str]
    observations: dict[str, np.ndarray]
    rewards: dict[str, float]
    terminations: dict[str, bool]
    truncations: dict[str, bool]
    infos: dict[str, dict[str, Any]]

    @property
    def done(self) -> set[str]:
        return {n for n in self.before if self.terminations[n] or self.truncations[n]}

    @property
    def born(self) -> set[str]:
        return set(self.observations) - set(self.before)


def play(env: CrowdParallelEnv, seed: int) -> list[Step]:
    """Walk to the goals with some noise until the episode is over."""
    rng = np.random.default_rng(seed)
    observations, _ = env.reset(seed=seed)
    steps = []
    while env.agents:
        before = list(env.agents)
        actions = {n: 0.3 * observations[n][3:5] + rng.normal(0, 0.1, 2) for n in before}
        entries = env.step(actions)
        observations = entries[0]
        steps.append(Step(before, list(env.agents), *entries))
    return steps


@pytest.fixture(scope="module", params=SCENES)
def env(request: pytest.FixtureRequest) -> CrowdParallelEnv:
    return parallel_env(request.param, horizon_s=120.0)


@pytest.fixture(scope="module")
def steps(env: CrowdParallelEnv) -> list[Step]:
    """A whole episode."""
    return play(env, seed=4)


@pytest.mark.parametrize("scene", SCENES)
def test_it_passes_pettingzoos_api_test(scene: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Ids are unborn at the end of an episode, so its end lies beyond the test's cycles.
        parallel_api_test(parallel_env(scene, horizon_s=400.0), num_cycles=300)


@pytest.mark.parametrize("scene", SCENES)
def test_it_passes_pettingzoos_seed_test(scene: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_seed_test(lambda: parallel_env(scene, horizon_s=400.0), num_cycles=300)


def same_dicts(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return list(one) == list(other) and all(np.array_equal(one[k], other[k]) for k in one)


def same_course(one: CrowdParallelEnv, other: CrowdParallelEnv, seeds: tuple[int, int]) -> bool:
    """Whether 500 steps with equal actions for equal names give equal entries."""
    rng = np.random.default_rng(0)
    pairs = list(zip(one.reset(seed=seeds[0]), other.reset(seed=seeds[1]), strict=True))
    for _ in range(500):
        if one.agents != other.agents or not all(same_dicts(a, b) for a, b in pairs):
            return False
        actions = {name: rng.uniform(-1, 1, 2) for name in one.agents}
        pairs = list(zip(one.step(actions), other.step(actions), strict=True))
    return True


@pytest.mark.parametrize("scene", SCENES)
def test_the_same_seed_gives_the_same_500_steps(scene: str) -> None:
    one, other = (parallel_env(scene, horizon_s=400.0) for _ in range(2))
    assert same_course(one, other, (5, 5))


@pytest.mark.parametrize("scene", SCENES)
def test_another_seed_gives_another_course(scene: str) -> None:
    one, other = (parallel_env(scene, horizon_s=400.0) for _ in range(2))
    assert not same_course(one, other, (5, 6))


def test_episodes_after_a_seed_follow_from_it() -> None:
    crowds = []
    for _ in range(2):
        env = parallel_env("eth-v0", horizon_s=60.0)
        env.reset(seed=5)
        crowds += [env.reset()[0], env.reset()[0]]
    assert same_dicts(crowds[0], crowds[2])
    assert same_dicts(crowds[1], crowds[3])
    assert not same_dicts(crowds[0], crowds[1])


def test_an_episode_goes_to_its_horizon(env: CrowdParallelEnv, steps: list[Step]) -> None:
    last = max(info["frame"] for info in steps[-1].infos.values())
    assert last == env.frames == 300


def test_agents_are_possible_agents(env: CrowdParallelEnv, steps: list[Step]) -> None:
    assert {name for s in steps for name in s.observations} <= set(env.possible_agents)


def test_ids_are_given_in_order_and_never_again(steps: list[Step]) -> None:
    entered = [name for s in steps for name in sorted(s.born, key=lambda n: int(n[7:]))]
    first = len(steps[0].before)
    assert len(entered) > 20
    assert entered == [f"person_{first + k}" for k in range(len(entered))]


def test_who_ends_leaves_and_everyone_else_stays(steps: list[Step]) -> None:
    assert all(set(s.after) == (set(s.before) - s.done) | s.born for s in steps)
    assert sum(len(s.done) for s in steps) > 20


def test_each_agent_gets_all_five_entries(steps: list[Step]) -> None:
    for s in steps:
        everyone = set(s.before) | set(s.after)
        for entries in (s.observations, s.rewards, s.terminations, s.truncations, s.infos):
            assert set(entries) == everyone


def test_who_is_born_is_not_done_and_has_no_reward(steps: list[Step]) -> None:
    for s in steps:
        for n in s.born:
            assert (s.rewards[n], s.terminations[n], s.truncations[n]) == (0.0, False, False)


def test_observations_lie_in_their_space(env: CrowdParallelEnv, steps: list[Step]) -> None:
    for s in steps:
        assert all(env.observation_space(n).contains(o) for n, o in s.observations.items())


def test_infos_tell_the_frame(steps: list[Step]) -> None:
    at = 0
    for s in steps:
        for n in s.before:
            assert (s.infos[n]["frame"], s.infos[n]["frames_skipped"]) == (at + 1, 0)
        at += 1
        if skipped := {s.infos[n]["frames_skipped"] for n in s.born} - {0}:
            at += skipped.pop()
        assert all(s.infos[n]["frame"] == at for n in s.born)


def test_the_outcome_stands_in_the_last_info_only(steps: list[Step]) -> None:
    for s in steps:
        assert {n for n, info in s.infos.items() if "outcome" in info} == s.done


def test_goals_and_exits_terminate_and_limits_truncate(steps: list[Step]) -> None:
    seen = set()
    for s in steps:
        for n in s.done:
            how = s.infos[n]["outcome"]
            seen.add(how)
            assert s.terminations[n] == (how in ("goal", "exit"))
            assert s.truncations[n] == (how in ("timeout", "horizon"))
    assert seen >= {"goal", "horizon"}


def test_unknown_reset_options_change_nothing(env: CrowdParallelEnv) -> None:
    plain, _ = env.reset(seed=1)
    assert same_dicts(plain, env.reset(seed=1, options={"unheard of": object()})[0])


@pytest.mark.parametrize("scene", SCENES)
def test_straight_actions_give_the_rollout_of_straight_walkers(scene: str) -> None:
    place = load_scene(scene)
    env = parallel_env(place, horizon_s=200.0)
    policy = Straight()
    env.reset(seed=8)
    policy.reset(place, np.random.default_rng(0))
    while env.agents:
        acts = policy.act(StateView.of(env._simulation))
        env.step(dict(zip(env.agents, acts, strict=True)))
    crowd = env.trajectories()
    rolled = rollout(place, env.spawn, Straight(), seed=8, horizon_s=200.0)
    for column in ("person_id", "first", "offsets", "xy", "outcome", "left", "spawn_s"):
        assert np.array_equal(getattr(crowd, column), getattr(rolled, column)), column


def test_replayed_arrivals_begin_with_the_recorded_people() -> None:
    place = load_scene("plaza-v0")
    recording = rollout(place, parallel_env(place).spawn, Straight(), seed=0, horizon_s=60.0)
    env = parallel_env(place, spawn=Replay(recording), horizon_s=60.0)
    env.reset()
    there = {OUTCOMES[k] for k in recording.outcome[~recording.entered]}
    assert there
    assert len(env.agents) == (recording.first == 0).sum()
