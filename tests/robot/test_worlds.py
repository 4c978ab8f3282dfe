"""Worlds with robots: reproducible, alone or beside others, episode after episode."""

from typing import Any

import numpy as np
import pytest
from lonely_robots import AHEAD, DISC, STAND, drive, lonely, result
from worlds import Person, with_bodies

from crowdbench.errors import ActionError, OwnCodeError, SettingError
from crowdbench.robot.config import RobotConfig, RobotReward
from crowdbench.robot.robots import Robot
from crowdbench.robot.worlds import RobotWorlds

SHORT: dict[str, Any] = {"time_limit_s": 8.0, "horizon_s": 20.0, "spawn": "poisson-gmm"}


def told(worlds: RobotWorlds, steps: int, world: int, seed: int) -> list[np.ndarray]:
    """What a world shows in some steps, with random actions for it, and new episodes at the end."""
    rng, seen = np.random.default_rng(seed), []
    actions = np.zeros((worlds.worlds, 2))
    for _ in range(steps):
        actions[world] = rng.uniform([-0.2, -0.3], [1.0, 0.3])
        step = worlds.step(actions)
        seen.append(np.append(worlds.observe()[world], step.reward[world]))
        over = np.flatnonzero(step.terminated | step.truncated)
        if len(over):
            worlds.go_on(over)
        if world in over:
            seen.append(worlds.observe()[world])
    return seen


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {
            "observation": "lidar",
            "range_noise_m": 0.05,
            "drop_out": 0.1,
            "period_s": 0.2,
            "time_limit_s": 4.0,
            "horizon_s": 8.0,
        },
        {"task": "patrol", "points": 2, "min_distance_m": 2.0, "costs": True},
    ],
)
def test_a_world_is_the_same_alone_and_beside_others(settings: dict[str, Any]) -> None:
    alone = RobotWorlds("eth-v0", 1, **SHORT | settings)
    alone.begin(np.array([7]))
    beside = RobotWorlds("eth-v0", 3, **SHORT | settings)
    beside.begin(np.array([3, 5, 7]))
    first, second = told(alone, 60, 0, 1), told(beside, 60, 2, 1)
    assert len(first) == len(second) > 61  # some episodes end, and a new crowd comes
    for one, other in zip(first, second, strict=True):
        np.testing.assert_array_equal(one, other)
    alone.begin(np.array([7]))  # and again
    np.testing.assert_array_equal(np.concatenate(told(alone, 60, 0, 1)), np.concatenate(first))


def test_worlds_begin_anew_one_by_one() -> None:
    worlds = RobotWorlds("eth-v0", 2, **SHORT)
    worlds.begin(np.array([1, 2]))
    first = worlds.observe()
    told(worlds, 10, 0, 0)
    worlds.begin(np.array([2]), np.array([1]))
    np.testing.assert_array_equal(worlds.observe()[1], first[1])


def test_people_walk_on_between_episodes_until_their_time_is_over() -> None:
    worlds = RobotWorlds("eth-v0", 1, **SHORT)
    worlds.begin(np.array([0]))
    frame = worlds.crowds.simulation.clock.frame
    before = worlds.present.position[0][worlds.present.there[0]].copy()
    worlds.go_on(np.array([0]))
    assert frame[0] == 0
    np.testing.assert_array_equal(worlds.present.position[0][worlds.present.there[0]], before)
    for _ in range(30):  # 12 of 20 s
        worlds.step(np.zeros((1, 2)))
    worlds.go_on(np.array([0]))
    assert frame[0] == 0
    assert len(worlds.present.position[0][worlds.present.there[0]]) > 0


def test_people_see_the_robot_where_it_is() -> None:
    worlds = lonely(Person(start=(1.0, 3.0), goal=(9.0, 3.0)), period_s=0.2)
    slots = worlds.crowds.simulation.slots
    assert slots.alive[0, -1]
    assert slots.wider[0, -1] == 0.0
    for _ in range(3):
        drive(worlds, AHEAD, AHEAD)
        np.testing.assert_allclose(slots.position[0, -1], worlds.view.position[0], atol=1e-6)
        np.testing.assert_allclose(slots.velocity[0, -1], [1.0, 0.0], atol=1e-6)
        np.testing.assert_allclose(slots.heading[0, -1], [1.0, 0.0], atol=1e-6)
    assert not lonely(visible=False).crowds.simulation.slots.alive[0, -1]
    wide = lonely(robot=Robot(radius_m=0.5), scene=with_bodies(worlds.scene))
    assert wide.crowds.simulation.slots.wider[0, -1] == np.float32(0.5 - 0.15)


