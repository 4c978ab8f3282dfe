"""Tasks about a person: to follow them, and to stand aside for them."""

from typing import Any

import numpy as np
import pytest
import shapely
from lonely_robots import STAND, drive, lonely, result
from worlds import Person, box, square

import crowdbench
from crowdbench.errors import SettingError
from crowdbench.robot.controllers import Straight
from crowdbench.robot.robots import Robot
from crowdbench.robot.tasks import BEHIND_M, FOLLOW_M, PAST_M
from crowdbench.robot.worlds import RobotWorlds

FAST = Robot(
    name="fast", kinematics="holonomic", radius_m=0.3, max_speed_mps=1.6, max_acceleration_mps2=100
)
QUICK: dict[str, Any] = {"spawn": "poisson-gmm", "time_limit_s": 16.0, "horizon_s": 40.0}


def about(task: str, *people: Person, **settings: Any) -> RobotWorlds:
    usual: dict[str, Any] = {"task": task, "goal": None, "robot": FAST}
    if task == "stand-aside":
        usual["start"] = None
    return lonely(*people, **usual | settings)


def straight(worlds: RobotWorlds, steps: int) -> list[Any]:
    """Drive along the shortest path until the episode is over."""
    taken: list[Any] = []
    for _ in range(steps):
        taken.append(worlds.step(Straight().act(worlds.view)))
        if taken[-1].terminated[0] or taken[-1].truncated[0]:
            break
    return taken


