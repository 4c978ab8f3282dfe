"""The PettingZoo view: the API's contract, in whole episodes of the scenes."""

import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from pettingzoo.test import parallel_api_test, parallel_seed_test
from worlds import poisson, square

from crowdbench.data.table import OUTCOMES
from crowdbench.envs.parallel_env import CrowdParallelEnv, parallel_env
from crowdbench.policies import StateView, Straight
from crowdbench.run.rollout import rollout
from crowdbench.scene import list_scenes, load_scene
from crowdbench.simulation.social import SIZE
from crowdbench.spawn import Replay

SCENES = list_scenes()
OFTEN_EMPTY = ("forum-v0", "zara1-v0")
CROWDED = "gc-v0"
WHOLE_S = {CROWDED: 60.0, "forum-v0": 4000.0, "plaza-v0": 300.0}
"""Horizons of the episodes that are walked to the end where they are not the recording's."""


def endless(scene: str) -> CrowdParallelEnv:
    """An environment whose horizon no test reaches."""
    return parallel_env(scene, horizon_s=30_000.0 if scene in OFTEN_EMPTY else 400.0)


def cycles(scene: str, number: int) -> int:
    """So many steps, or fewer in a crowd of a hundred."""
    return number // 5 if scene == CROWDED else number


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
    return parallel_env(request.param, horizon_s=WHOLE_S.get(request.param))


@pytest.fixture(scope="module")
def steps(env: CrowdParallelEnv) -> list[Step]:
    """A whole episode."""
    return play(env, seed=4)


