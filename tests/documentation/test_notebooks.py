"""The notebooks run from the first cell to the last, with shorter trainings."""

import json
import shlex
from pathlib import Path
from typing import Any

import pytest
from conftest import need_sb3

from crowdbench.cli import main

FOLDER = Path(__file__).parents[2] / "docs" / "notebooks"
SMALLER = {
    "model.learn(300_000)": "model.learn(4096)",
    'imitate(model, "dwa")': 'imitate(model, "dwa", rounds=1)',
    "episodes=100": "episodes=6, workers=1",
    "Robot-eth-v0": "Robot-plaza-v0",
    '"eth-v0"': '"plaza-v0"',
}


def cells(name: str) -> list[dict[str, Any]]:
    found: list[dict[str, Any]] = json.loads((FOLDER / f"{name}.ipynb").read_text())["cells"]
    return found


def play(name: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> dict[str, Any]:
    """Run the code of a notebook in a folder; what it defines."""
    monkeypatch.chdir(folder)
    world: dict[str, Any] = {}
    for cell in cells(name):
        code = "".join(cell["source"])
        if cell["cell_type"] != "code" or code.startswith("%pip"):
            continue
        for usual, smaller in SMALLER.items():
            code = code.replace(usual, smaller)
        if code.startswith("!crowdbench "):
            ended = main(shlex.split(code)[1:])
            assert ended == 0 or "submit check" in code  # which says what is missing
        else:
            exec(compile(code, f"{name}.ipynb", "exec"), world)
    return world


@pytest.mark.parametrize("path", sorted(FOLDER.glob("*.ipynb")), ids=lambda p: str(p.stem))
def test_a_notebook_is_one_without_outputs(path: Path) -> None:
    book = json.loads(path.read_text())
    assert (book["nbformat"], book["metadata"]["language_info"]["name"]) == (4, "python")
    assert "".join(book["cells"][0]["source"]).startswith("# ")
    for cell in book["cells"]:
        assert cell.get("outputs", []) == []
        assert cell.get("execution_count") is None


@pytest.mark.long
def test_a_crowd_in_ten_minutes(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    world = play("crowd", monkeypatch, tmp_path)
    assert (tmp_path / "results/plaza/report.html").is_file()
    assert len(world["figure"].axes) == 4
    assert "cox-plans    social-force" in capsys.readouterr().out


@pytest.mark.nightly
def test_your_own_place(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    world = play("place", monkeypatch, tmp_path)
    assert world["crowd"].scene == "passage-v0"
    assert "people, 38 numbers each" in capsys.readouterr().out


@pytest.mark.nightly
def test_a_walker_is_trained_and_submitted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    need_sb3()
    play("walker", monkeypatch, tmp_path)
    assert (tmp_path / "my-walker" / "submission.toml").is_file()
    assert "walker" in capsys.readouterr().out


@pytest.mark.nightly
def test_a_robot_is_compared_and_trained(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    need_sb3()
    world = play("robot", monkeypatch, tmp_path)
    assert [of.controller for of in world["found"].results] == ["straight", "dwa", "robot.onnx"]
    assert "costs people" in capsys.readouterr().out
