"""Scenarios: what a file says is what is meant, and what cannot be meant is refused."""

from pathlib import Path

import numpy as np
import pytest

from crowdbench.errors import SettingError
from crowdbench.registry import spawn_model
from crowdbench.scene import load_scene
from crowdbench.spawn import Addition, Change, Scenario, Steered
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.steering.scenario import read_scenario

ETH = load_scene("eth-v0")  # seven spawn and five goal areas
AREAS = read_areas(ETH)
HEAD = 'schema = 1\nscene = "eth-v0"\n'
CHANGE = HEAD + "[[change]]\narea = 1\n"
ADD = HEAD + "[[add]]\n"
ADDED = {
    "mean_m": "[3, 3]",
    "sd_m": "[0.5, 1]",
    "persons_per_min": "6",
    "goals": "{ 0 = 0.5, 2 = 0.5 }",
}


def read(folder: Path, text: str) -> Scenario:
    (folder / "quiet.toml").write_text(text)
    return read_scenario(folder / "quiet.toml", ETH, AREAS)


def added(**other: str) -> str:
    return ADD + "\n".join(f"{name} = {value}" for name, value in {**ADDED, **other}.items())


def test_a_file_is_the_same_as_python(tmp_path: Path) -> None:
    text = (
        'schema = 1\nscene = "eth-v0"\nclosed_goals = [4]\n'
        "[[change]]\narea = 1\nfactor = [[60, 2], [120, 1]]\nshift_s = -5\ngoals = { 1 = 1 }\n"
        "[[change]]\narea = 0\nfactor = 0\n"
        "[[add]]\nmean_m = [3, 3]\nsd_m = [0.5, 1]\npersons_per_min = 6\n"
        "group_size = 2\ngoals = { 0 = 0.5, 2 = 0.5 }\n"
    )
    assert read(tmp_path, text) == Scenario(
        name="quiet",
        scene="eth-v0",
        closed_goals=(4,),
        change=(
            Change(area=1, factor=((60.0, 2.0), (120.0, 1.0)), shift_s=-5.0, goals={1: 1.0}),
            Change(area=0, factor=0.0),
        ),
        add=(
            Addition(
                mean_m=(3.0, 3.0),
                sd_m=(0.5, 1.0),
                persons_per_min=6.0,
                group_size=2.0,
                goals={0: 0.5, 2: 0.5},
            ),
        ),
    )


@pytest.mark.parametrize(
    ("text", "where", "got"),
    [
        (CHANGE + "rate = 2", "change[0]", "unknown field `rate`"),
        ("schema = 2\nscene = 'eth-v0'", "", "schema = 2"),
        ("schema = 1\nscene = 'gc-v0'", "scene", "'gc-v0'"),
        ("schema = 1", "", "missing required field `scene`"),
        (HEAD + "[[change]]\narea = 7", "change 1, area", "spawn area 7"),
        (HEAD + "[[change]]\narea = -1", "change 1, area", "spawn area -1"),
        (CHANGE + "[[change]]\narea = 1", "change 2, area", "spawn area 1 a second time"),
        (CHANGE + "factor = -0.5", "change 1 (area 1), factor", "-0.5"),
        (CHANGE + "factor = 101", "change 1 (area 1), factor", "101"),
        (CHANGE + "factor = nan", "change 1 (area 1), factor", "nan"),
        (CHANGE + "factor = []", "change 1 (area 1), factor", "no steps"),
        (CHANGE + "factor = [[60, 2], [60, 1]]", "factor", "times [60, 60]"),
        (CHANGE + "factor = [[-60, 2]]", "factor", "times [-60]"),
        (CHANGE + "factor = [[60, -2]]", "factor", "-2"),
        (CHANGE + "factor = [[60]]", "change[0].factor", "length"),
        (CHANGE + "shift_s = inf", "shift_s", "inf"),
        (CHANGE + "goals = { 0 = 0.5, 1 = 0.4 }", "goals", "sum to 0.9"),
        (CHANGE + "goals = { 0 = 1.5, 1 = -0.5 }", "goals, 0", "1.5"),
        (CHANGE + "goals = { 5 = 1 }", "goals", "goal area 5"),
        (CHANGE + "goals = { door = 1 }", "change[0].goals", "Expected `int`"),
        (CHANGE + "goals = {}", "goals", "sum to 0"),
        (HEAD + "closed_goals = [5]", "closed_goals", "goal area 5"),
        (HEAD + "closed_goals = [0]", "closed_goals", "spawn area 4, 5, 6"),
        (HEAD + "closed_goals = [2]\n[[change]]\narea = 1\ngoals = { 2 = 1 }", "goals, 2", "1"),
        (added(mean_m="[30, 3]"), "add 1, mean_m", "[30, 3]"),
        (added(sd_m="[0, 1]"), "add 1, sd_m", "0"),
        (added(persons_per_min="-1"), "add 1, persons_per_min", "-1"),
        (added(group_size="0.5"), "add 1, group_size", "0.5"),
        (added(goals="{ 0 = 0.5 }"), "add 1, goals", "sum to 0.5"),
        (ADD + "mean_m = [3, 3]", "add[0]", "missing required field"),
        ("schema = ", "", "Invalid value"),
    ],
)
def test_what_cannot_be_meant_is_refused_by_file_and_place(
    tmp_path: Path, text: str, where: str, got: str
) -> None:
    with pytest.raises(SettingError) as error:
        read(tmp_path, text)
    message = str(error.value)
    assert message.startswith(f"{tmp_path / 'quiet.toml'}")
    assert where in message
    assert got in message
    assert len(message) < 400


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=r"none\.toml: got no such file"):
        spawn_model(f"poisson-gmm+{tmp_path / 'none.toml'}", ETH)


