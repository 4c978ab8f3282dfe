"""Recorded episodes contain what happened; their files and pictures show the same."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from gymnasium.wrappers import RenderCollection
from worlds import box, poisson, square

from crowdbench.errors import ActionError, OutputError, SettingError
from crowdbench.robot.drawing import GOAL, ROBOT, RobotPictures
from crowdbench.robot.env import RobotEnv
from crowdbench.robot.record import CELL_M, COLUMNS, RobotEpisode
from crowdbench.viewer.place import GREY, rgb

YARD = square(6.0, box(-5, 3, -2, 5.5))
PEOPLE = {"spawn": poisson(YARD), "walkers": "straight", "collision": "count", "time_limit_s": 8.0}


def robot_env(**settings: Any) -> RobotEnv:
    """A robot among people who cross a yard; it begins at the left."""
    chosen = {"start": (-4.0, -3.0), "goal": (4.0, -3.0), "period_s": 0.2, "max_alive": 20}
    return RobotEnv(YARD, **{**PEOPLE, **chosen, **settings})


def drive(env: RobotEnv, steps: int, action: tuple[float, float] = (1.0, 0.1)) -> None:
    """Begin an episode and drive."""
    env.reset(seed=1)
    for _ in range(steps):
        env.step(np.array(action, np.float32))


@pytest.fixture(scope="module")
def episode() -> RobotEpisode:
    env = robot_env()
    drive(env, 20)
    return env.episode()


def test_an_episode_contains_each_state() -> None:
    env = robot_env()
    env.reset(seed=1)
    robots, people = [], []
    for _ in range(16):
        view, present = env.worlds.view, env.worlds.present
        robots.append([*view.position[0], view.heading[0], *view.velocity[0], *view.goal[0]])
        there = present.there[0]
        people.append(np.hstack([present.position[0], present.velocity[0]])[there])
        env.step(np.array([1.0, 0.1], np.float32))
    episode = env.episode()
    assert len(episode) == 17
    assert sum(map(len, people)) > 16
    for step, (robot, there) in enumerate(zip(robots, people, strict=True)):
        here = episode.people(step)
        assert (episode.step[here] == step).all()
        assert np.unique(episode.person[here]).size == len(there)
        found = np.hstack([episode.person_position, episode.person_velocity])[here]
        assert sorted(found.tolist()) == sorted(there.tolist())
        assert robot == [
            *episode.position[step], episode.heading[step], *episode.velocity[step],
            *episode.goal[step],
        ]  # fmt: skip


def test_people_keep_their_ids_and_walk_on_within_a_frame(episode: RobotEpisode) -> None:
    for who in np.unique(episode.person):
        mine = episode.person == who
        assert (np.diff(episode.step[mine]) == 1).all()
        way = np.diff(episode.person_position[mine], axis=0)
        velocity = episode.person_velocity[mine][1:]
        np.testing.assert_allclose(way, velocity * episode.period_s, atol=1e-5)


def test_an_episode_begins_anew_with_a_reset() -> None:
    env = robot_env()
    with pytest.raises(ActionError, match="reset"):
        env.episode()
    drive(env, 3)
    first = env.episode()
    env.reset()
    assert (len(first), len(env.episode())) == (4, 1)


def test_the_table_says_the_same(episode: RobotEpisode, tmp_path: Path) -> None:
    episode.write_csv(tmp_path / "episode.csv")
    with (tmp_path / "episode.csv").open() as file:
        header, *rows = list(csv.reader(file))
    assert tuple(header) == COLUMNS
    numbers = np.array([row[3:] for row in rows], float)
    of_robot = np.array([row[2] == "robot" for row in rows])
    expected = np.column_stack([episode.position, episode.heading, episode.velocity])
    np.testing.assert_allclose(numbers[of_robot], expected, atol=1e-4)
    assert [int(row[2]) for row in rows if row[2] != "robot"] == episode.person.tolist()
    np.testing.assert_allclose(numbers[~of_robot, :2], episode.person_position, atol=1e-4)
    assert [float(row[1]) for row in rows] == pytest.approx([0.2 * int(row[0]) for row in rows])


def written(episode: RobotEpisode, path: Path, **settings: Any) -> dict[str, Any]:
    """What a SocNav3 file of the episode contains."""
    episode.write_socnav3(path, **settings)
    found: dict[str, Any] = json.loads(path.read_text())
    return found


def test_socnav3_files_have_the_fields_that_its_schema_requires(
    episode: RobotEpisode, tmp_path: Path
) -> None:
    found = written(episode, tmp_path / "episode.json", context="A robot in a yard.")
    assert set(found) == {"metadata", "grid", "walls", "sequence", "context_description"}
    assert all(len(wall) == 4 for wall in found["walls"])
    assert len(found["walls"]) == 4
    assert len(found["sequence"]) == len(episode)
    for step, state in enumerate(found["sequence"]):
        assert set(state) == {"timestamp", "robot", "goal", "people", "objects"}
        robot, goal = state["robot"], state["goal"]
        assert set(robot) == {"shape", "x", "y", "angle", "speed_x", "speed_y", "speed_a"}
        assert robot["shape"] == {"type": "circle", "width": 0.9, "length": 0.9}
        assert {"type", "human", "x", "y", "angle", "pos_threshold", "angle_threshold"} == set(goal)
        assert (goal["type"], goal["x"], goal["y"], goal["angle"]) == ("go-to", 4.0, -3.0, 0.0)
        assert all(set(person) == {"id", "x", "y", "angle"} for person in state["people"])
        assert len(state["people"]) == (episode.step == step).sum()
        assert state["timestamp"] == pytest.approx(0.2 * step)
    assert "context_description" not in written(episode, tmp_path / "other.json")


def test_socnav3_speeds_are_those_of_the_robots_own_frame(
    episode: RobotEpisode, tmp_path: Path
) -> None:
    robot = [state["robot"] for state in written(episode, tmp_path / "e.json")["sequence"]]
    x, y, angle, ahead, left, turn = np.array([
        [state[name] for name in ("x", "y", "angle", "speed_x", "speed_y", "speed_a")]
        for state in robot
    ]).T  # fmt: skip
    moved_mps = np.hypot(np.diff(x), np.diff(y)) / 0.2
    np.testing.assert_allclose(ahead[10:], moved_mps[9:], atol=1e-3)  # it no longer accelerates
    assert (ahead[1:] > 0).all()  # a unicycle drives ahead
    assert np.abs(left).max() < 1e-3
    np.testing.assert_allclose(turn[1:], np.diff(angle) / 0.2, atol=1e-3)


def test_the_grid_is_occupied_where_walls_are(episode: RobotEpisode, tmp_path: Path) -> None:
    grid = written(episode, tmp_path / "e.json")["grid"]
    cells = np.array(grid["data"])
    assert cells.shape == (grid["height"], grid["width"]) == (120, 120)
    row, column = np.nonzero(cells)
    x = grid["x_orig"] + CELL_M * (column + 0.5)
    y = grid["y_orig"] + CELL_M * (grid["height"] - row - 0.5)
    assert (x.min(), x.max(), y.min(), y.max()) == pytest.approx((-4.95, -2.05, 3.05, 5.45))
    assert cells.sum() == 30 * 25


def test_each_goal_of_a_patrol_has_the_direction_of_its_way(
    episode: RobotEpisode, tmp_path: Path
) -> None:
    goal = np.where(np.arange(len(episode))[:, None] < 8, (4.0, -3.0), (-4.0, 3.0))
    patrol = written(replace(episode, goal=goal), tmp_path / "patrol.json")["sequence"]
    angles = [state["goal"]["angle"] for state in patrol]
    x, y = np.array([-4.0, 3.0]) - episode.position[8]
    assert angles == pytest.approx([0.0] * 8 + [np.arctan2(y, x)] * (len(episode) - 8), abs=1e-4)


def test_a_path_that_cannot_be_written_is_named(episode: RobotEpisode, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for write in (episode.write_csv, episode.write_socnav3):
        with pytest.raises(OutputError, match="file"):
            write(tmp_path / "file" / "episode")


def middle(picture: np.ndarray, colour: str) -> np.ndarray:
    """Mean position in metres of all pixels of a colour."""
    row, column = np.nonzero((picture == rgb(colour)).all(axis=2))
    per_m = (640 - 2 * 12) / 12.0
    return np.array([(column.mean() + 0.5 - 12) / per_m - 6, 6 - (row.mean() + 0.5 - 12) / per_m])


def test_everyone_is_where_the_episode_says(episode: RobotEpisode) -> None:
    picture = RobotPictures(YARD).draw(episode, 0)
    assert picture.shape == (640, 640, 3)
    np.testing.assert_allclose(middle(picture, ROBOT), episode.position[0], atol=0.15)
    np.testing.assert_allclose(middle(picture, GOAL), episode.goal[0], atol=0.05)
    there = episode.person_position[episode.people(0)]
    assert len(there) > 0
    np.testing.assert_allclose(middle(picture, GREY), there.mean(axis=0), atol=0.1)


def test_the_way_so_far_is_shown(episode: RobotEpisode) -> None:
    pictures = RobotPictures(YARD)
    blue = [(pictures.draw(episode, k) == rgb(ROBOT)).all(axis=2).sum() for k in (0, 10, -1)]
    assert blue[0] + 50 < blue[1] < blue[2] - 50
    with pytest.raises(IndexError):
        pictures.draw(episode, len(episode))


def test_an_environment_renders_its_present_state() -> None:
    env = robot_env(render_mode="rgb_array")
    with pytest.raises(ActionError, match="reset"):
        env.render()
    frames = RenderCollection(env)
    drive(frames, 3)  # type: ignore[arg-type]
    rendered = frames.render()
    assert len(rendered) == 4
    assert all(frame.dtype == np.uint8 and frame.shape == (640, 640, 3) for frame in rendered)
    assert (rendered[0] != rendered[3]).any()
    assert robot_env().render() is None


def test_other_render_modes_are_refused() -> None:
    with pytest.raises(SettingError, match="rgb_array"):
        robot_env(render_mode="human")
