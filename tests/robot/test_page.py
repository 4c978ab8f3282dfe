"""The page on robots runs: on the plaza, with fewer episodes."""

import shlex
from pathlib import Path
from typing import get_args

import pages
import pytest
from conftest import need_sb3

from crowdbench.cli import main
from crowdbench.cli.robots import Task as CommandTask
from crowdbench.robot.config import Task
from crowdbench.robot.controllers import BUILT_IN
from crowdbench.robot.costs import COSTS
from crowdbench.robot.measures import MEASURES
from crowdbench.robot.network import RobotNetwork
from crowdbench.robot.robots import ROBOTS
from crowdbench.robot.tasks import MEASURES as FOLLOWING

PAGE = (Path(__file__).parents[2] / "docs" / "robots.md").read_text()


def run(words: str) -> None:
    code = pages.block_with(PAGE, words).replace("eth-v0", "plaza-v0")
    exec(compile(code.replace("episodes=20", "episodes=2"), "robots.md", "exec"), {})


def test_a_robot_drives_through_an_episode(capsys: pytest.CaptureFixture[str]) -> None:
    run("gymnasium.make")
    success, collision, _ = capsys.readouterr().out.split()
    assert {success, collision} <= {"0.0", "1.0"}


def test_an_episode_is_recorded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    run("write_socnav3")
    assert capsys.readouterr().out.startswith("11 (11, 2)")
    assert {file.name for file in tmp_path.iterdir()} == {
        "robot.png", "episode.csv", "episode.json",
    }  # fmt: skip


def test_a_controller_of_ones_own_is_compared(capsys: pytest.CaptureFixture[str]) -> None:
    run("class Polite")
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [
        "straight", "polite",
    ]  # fmt: skip


def test_the_command_runs(capsys: pytest.CaptureFixture[str]) -> None:
    (command,) = pages.commands(PAGE)
    quick = command.replace("eth-v0", "plaza-v0").replace("500", "2")
    assert main([*shlex.split(quick)[1:], "--workers", "1"]) == 0
    assert "dwa" in capsys.readouterr().out


def test_the_command_has_the_tasks_of_the_environment() -> None:
    assert get_args(CommandTask) == get_args(Task)


def test_the_tables_name_all_that_there_is() -> None:
    for name in (*MEASURES, *FOLLOWING, *COSTS, *get_args(Task), *ROBOTS, *BUILT_IN):
        assert f"`{name}`" in PAGE, name


@pytest.mark.nightly
def test_a_robot_is_trained_in_twenty_lines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    need_sb3()
    monkeypatch.chdir(tmp_path)
    code = pages.block_with(PAGE, "export_robot")
    assert len(code.splitlines()) <= 20
    quick = code.replace("400_000", "512").replace("num_envs=64", "num_envs=4")
    exec(compile(quick.replace("eth-v0", "plaza-v0"), "robots.md", "exec"), {})
    assert RobotNetwork("robot.onnx").card.robot == "delivery"