def test_all_people_leave_in_time_and_the_robot_stays() -> None:
    people = [Person(time_s=float(k), start=(-2.0, 4.0), goal=(2.0, 4.0)) for k in range(12)]
    worlds = lonely(*people, time_limit_s=30.0, max_alive=3)
    seen = set()
    for _ in range(74):
        drive(worlds, STAND)
        seen.add(int(worlds.present.there.sum()))
    assert max(seen) == 3
    assert worlds.present.there.sum() == 0
    assert worlds.crowds.simulation.slots.alive[0, -1]


def test_a_patrol_visits_its_goals_in_turn() -> None:
    worlds = RobotWorlds(
        "plaza-v0", 1, task="patrol", points=3, robot=DISC, walkers="straight", visible=False,
        collision="count", time_limit_s=200.0, spawn="poisson-gmm",
    )  # fmt: skip
    worlds.begin(np.array([0]))
    reached, reward, lengths = [], 0.0, worlds.view.remaining[0]
    for _ in range(500):
        way = worlds.view.towards[0] - worlds.view.position[0]
        angle = np.arctan2(way[1], way[0]) - worlds.view.heading[0]
        step = worlds.step(np.array([[np.cos(angle), np.sin(angle)]]))
        reward += worlds.progress_m[0]
        reached.append(int(worlds.reached[0]))
        if step.terminated[0]:
            break
    found = result(worlds)
    assert sorted(set(reached)) == [0, 1, 2, 3]
    assert found["success"] == 1
    assert found["spl"] > 0.9
    assert reward > lengths  # progress to all goals, not only to the first
    assert abs(reward - found["path_length_m"]) < 3.0


def test_the_reward_is_the_sum_of_its_parts() -> None:
    weights = RobotReward(progress=2.0, success=7.0, collision=3.0, discomfort=5.0, time=0.5)
    person = Person(start=(-3.8, 0.75), goal=(8.0, 8.0), speed=0.0)
    worlds = lonely(person, reward=weights)
    [step] = drive(worlds, AHEAD)
    gap = np.hypot(0.8, 0.75) - 0.6
    # 0.4 m nearer, no discomfort: 0.5 m away
    assert gap > 0.45
    np.testing.assert_allclose(step.reward[0], 2.0 * 0.4 - 0.5 * 0.4, atol=1e-5)
    [step] = drive(worlds, AHEAD)
    gap = np.hypot(0.4, 0.75) - 0.6
    near = 5.0 * 0.4 * (1 - gap / 0.45)
    np.testing.assert_allclose(step.reward[0], 2.0 * 0.4 - 0.5 * 0.4 - near, atol=1e-5)
    steps = drive(lonely(reward=weights), *[AHEAD] * 24)
    np.testing.assert_allclose(steps[-1].reward[0], 7.0 + 2.0 * 0.4 - 0.5 * 0.4, atol=1e-5)
    person = Person(start=(-4.2, 0.0), goal=(8.0, 8.0), speed=0.0)
    [hit] = drive(lonely(person, reward=weights), AHEAD)
    want = 2.0 * 0.4 - 3.0 - 5.0 * 0.4 - 0.5 * 0.4
    np.testing.assert_allclose(hit.reward[0], want, atol=1e-5)


def test_a_reward_of_ones_own_gets_the_worlds() -> None:
    worlds = lonely(reward=lambda w: -w.view.remaining)
    [step] = drive(worlds, AHEAD)
    assert step.reward[0] == -np.float32(worlds.view.remaining[0])
    for wrong in (lambda w: 1.0, lambda w: np.array([np.nan]), lambda w: w.nothing):
        with pytest.raises(OwnCodeError, match="reward"):
            drive(lonely(reward=wrong), AHEAD)


@pytest.mark.parametrize("actions", [np.zeros((2, 2)), np.array([[np.nan, 0.0]]), np.array(["a"])])
def test_wrong_actions_are_refused(actions: np.ndarray) -> None:
    with pytest.raises(ActionError, match="step"):
        lonely().step(actions)


def test_a_step_before_an_episode_is_refused() -> None:
    with pytest.raises(ActionError, match="reset"):
        RobotWorlds("plaza-v0", 1, **SHORT).step(np.zeros((1, 2)))


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"period_s": 0.3}, "period_s"),
        ({"walker": "straight"}, "Did you mean `walkers`"),
        ({"walkers": "nobody"}, "nobody"),
        ({"walkers": "replay", "spawn": "poisson-gmm"}, "replay"),
        ({"observation": "camera"}, "observation"),
        ({"horizon_s": 5.0}, "at least time_limit_s"),
        ({"drop_out": 1.5}, "drop_out"),
        ({"nearest": 0}, "nearest"),
        ({"start": (1.0,)}, "start"),
        ({"reward": 3}, "reward"),
        ({"robot": "car"}, "robot"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(SettingError, match=message):
        RobotWorlds("plaza-v0", 1, **settings)


def test_settings_replace_those_of_a_config() -> None:
    config = RobotConfig.of(RobotConfig(nearest=3, rays=9), rays=7)
    assert (config.nearest, config.rays) == (3, 7)