def test_a_scenario_made_in_python_is_checked_too() -> None:
    wrong = Scenario(name="mine", scene="eth-v0", change=(Change(area=9, factor=2.0),))
    with pytest.raises(SettingError, match="scenario mine, change 1, area: got spawn area 9"):
        spawn_model("poisson-gmm", ETH, scenario=wrong)


def test_replayed_people_cannot_be_steered(tmp_path: Path) -> None:
    from given import Given

    nothing = Scenario(name="mine", scene="eth-v0")
    with pytest.raises(SettingError, match="the spawn model given with start 'empty'"):
        spawn_model(Given(), ETH, scenario=nothing)


def test_a_model_is_under_one_scenario_at_most() -> None:
    nothing = Scenario(name="mine", scene="eth-v0")
    once = spawn_model("poisson-gmm", ETH, scenario=nothing)
    with pytest.raises(SettingError, match=r"poisson-gmm\+mine\+mine: got a second scenario"):
        spawn_model(once, ETH, scenario=nothing)


def test_closed_goals_leave_the_others_in_proportion() -> None:
    flow = Scenario(name="", scene="eth-v0", closed_goals=(4, 2)).flow(AREAS)
    assert (flow[:, [2, 4]] == 0).all()
    np.testing.assert_allclose(flow.sum(axis=1), 1)
    np.testing.assert_allclose(flow[0, 0] / flow[0, 1], AREAS.flow[0, 0] / AREAS.flow[0, 1])
    assert np.array_equal(flow[4], AREAS.flow[4])  # nobody of area 4 walks to the closed ones


def test_a_model_by_name_and_file_is_the_model_under_the_scenario(tmp_path: Path) -> None:
    (tmp_path / "rush.toml").write_text(CHANGE + "factor = 2.0")
    by_file = spawn_model(f"renewal-gmm+{tmp_path / 'rush.toml'}", "eth-v0")
    rush = Scenario(name="rush", scene="eth-v0", change=(Change(area=1, factor=2.0),))
    in_python = spawn_model("renewal-gmm", "eth-v0", scenario=rush)
    assert isinstance(by_file, Steered)
    assert by_file.name == in_python.name == "renewal-gmm+rush"
    samples = [m.sample(60.0, ETH, np.random.default_rng(0)) for m in (by_file, in_python)]
    assert np.array_equal(samples[0].time_s, samples[1].time_s)
    assert len(samples[0])