@pytest.mark.parametrize("scene", SCENES)
def test_it_passes_pettingzoos_api_test(scene: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        # Ids are unborn at the end of an episode, so its end lies beyond the test's cycles.
        parallel_api_test(endless(scene), num_cycles=cycles(scene, 300))


def test_so_it_does_with_the_observation_of_people() -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = parallel_env("plaza-v0", horizon_s=400.0, observation="social-1")
        parallel_api_test(env, num_cycles=100)
        assert env.observation_space("person_0").shape == (SIZE,)


@pytest.mark.parametrize("scene", SCENES)
def test_it_passes_pettingzoos_seed_test(scene: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        parallel_seed_test(lambda: endless(scene), num_cycles=cycles(scene, 300))


def same_dicts(one: dict[str, Any], other: dict[str, Any]) -> bool:
    return list(one) == list(other) and all(np.array_equal(one[k], other[k]) for k in one)


def same_course(scene: str, *seeds: int) -> bool:
    """Whether 500 steps with equal actions for equal names give equal entries."""
    one, other = (endless(scene) for _ in range(2))
    rng = np.random.default_rng(0)
    pairs = list(zip(one.reset(seed=seeds[0]), other.reset(seed=seeds[1]), strict=True))
    for _ in range(cycles(scene, 500)):
        if one.agents != other.agents or not all(same_dicts(a, b) for a, b in pairs):
            return False
        actions = {name: rng.uniform(-1, 1, 2) for name in one.agents}
        pairs = list(zip(one.step(actions), other.step(actions), strict=True))
    return True


@pytest.mark.parametrize("scene", SCENES)
def test_the_same_seed_gives_the_same_500_steps(scene: str) -> None:
    assert same_course(scene, 5, 5)


@pytest.mark.parametrize("scene", SCENES)
def test_another_seed_gives_another_course(scene: str) -> None:
    assert not same_course(scene, 5, 6)


def test_episodes_after_a_seed_follow_from_it() -> None:
    crowds = []
    for _ in range(2):
        env = parallel_env("eth-v0", horizon_s=60.0)
        env.reset(seed=5)
        crowds += [env.reset()[0], env.reset()[0]]
    assert same_dicts(crowds[0], crowds[2])
    assert same_dicts(crowds[1], crowds[3])
    assert not same_dicts(crowds[0], crowds[1])


def test_an_episode_goes_to_its_horizon_or_its_last_person(
    env: CrowdParallelEnv, steps: list[Step]
) -> None:
    (last,) = {info["frame"] for info in steps[-1].infos.values()}
    cut_off = "horizon" in {info["outcome"] for info in steps[-1].infos.values()}
    assert cut_off == (last == env.frames)
    assert cut_off or env.scene.id in OFTEN_EMPTY


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
    at = steps[0].infos[steps[0].before[0]]["frame"] - 1  # reset goes on to the first arrival
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


def test_goals_and_exits_terminate_and_limits_truncate(
    env: CrowdParallelEnv, steps: list[Step]
) -> None:
    seen = set()
    for s in steps:
        for n in s.done:
            how = s.infos[n]["outcome"]
            seen.add(how)
            assert s.terminations[n] == (how in ("goal", "exit"))
            assert s.truncations[n] == (how in ("timeout", "horizon"))
    assert seen >= ({"goal"} if env.scene.id in OFTEN_EMPTY else {"goal", "horizon"})


def test_unknown_reset_options_change_nothing(env: CrowdParallelEnv) -> None:
    plain, _ = env.reset(seed=1)
    assert same_dicts(plain, env.reset(seed=1, options={"unheard of": object()})[0])


def walk_straight(env: CrowdParallelEnv, seed: int) -> int:
    """Play an episode with straight walkers, and count the calls of `step`."""
    policy = Straight()
    env.reset(seed=seed)
    policy.reset(env.scene, np.random.default_rng(0))
    calls = 0
    while env.agents:
        acts = policy.act(StateView.of(env._simulation))
        env.step(dict(zip(env.agents, acts, strict=True)))
        calls += 1
    return calls


@pytest.mark.parametrize("scene", SCENES)
def test_straight_actions_give_the_rollout_of_straight_walkers(scene: str) -> None:
    place = load_scene(scene)
    horizon_s = WHOLE_S.get(scene, 200.0)
    env = parallel_env(place, horizon_s=horizon_s)
    walk_straight(env, seed=8)
    crowd = env.trajectories()
    rolled = rollout(place, env.spawn, Straight(), seed=8, horizon_s=horizon_s)
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


@pytest.mark.long
def test_a_day_of_the_forum_takes_a_step_for_each_frame_with_someone() -> None:
    env = parallel_env("forum-v0")
    calls = walk_straight(env, seed=0)
    crowd = env.trajectories()
    # From a frame in which someone is there, and does not end, one step leads on.
    goes_on = np.zeros(crowd.frames, dtype=bool)
    for p in range(len(crowd)):
        goes_on[crowd.first[p] : crowd.last[p] + (not crowd.left[p])] = True
    assert calls == goes_on.sum()
    assert calls < env.frames / 3


@pytest.mark.parametrize("horizon_s", [4.0, 60.0])
def test_a_short_episode_of_a_scene_where_people_stay_long_has_room_by_default(
    horizon_s: float,
) -> None:
    # Five minutes of warm-up let in ten times as many people as a minute of the episode.
    env = parallel_env(CROWDED, horizon_s=horizon_s)
    env.reset(seed=0)
    assert len(env.agents) > 50
    assert env.dropped == 0


def test_a_crowd_that_never_arrives_has_room_by_default() -> None:
    scene = square(10.0, dwell_p99_s=120.0)
    env = parallel_env(scene, spawn=poisson(scene, rate_per_s=9.0), horizon_s=50.0, rays=1)
    env.reset(seed=0)
    while env.agents:
        present = len(env.agents)
        env.step(dict.fromkeys(env.agents, np.zeros(2)))
    assert present > 512


def test_the_arrays_of_the_largest_scene_are_small() -> None:
    env = parallel_env(CROWDED)
    env.reset(seed=0)
    simulation = env._simulation
    bundles = (simulation.slots, simulation.queue, simulation._cells, simulation._walls)
    arrays = [array for bundle in bundles for array in bundle if isinstance(array, np.ndarray)]
    assert len(env.possible_agents) > 12_000
    assert sum(array.nbytes for array in [*arrays, simulation.observation]) < 64 * 2**20


class Unread(list[str]):
    """Names that can be looked up, but not gone through."""

    def __iter__(self) -> Iterator[str]:
        raise AssertionError("went through all possible agents")


def test_a_step_does_not_go_through_all_possible_agents() -> None:
    env = parallel_env("plaza-v0", spawn="poisson-gmm", horizon_s=60.0)
    env.possible_agents = Unread(env.possible_agents)
    assert walk_straight(env, seed=0) == 150
