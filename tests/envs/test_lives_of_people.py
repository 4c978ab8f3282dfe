"""Trips that come and go in the PettingZoo view, one rule at a time."""

from collections.abc import Callable

import numpy as np
import pytest
from given import env_of, run, stand
from worlds import Person, square

from crowdbench.envs.parallel_env import CrowdParallelEnv, parallel_env
from crowdbench.errors import CapacityError

RUNNER = Person(start=(0.0, 0.0), goal=(1.0, 0.0))  # a step to the right reaches the goal


def test_reset_goes_on_to_the_first_arrival() -> None:
    env = env_of(Person(time_s=4.0))
    _, infos = env.reset()
    assert infos == {"person_0": {"frame": 10, "frames_skipped": 10}}


def test_a_gap_is_skipped_inside_one_call() -> None:
    env = env_of(RUNNER, Person(time_s=8.0))
    env.reset()
    infos = env.step(run(env))[4]
    last = {name: value for name, value in infos["person_0"].items() if name != "reward_parts"}
    assert last == {"frame": 1, "frames_skipped": 0, "outcome": "goal"}
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
    assert observations[left][6] == pytest.approx(0.17, abs=1e-6)


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


def test_numpys_integers_are_seeds_too() -> None:
    env = parallel_env("plaza-v0", horizon_s=20.0)
    by_numpy, _ = env.reset(seed=np.int64(3))  # type: ignore[arg-type]
    by_python, _ = env.reset(seed=3)
    assert by_numpy.keys() == by_python.keys()
    assert all((by_numpy[name] == by_python[name]).all() for name in by_python)
