"""The PettingZoo view: the API's contract, and lives that come and go."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest
from given import env_of, run, stand
from pettingzoo.test import parallel_api_test, parallel_seed_test
from worlds import Person, square

from crowdbench.environment import CrowdParallelEnv, parallel_env
from crowdbench.errors import CapacityError
from crowdbench.policies import StateView, Straight
from crowdbench.rollouts import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn import Replay
from crowdbench.trajectories import OUTCOMES

SCENES = ("eth-v0", "plaza-v0")
RUNNER = Person(start=(0.0, 0.0), goal=(1.0, 0.0))  # a step to the right reaches the goal


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


def test_reset_goes_on_to_the_first_arrival() -> None:
    env = env_of(Person(time_s=4.0))
    _, infos = env.reset()
    assert infos == {"person_0": {"frame": 10, "frames_skipped": 10}}


def test_a_gap_is_skipped_inside_one_call() -> None:
    env = env_of(RUNNER, Person(time_s=8.0))
    env.reset()
    infos = env.step(run(env))[4]
    assert infos["person_0"] == {"frame": 1, "frames_skipped": 0, "outcome": "goal"}
    assert infos["person_1"] == {"frame": 20, "frames_skipped": 19}
    assert env.agents == ["person_1"]


@pytest.mark.parametrize("people", [[], [Person(time_s=40.0)]], ids=["nobody", "at the horizon"])
def test_where_nobody_arrives_the_episode_is_over_at_once(people: list[Person]) -> None:
    env = env_of(*people)
    assert env.reset() == ({}, {})
    assert env.agents == []


def test_the_last_one_to_leave_before_an_empty_end_ends_the_episode() -> None:
    env = env_of(RUNNER, Person(time_s=40.0))
    env.reset()
    observations = env.step(run(env))[0]
    assert (list(observations), env.agents) == (["person_0"], [])


def test_a_death_and_a_birth_share_a_step() -> None:
    env = env_of(RUNNER, Person(time_s=0.4))
    env.reset()
    _, _, terminations, _, infos = env.step(run(env))
    assert terminations == {"person_0": True, "person_1": False}
    assert infos["person_1"] == {"frame": 1, "frames_skipped": 0}


def test_a_group_enters_in_one_frame() -> None:
    env = env_of(*[Person(start=(0.1 * k, 0.0)) for k in range(4)])
    env.reset()
    assert env.agents == [f"person_{k}" for k in range(4)]


@pytest.mark.parametrize("time_s", [0.0, 4.0, 0.4], ids=["at reset", "after a gap", "in a step"])
def test_people_see_each_other_from_their_first_frame(time_s: float) -> None:
    walker = Person(start=(-9.0, -9.0), goal=(-8.0, -9.0))
    pair = [Person(time_s=time_s, start=(x, 0.0)) for x in (0.0, 2.0)]
    env = env_of(*([] if time_s == 0 else [walker]), *pair)
    observations, _ = env.reset()
    if time_s > 0:
        observations = env.step(run(env))[0]
    left = env.agents[0]
    # Straight to the right: the other's disc of 0.3 m, in units of the range of 10 m.
    assert observations[left][5] == pytest.approx(0.17, abs=1e-6)


def test_the_horizon_truncates_everyone() -> None:
    env = env_of(Person(), Person(time_s=0.8), horizon_s=2.0)
    env.reset()
    for _ in range(4):
        env.step(stand(env))
    _, _, terminations, truncations, infos = env.step(stand(env))
    assert (set(terminations.values()), set(truncations.values())) == ({False}, {True})
    assert {(i["frame"], i["outcome"]) for i in infos.values()} == {(5, "horizon")}


def test_nobody_enters_at_the_horizon() -> None:
    env = env_of(Person(), Person(time_s=0.4), horizon_s=0.4)
    env.reset()
    observations = env.step(stand(env))[0]
    assert (list(observations), env.agents) == (["person_0"], [])


LIVES: dict[str, tuple[Callable[[], CrowdParallelEnv], int, bool]] = {
    "exit": (lambda: env_of(Person(start=(9.0, 0.0), goal=(0.0, 0.0))), 1, True),
    "timeout": (lambda: env_of(Person(), scene=square(dwell_p99_s=0.8)), 4, False),
    "recorded": (lambda: env_of(Person(leave_frame=2)), 2, True),
}


@pytest.mark.parametrize("how", LIVES)
def test_a_life_ends(how: str) -> None:
    make, frames, terminates = LIVES[how]
    env = make()
    env.reset()
    act = run if how == "exit" else stand
    for _ in range(frames):
        _, _, terminations, truncations, infos = env.step(act(env))
    assert infos["person_0"]["outcome"] == how
    assert (terminations, truncations) == ({"person_0": terminates}, {"person_0": not terminates})


def test_the_reward_is_the_way_come_nearer_and_one_at_the_goal() -> None:
    env = env_of(Person(start=(0.0, 0.0), goal=(3.9, 0.0)))
    env.reset()
    rewards = [env.step(run(env))[1]["person_0"] for _ in range(2)]
    np.testing.assert_allclose(rewards, [2.0, 1.9 - 0.1 + 1.0], atol=1e-6)


@pytest.mark.parametrize("late_s", [0.0, 0.8])
@pytest.mark.parametrize("name", ["max_alive", "max_persons"])
def test_running_out_of_room_is_an_error(name: str, late_s: float) -> None:
    env = env_of(Person(), Person(time_s=late_s, start=(0.0, 5.0)), **{name: 1})

    def until_there() -> None:
        env.reset()
        for _ in range(2):
            env.step(stand(env))

    with pytest.raises(CapacityError, match=f"Raise {name}"):
        until_there()


@pytest.mark.parametrize("name", ["max_alive", "max_persons"])
def test_who_finds_no_room_can_be_dropped_and_counted(name: str) -> None:
    people = [Person(start=(0.0, 3.0 * k)) for k in range(3)]
    env = env_of(*people, on_full="drop", **{name: 1})
    env.reset()
    assert (env.agents, env.dropped) == (["person_0"], 2)


def test_the_table_keeps_the_empty_frames() -> None:
    env = env_of(Person(time_s=1.2, goal=(1.0, 0.0)), Person(time_s=4.0, goal=(1.0, 0.0)))
    env.reset()
    while env.agents:
        env.step(run(env))
    present = env.trajectories().present()
    assert len(present) == 100
    assert np.flatnonzero(present).tolist() == [3, 4, 10, 11]


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