def test_a_robot_follows_somebody_until_they_leave() -> None:
    leader = Person(start=(-3.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("follow", leader, time_limit_s=38.0, max_alive=8)
    np.testing.assert_allclose(worlds.view.goal[0], [-3.0, 0.0])
    taken = straight(worlds, 90)
    found = result(worlds)
    assert taken[-1].terminated[0]
    assert found["success"] == 1
    assert found["collision"] == 0
    assert found["timeout"] == 0
    assert found["following_share"] > 0.9
    assert 10.0 < found["time_s"] < 13.0  # 11 m at 1 m/s
    assert taken[-1].reward[0] > 0.9
    reach = worlds.crowds.reach_m
    assert reach + BEHIND_M - 0.7 < found["min_distance_m"] + reach < reach + BEHIND_M + 0.1
    assert "spl" not in found


def test_who_stays_behind_has_not_followed() -> None:
    leader = Person(start=(-3.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("follow", leader, time_limit_s=38.0)
    for _ in range(40):
        [step] = drive(worlds, STAND)
        if step.terminated[0]:
            break
    found = result(worlds)
    assert step.terminated[0]
    assert not step.truncated[0]
    assert found["success"] == 0
    assert found["timeout"] == 0
    assert found["collision"] == 0
    assert 0 < found["following_share"] < 0.5


def test_a_leader_who_stays_is_followed_until_the_time_is_up() -> None:
    leader = Person(start=(-3.0, 0.0), goal=(8.0, 0.0), speed=0.0)
    worlds = about("follow", leader, time_limit_s=8.0)
    taken = straight(worlds, 30)
    assert len(taken) == 20
    assert taken[-1].terminated[0]
    assert not taken[-1].truncated[0]
    assert result(worlds)["success"] == 1
    # It stops behind the leader.
    gap = float(np.linalg.norm(worlds.view.position[0] - [-3.0, 0.0])) - worlds.crowds.reach_m
    assert gap == pytest.approx(BEHIND_M, abs=0.1)
    assert gap < FOLLOW_M
    assert abs(worlds.view.speed[0]) < 0.01


def test_who_has_farthest_to_go_leads_and_nobody_else_matters() -> None:
    people = [
        Person(start=(-4.0, 3.0), goal=(-2.0, 3.0)),
        Person(start=(-4.0, -3.0), goal=(9.0, -3.0)),
        Person(start=(0.0, 4.0), goal=(0.0, 9.0)),
    ]
    worlds = about("follow", *people, start=None)
    np.testing.assert_allclose(worlds.view.goal[0], [-4.0, -3.0])
    near = np.linalg.norm(worlds.view.position[0] - [-4.0, -3.0])
    assert worlds.crowds.reach_m + 1.0 < near < 4.0


def test_who_comes_next_leads_where_nobody_is() -> None:
    leader = Person(time_s=4.0, start=(-3.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("follow", leader, time_limit_s=30.0)
    np.testing.assert_allclose(worlds.view.goal[0], [-3.0, 0.0])
    straight(worlds, 75)
    assert result(worlds)["success"] == 1
    nobody = about("follow", time_limit_s=4.0)
    taken = straight(nobody, 20)
    assert len(taken) == 10
    assert result(nobody)["success"] == 0


def test_a_path_to_follow_leads_around_walls_and_stops_behind_the_person() -> None:
    wall = box(-1.0, -4.0, 0.0, 4.0)
    leader = Person(start=(2.0, 0.0), goal=(9.0, 0.0), speed=0.0)
    worlds = about("follow", leader, scene=square(10.0, wall), start=(-3.0, 0.0), time_limit_s=30.0)
    assert worlds.view.remaining[0] > 8.0
    taken = straight(worlds, 75)
    assert taken[-1].terminated[0]
    assert result(worlds)["success"] == 1
    assert result(worlds)["collision"] == 0


def test_a_robot_stands_aside_until_somebody_has_come_past() -> None:
    person = Person(time_s=6.0, start=(-5.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("stand-aside", person)
    np.testing.assert_allclose(worlds.start[0], [-5.0, 0.0])
    beside = worlds.view.goal[0]
    way = shapely.LineString([person.start, person.goal])
    assert shapely.distance(way, shapely.Point(beside)) >= worlds.crowds.reach_m + 1.2
    taken = straight(worlds, 50)
    found = result(worlds)
    assert taken[-1].terminated[0]
    assert found["success"] == 1
    assert found["collision"] == 0
    assert 6.0 + PAST_M - 0.5 < found["time_s"] < 6.0 + PAST_M + 2.0
    assert found["spl"] > 0.9


def test_nobody_enters_where_a_robot_stays() -> None:
    person = Person(time_s=6.0, start=(-5.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("stand-aside", person, time_limit_s=7.6)  # less than people's patience
    steps = drive(worlds, *[STAND] * 19)
    assert steps[-1].truncated[0]
    assert worlds.present.there.sum() == 0
    found = result(worlds)
    assert found["success"] == 0
    assert found["timeout"] == 1


def test_who_has_not_stood_aside_in_time_has_failed() -> None:
    person = Person(time_s=6.0, start=(-5.0, 0.0), goal=(8.0, 0.0), speed=1.0)
    worlds = about("stand-aside", person, visible=False)
    ends = []
    away = -np.sign(worlds.view.goal[0, 1] - worlds.start[0, 1])
    for _ in range(50):  # beside the way, but on the other side of it
        y, heading = worlds.view.position[0, 1], worlds.view.heading[0]
        action = [away * np.sin(heading), away * np.cos(heading)] if abs(y) < 3.0 else STAND
        [step] = drive(worlds, action)
        ends.append(bool(step.terminated[0]))
        if ends[-1]:
            break
    assert ends[-1]
    found = result(worlds)
    assert found["success"] == found["timeout"] == found["collision"] == 0


@pytest.mark.parametrize("task", ["follow", "stand-aside"])
def test_a_world_is_the_same_alone_and_beside_others(task: str) -> None:
    alone = RobotWorlds("eth-v0", 1, task=task, walkers="straight", **QUICK)
    alone.begin(np.array([7]))
    beside = RobotWorlds("eth-v0", 3, task=task, walkers="straight", **QUICK)
    beside.begin(np.array([3, 5, 7]))
    ended = 0
    for _ in range(120):
        steps = [of.step(Straight().act(of.view)) for of in (alone, beside)]
        assert steps[0].reward[0] == steps[1].reward[2]
        over = [np.flatnonzero(s.terminated | s.truncated) for s in steps]
        assert (0 in over[0]) == (2 in over[1])
        ended += 0 in over[0]
        for of, at in zip((alone, beside), over, strict=True):
            if len(at):
                of.go_on(at)
        np.testing.assert_array_equal(alone.observe()[0], beside.observe()[2])
    assert ended > 3


@pytest.mark.parametrize("scene", crowdbench.list_scenes())
@pytest.mark.parametrize("task", ["follow", "stand-aside"])
def test_episodes_of_all_scenes_are_about_somebody(scene: str, task: str) -> None:
    worlds = RobotWorlds(scene, 8, task=task, walkers="straight", spawn="poisson-gmm")
    worlds.begin(np.arange(8))
    assert worlds.person is not None
    assert (worlds.person.event >= 0).sum() >= (4 if scene == "forum-v0" else 7)  # a quiet place
    assert (worlds.places.part_of(worlds.start) >= 0).all()
    if task == "stand-aside":
        assert (worlds.places.part_of(worlds.view.goal) >= 0).all()


@pytest.mark.parametrize(
    ("task", "given"), [("follow", "goal"), ("stand-aside", "start"), ("stand-aside", "goal")]
)
def test_what_a_task_chooses_cannot_be_given(task: str, given: str) -> None:
    with pytest.raises(SettingError, match=f"{given}.*{task} chooses it"):
        RobotWorlds("plaza-v0", 1, task=task, **{given: (0.0, 0.0)})
