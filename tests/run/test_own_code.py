"""Classes of the user's own that raise: one message, exit code 2, and what was made is kept."""

import os
import re
import sys
from pathlib import Path

import pytest

from crowdbench.cli import main

MINE = """
import os, signal
import numpy as np
from crowdbench.policies import Straight


class Init(Straight):
    def __init__(self):
        {}["a key"]


class Arguments(Straight):
    def __init__(self, size):
        pass


class Reset(Straight):
    def reset(self, scene, rng):
        raise RuntimeError("not\\ntoday")


class Act(Straight):
    def act(self, seen):
        return helped(0)


def helped(by):
    return 1 / by


class Library(Straight):
    def act(self, seen):
        return np.linalg.inv(np.zeros((2, 2)))


class Leaving(Straight):
    def act(self, seen):
        raise SystemExit(7)


class Dying(Straight):
    def act(self, seen):
        os.kill(os.getpid(), signal.SIGKILL)


class Wrong(Straight):
    name = "wrong"

    def act(self, seen):
        return "north"


class Spawn:
    name, start = "mine", "empty"

    def __init__(self, scene):
        pass

    def sample(self, horizon_s, scene, rng):
        raise ValueError("nobody comes")
"""


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "mine.py").write_text(MINE)
    (tmp_path / "broken.py").write_text("import os\nos.nothing()\nclass A: pass\n")
    (tmp_path / "unwritten.py").write_text("class A:\n    def act(self:\n")
    for name in ("mine", "broken", "unwritten"):  # another test's
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def told(capsys: pytest.CaptureFixture[str], *asked: str) -> str:
    """The message of an evaluation that ends with code 2."""
    command = ["evaluate", "eth-v0", "--seeds", "1", "--out", "out", *asked]
    assert main(command) == 2
    err = capsys.readouterr().err
    assert "Traceback" not in err
    (line,) = [line for line in err.splitlines() if line.startswith("crowdbench: ")]
    return line


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("mine:Init", "mine:Init: got KeyError: 'a key' (mine.py:9, __init__)"),
        ("mine:Arguments", "expected a class that is called with the scene"),
        ("broken:A", "module 'os' has no attribute 'nothing'"),
        ("unwritten:A", "SyntaxError: '(' was never closed (unwritten.py:2)"),
    ],
)
def test_a_class_that_cannot_be_made_is_told_before_the_first_rollout(
    name: str, message: str, mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in told(capsys, "--spawn", "poisson-gmm", "--policy", name, "--workers", "1")
    assert not Path("out").exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("Reset", "got RuntimeError: not today (mine.py:19, reset)"),
        ("Act", "got ZeroDivisionError: division by zero (mine.py:28, helped)"),
        ("Library", "got LinAlgError: Singular matrix (mine.py:33, act)"),
        ("Leaving", "got SystemExit: 7 (mine.py:38, act)"),
        ("Wrong", "from act"),
    ],
)
def test_a_policy_that_raises_is_told_with_its_line_and_the_rollout(
    name: str, message: str, mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["--spawn", "poisson-gmm", "--policy", f"mine:{name}", "--workers", "1"]
    line = told(capsys, *asked)
    assert message in line
    assert f"rollout 0 of poisson-gmm × mine:{name} on eth-v0 (full)" in line


def test_a_spawn_model_that_raises_is_told_likewise(
    mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = told(capsys, "--spawn", "mine:Spawn", "--policy", "straight", "--workers", "1")
    assert line.startswith("crowdbench: spawn model mine:Spawn, rollout 0 of mine:Spawn × straight")
    assert "got ValueError: nobody comes (mine.py:60, sample)" in line


@pytest.mark.usefixtures("no_report")
@pytest.mark.parametrize(
    ("name", "message"),
    [("Act", "ZeroDivisionError: division by zero (mine.py:28, helped)"),
     ("Dying", "a worker process that ended with SIGKILL")],
)  # fmt: skip
def test_workers_tell_it_too_and_what_was_made_before_is_kept(
    name: str, message: str, mine: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    crowds = ["--spawn", "poisson-gmm", "--policy", "straight"]
    assert main(["evaluate", "eth-v0", "--seeds", "2", "--out", "out", *crowds]) == 0
    for made in ("report.html", "scorecard.json", "tables.md"):
        Path("out", made).unlink(missing_ok=True)
    line = told(capsys, *crowds, f"mine:{name}", "--seeds", "3", "--workers", "2")
    assert message in line
    assert re.search(r"rollout [012] of poisson-gmm × mine:", line)
    kept = sorted(path.name for path in Path("out", "rollouts").iterdir())
    assert "poisson-gmm_straight_full_0.parquet" in kept
    assert not [name for name in kept if name.startswith(".") or "mine" in name]
    assert os.listdir("out") == ["rollouts"]
