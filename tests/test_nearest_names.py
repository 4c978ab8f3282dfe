"""A misspelt field or name is answered with the nearest one that exists."""

import shutil
from pathlib import Path

import pytest

import crowdbench
from crowdbench.cli import main
from crowdbench.errors import CrowdbenchError, SceneError, SettingError, did_you_mean
from crowdbench.leaderboard.submission.parse import FILE
from crowdbench.scene import load_scene
from crowdbench.simulation import Settings
from crowdbench.spawn.steering.scenario import read_scenario

PLAZA = load_scene("plaza-v0")


def test_only_a_name_that_is_alike_is_suggested() -> None:
    assert did_you_mean("aera", ["goal", "area"]) == "Did you mean `area`?"
    assert did_you_mean("aera", ["goal", "area"], "Read on.") == "Did you mean `area`? Read on."
    assert did_you_mean("xyz", ["goal", "area"], "Read on.") == "Read on."
    assert did_you_mean("xyz", ["goal", "area"]) == ""


SCENARIO = 'schema = 1\nscene = "plaza-v0"\n'


@pytest.mark.parametrize(
    ("text", "nearest"),
    [
        ("closed_gaols = [0]\n", "closed_goals"),
        ("[[change]]\naera = 0\n", "area"),
        ("[[change]]\narea = 0\nfactors = 2\n", "factor"),
        ("[[add]]\nmaen_m = [0.0, 0.0]\n", "mean_m"),
    ],
)
def test_a_misspelt_field_of_a_scenario(text: str, nearest: str, tmp_path: Path) -> None:
    path = tmp_path / "busy.toml"
    path.write_text(SCENARIO + text)
    areas = crowdbench.spawn_model("poisson-gmm", PLAZA).areas  # type: ignore[attr-defined]
    with pytest.raises(SettingError, match=f"unknown field.*Did you mean `{nearest}`\\?"):
        read_scenario(path, PLAZA, areas)


@pytest.mark.parametrize(
    ("right", "wrong"),
    [
        ("dt_s", "dts_s"),
        ("max_speed_mps", "max_sped_mps"),
        ("corners_m", "corner_m"),
        ("spawn_eps_m", "spawn_esp_m"),
    ],
)
def test_a_misspelt_field_of_a_scene(right: str, wrong: str, tmp_path: Path) -> None:
    folder = tmp_path / "mine-v0"
    shutil.copytree(load_scene("eth-v0").folder, folder, ignore=shutil.ignore_patterns("policies"))
    text = (folder / "scene.toml").read_text()
    assert f"\n{right} = " in text
    (folder / "scene.toml").write_text(text.replace(f"\n{right} = ", f"\n{wrong} = ", 1))
    with pytest.raises(SceneError, match=f"Did you mean `{right}`\\?"):
        load_scene(folder)


NAMES = {
    "scene": (lambda: load_scene("ehth-v0"), "eth-v0"),
    "policy": (lambda: crowdbench.policy("social-forces", PLAZA), "social-force"),
    "shipped policy": (lambda: crowdbench.policy("antcipate", "eth-v0"), "anticipate"),
    "spawn model": (lambda: crowdbench.spawn_model("ntppgmm", PLAZA), "ntpp-gmm"),
    "observation": (lambda: Settings(observation="lidar2"), "lidar-2"),
}


@pytest.mark.parametrize("what", NAMES)
def test_a_misspelt_name(what: str) -> None:
    ask, nearest = NAMES[what]
    with pytest.raises(CrowdbenchError, match=f"Did you mean `{nearest}`\\?"):
        ask()


@pytest.mark.parametrize(
    ("command", "nearest"),
    [
        (["data", "fetch", "hotl"], "hotel"),
        (["scene", "fit", "plaza-v0", "--models", "cox-gm"], "cox-gmm"),
        (["data", "import", "x", "--source", "x", "--format", "trajnt"], "trajnet"),
    ],
)
def test_a_misspelt_name_in_a_command(
    command: list[str], nearest: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(command) == 2
    assert f"Did you mean `{nearest}`?" in capsys.readouterr().err


def test_a_misspelt_field_of_a_submission(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "mine"
    assert main(["submit", "init", str(folder), "--track", "walk"]) == 0
    text = (folder / FILE).read_text()
    assert "\ntrack = " in text
    (folder / FILE).write_text(text.replace("\ntrack = ", "\ntrak = "))
    capsys.readouterr()
    assert main(["submit", "check", str(folder)]) != 0
    told = "".join(capsys.readouterr())
    assert "Did you mean `track`?" in " ".join(told.split())
