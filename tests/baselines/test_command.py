"""The commands of the baselines say what is wrong before they train anything."""

import importlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch
from conftest import need_imitation

from crowdbench.baselines import ppo
from crowdbench.baselines.command import Command, check_numbers, use_one_thread
from crowdbench.errors import CrowdbenchError, SettingError


@dataclass(frozen=True)
class Numbers:
    width: float = 1.0
    hidden: tuple[int, ...] = (8, 8)
    seed: int = 0
    spawn: str = "poisson-gmm"


def test_possible_numbers_pass() -> None:
    check_numbers(Numbers(), or_zero=["seed"])


@pytest.mark.parametrize(("asked", "threads"), [(None, 1), ("2", 2)])
def test_training_runs_on_one_thread_unless_more_are_asked_for(
    asked: str | None, threads: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    if asked:
        monkeypatch.setenv("OMP_NUM_THREADS", asked)
    before = torch.get_num_threads()
    try:
        torch.set_num_threads(2)
        use_one_thread()
        assert torch.get_num_threads() == threads
    finally:
        torch.set_num_threads(before)


@pytest.mark.parametrize(
    ("changed", "expected"),
    [
        (Numbers(width=0.0), "width: got 0; expected a number, above 0"),
        (Numbers(width=float("nan")), "width: got nan"),
        (Numbers(width=-1.0), "width: got -1"),
        (Numbers(hidden=(8, 0)), "hidden: got 0"),
        (Numbers(seed=-1), "seed: got -1; expected a number, 0 or more"),
    ],
)
def test_impossible_numbers_are_said(changed: Numbers, expected: str) -> None:
    with pytest.raises(SettingError) as raised:
        check_numbers(changed, or_zero=["seed"])
    assert expected in str(raised.value)


def test_scenes_parts_and_folders_are_looked_at_first(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    for scene, splits, out in (
        ("moon-v0", ["full"], None),
        ("plaza-v0", ["full", "fold9"], tmp_path),
        ("plaza-v0", ["full"], tmp_path / "file" / "folder"),
    ):
        with pytest.raises(CrowdbenchError):
            Command.of("bc", scene, splits, out, [])
    assert [f.name for f in tmp_path.iterdir()] == ["file"]


def test_by_default_the_folder_is_named_after_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert Command.of("bc", "plaza-v0", ["full"], None, []).out == Path("results/bc-plaza-v0")
    assert (tmp_path / "results/bc-plaza-v0").is_dir()


@pytest.mark.parametrize(
    "wrong", ["--frames 0", "--batch-frames 0", "--worlds 0", "--splits fold9"]
)
def test_ppo_refuses_what_cannot_be_trained(wrong: str, tmp_path: Path, capsys) -> None:
    asked = ["--scene", "plaza-v0", "--out", str(tmp_path), *wrong.split()]
    assert ppo.main(asked) == 2
    assert "crowdbench.baselines.ppo: " in capsys.readouterr().err


@pytest.mark.parametrize(("name", "extra"), [("bc", "imitation"), ("gail", "imitation"),
                                             ("ppo", "torchrl")])  # fmt: skip
def test_without_its_packages_a_baseline_says_what_to_install(name: str, extra: str) -> None:
    code = (
        "import runpy, sys\n"
        "sys.modules['torch'] = None\n"  # as if it were not installed
        f"runpy.run_module('crowdbench.baselines.{name}', run_name='__main__')"
    )
    run = [sys.executable, "-c", code]
    done = subprocess.run(run, capture_output=True, text=True, cwd=Path(__file__).parents[2])
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith(
        f"crowdbench.baselines: packages: got no torch; expected the packages of the extra {extra}."
    )
    assert f'-e ".[{extra},onnx]"' in done.stderr
    assert len(done.stderr.splitlines()) == 1


@pytest.mark.parametrize("name", ["bc", "bc_paper", "gail", "ppo"])
def test_every_option_is_told(name: str) -> None:
    if name != "ppo":
        need_imitation()
    parser = importlib.import_module(f"crowdbench.baselines.{name}").command_line()
    assert [a.dest for a in parser._actions if not a.help] == []
    assert "%(" not in parser.format_help()
    assert "(default: results/" in parser.format_help()


def test_a_card_names_the_options_that_change_the_policy(tmp_path: Path) -> None:
    given = ["--scene", "plaza-v0", "--out", str(tmp_path), "--workers=2", "--seed", "3"]
    given += ["--workers", "2", "--splits", "full", "fold0", "--engine", "ray", "--steps=9"]
    command = Command.of("anticipate", "plaza-v0", ["full"], tmp_path, given)
    expected = "--scene plaza-v0 --seed 3 --splits full fold0 --steps=9"
    assert command.line == f"python -m crowdbench.baselines.anticipate {expected}"
