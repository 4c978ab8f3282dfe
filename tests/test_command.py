"""The commands of the baselines say what is wrong before they train anything."""

from dataclasses import dataclass
from pathlib import Path

import pytest

from baselines import ppo
from baselines.command import Command, check_numbers
from crowdbench.errors import CrowdbenchError, SettingError


@dataclass(frozen=True)
class Numbers:
    width: float = 1.0
    hidden: tuple[int, ...] = (8, 8)
    seed: int = 0
    spawn: str = "poisson-gmm"


def test_possible_numbers_pass() -> None:
    check_numbers(Numbers(), or_zero=["seed"])


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
    for scene, parts, out in (
        ("moon-v0", ["full"], None),
        ("plaza-v0", ["full", "fold9"], tmp_path),
        ("plaza-v0", ["full"], tmp_path / "file" / "folder"),
    ):
        with pytest.raises(CrowdbenchError):
            Command.of("bc", scene, parts, out, [])
    assert [f.name for f in tmp_path.iterdir()] == ["file"]


def test_by_default_the_folder_is_named_after_both(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert Command.of("bc", "plaza-v0", ["full"], None, []).out == Path("results/bc-plaza-v0")
    assert (tmp_path / "results/bc-plaza-v0").is_dir()


@pytest.mark.parametrize("wrong", ["--frames 0", "--batch-frames 0", "--worlds 0", "--parts fold9"])
def test_ppo_refuses_what_cannot_be_trained(wrong: str, tmp_path: Path, capsys) -> None:
    asked = ["--scene", "plaza-v0", "--out", str(tmp_path), *wrong.split()]
    assert ppo.main(asked) == 2
    assert "baselines.ppo: " in capsys.readouterr().err
