"""Controllers are compared in the same episodes, with intervals and ranks."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.cli import main
from crowdbench.errors import OwnCodeError, SettingError
from crowdbench.robot import comparison
from crowdbench.robot.comparison import compare, drive, printed, summarised
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.controllers import Straight
from crowdbench.robot.statistics import mean, resamples, share
from crowdbench.scene import load_scene

PLAZA = load_scene("plaza-v0")
QUICK = {"walkers": "straight", "time_limit_s": 8.0, "collision": "count", "workers": 1}


class Stands(Straight):
    name = "stands"

    def act(self, view):
        return np.zeros((len(view.position), 2), np.float32)


class Broken(Straight):
    name = "broken"

    def act(self, view):
        return np.full((1, 2), np.nan, np.float32)


def test_wilson_intervals_are_those_of_the_literature() -> None:
    # Newcombe (1998), Statistics in Medicine 17, 857-872, table I.
    for events, of, low, high in ((81, 263, 0.2553, 0.3662), (0, 20, 0.0, 0.1611)):
        found = share(events, of)
        assert (found.low, found.high) == pytest.approx((low, high), abs=1e-4)


@given(st.lists(st.floats(-10, 10) | st.just(np.nan), min_size=2, max_size=30))
def test_the_interval_of_a_mean_lies_within_its_values(values: list[float]) -> None:
    array = np.array(values)
    found = mean(array, resamples(len(array), 0))
    if np.isnan(array).all():
        assert found.value is None
    else:
        low, high = np.nanmin(array), np.nanmax(array)
        assert low - 1e-9 <= found.low <= found.high <= high + 1e-9


def test_robots_that_differ_often_have_ranks_and_others_share_one() -> None:
    def reaching(goals: int) -> dict[str, np.ndarray]:
        return {"success": (np.arange(100) < goals).astype(float), "time_s": np.arange(100.0)}

    found = summarised("abc", [reaching(50), reaching(90), reaching(52)], 0)
    assert [of.rank for of in found] == [2, 1, 2]
    assert found[1].measures["time_s"].value == pytest.approx(44.5)  # of those that arrived


def test_episodes_do_not_depend_on_who_else_drives_and_how_many_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    alone = compare(PLAZA, ["straight"], episodes=4, **QUICK)
    monkeypatch.setattr(comparison, "BATCH", 3)
    both = compare(PLAZA, [Stands(), "straight"], episodes=4, **QUICK)
    assert both.results[1].measures == alone.results[0].measures
    assert both.results[0].measures["timeout"].value == 1.0
    assert both.results[0].measures["time_s"].value is None
    assert (both.walkers, both.spawn, both.period_s) == ("straight", "ntpp-gmm", PLAZA.dt_s)
    columns, rows, _ = printed(both)
    assert [row[0] for row in rows] == ["stands", "straight"]
    assert all(len(row) == len(columns) for row in rows)


def test_costs_are_shown_if_they_are_asked_for() -> None:
    found = compare(PLAZA, ["straight"], episodes=2, costs=True, **QUICK)
    assert "people's time, s" in printed(found)[0]


@pytest.mark.parametrize(
    ("controllers", "settings", "told"),
    [
        (["dwb"], {}, "Did you mean `dwa`"),
        ([], {}, "one or more"),
        (["straight", "straight"], {}, "straight twice"),
        (["straight"], {"episodes": 0}, "2 or more"),
        (["straight"], {"seed": -1}, "0 or more"),
        (["straight"], {"robot": "delivry"}, "Did you mean `delivery`"),
        (["straight"], {"walkers": "nobody"}, "nobody"),
        (["straight"], {"workers": 0}, "1 to 10,000"),
    ],
)
def test_wrong_input_is_told_before_anybody_drives(
    controllers: list[str], settings: dict, told: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(comparison, "drive", None)
    with pytest.raises(SettingError, match=told):
        compare(PLAZA, controllers, **QUICK | settings)


def test_a_controller_that_returns_nonsense_is_named() -> None:
    with pytest.raises(OwnCodeError, match="controller broken"):
        drive(Broken(), 0, 2, PLAZA, RobotConfig(walkers="straight"))


def test_the_command_prints_a_table_and_writes_json(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "robots.json"
    command = "robots --scene plaza-v0 --walkers straight --controllers straight dwa --episodes 2"
    quick = ["--time-limit-s", "8", "--workers", "1", "--json", str(file)]
    assert main([*command.split(), *quick]) == 0
    assert "2 episodes of the robot delivery" in capsys.readouterr().out
    written = json.loads(file.read_text())
    assert [of["controller"] for of in written["results"]] == ["straight", "dwa"]
    assert main(["robots", "--scene", "plaza-v0", "--controllers", "dwb"]) == 2
    assert "Did you mean `dwa`" in capsys.readouterr().err
