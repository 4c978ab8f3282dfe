"""Scenarios at work: evaluations under one, what `steer` and `areas` show, and their page."""

import re
import shlex
from pathlib import Path

import msgspec
import pages
import pytest
from PIL import Image

import crowdbench
from crowdbench.cli import main
from crowdbench.report.steering.changes import Steering, area_changes, goal_changes, steering
from crowdbench.run.jobs import plan
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import may_rank
from crowdbench.scoring.scorecard import Scorecard

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "steering.md").read_text()
PLAZA = load_scene("plaza-v0")  # four areas of either kind
BUSY = """
schema = 1
scene = "plaza-v0"
closed_goals = [3]

[[change]]
area = 0
factor = [[600, 3], [1200, 1]]

[[change]]
area = 2
factor = 0

[[add]]
mean_m = [15, 10]
sd_m = [0.5, 0.5]
persons_per_min = 6
goals = { 0 = 1 }
"""
Printed = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def busy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("scenarios") / "busy.toml"
    path.write_text(BUSY)
    return path


@pytest.fixture(scope="module")
def found(busy: Path) -> Steering:
    return steering("plaza-v0", busy, seeds=20)


def test_numbers_say_what_changed_and_that_nothing_else_did(found: Steering) -> None:
    each = area_changes(found)
    for area in (1, 3):
        assert each[area].usual == each[area].asked == each[area].steered
        assert each[area].same_entry == 1
    assert each[0].asked == pytest.approx(each[0].usual * (1200 + 3 * 600) / 1800)
    assert each[0].steered == pytest.approx(each[0].asked, rel=0.1)
    assert 0.2 < (each[0].same_entry or 0) < 0.5  # a third comes before the first step
    assert (each[2].asked, each[2].steered, each[2].same_entry) == (0, 0, 0)
    assert each[4].asked == pytest.approx(6 * 30)
    assert each[4].steered == pytest.approx(180, rel=0.1)
    assert (each[4].usual, each[4].same_entry) == (0, None)


def test_who_would_have_walked_to_a_closed_goal_walks_elsewhere(found: Steering) -> None:
    each = goal_changes(found)
    assert (each[3].asked, each[3].steered) == (0, 0)
    assert sum(g.asked for g in each) == pytest.approx(sum(a.asked for a in area_changes(found)))
    for goal in each[:3]:
        assert goal.steered == pytest.approx(goal.asked, rel=0.1)
    shares = [(a.same_goal, found.areas.flow[a.area, 3]) for a in area_changes(found)[:4]]
    for area in (1, 3):
        kept, closed = shares[area]
        assert kept == pytest.approx(1 - closed, abs=0.05)


def test_the_command_prints_and_draws_what_changed(
    busy: Path, tmp_path: Path, capsys: Printed
) -> None:
    asked = ["spawn", "steer", "plaza-v0", str(busy), "--seeds", "1", "--out", str(tmp_path)]
    assert main(asked) == 0
    printed = capsys.readouterr().out
    assert "ntpp-gmm+busy on plaza-v0: persons per episode of 1800 s, mean of 1 episode" in printed
    lines = [line.split() for line in printed.splitlines() if re.match(r" \d", line)]
    assert [line[0] for line in lines] == [*"01234", *"0123"]
    assert lines[1][-3] == "all"
    assert lines[2][-2:] == ["none", "none"]
    for name in ("busy-rates.png", "busy-map.png"):
        with Image.open(tmp_path / name) as image:
            assert image.width > 900
    with Image.open(tmp_path / "busy-map.png") as image:
        assert len(image.convert("RGB").getcolors(10**6) or []) > 50


def test_areas_are_listed_and_drawn_by_number(tmp_path: Path, capsys: Printed) -> None:
    assert main(["spawn", "areas", "plaza-v0", "--out", str(tmp_path / "areas.png")]) == 0
    printed = capsys.readouterr().out
    spawn, goal = printed.split("goal area")
    assert re.findall(r"^ (\d)  ", spawn, re.M) == list("0123")
    assert re.findall(r"^ (\d)  ", goal, re.M) == list("0123")
    assert "2 (57), 0 (33), 1 (9)" in spawn
    assert (tmp_path / "areas.png").stat().st_size > 5000


def test_a_broken_scenario_is_one_message(tmp_path: Path, capsys: Printed) -> None:
    path = tmp_path / "broken.toml"
    path.write_text(BUSY.replace("area = 2", "area = 8"))
    for asked in (
        ["spawn", "steer", "plaza-v0", str(path)],
        ["evaluate", "plaza-v0", "--scenario", str(path)],
    ):
        assert main(asked) == 2
        printed = capsys.readouterr()
        assert printed.err == (
            f"crowdbench: {path}, change 2, area: got spawn area 8; expected one of the 4 spawn "
            "areas of plaza-v0, 0 to 3. See `crowdbench spawn areas plaza-v0`.\n"
        )
        assert not printed.out


def test_an_evaluation_under_a_scenario_has_distances_and_no_ranks(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("quiet.toml").write_text('schema = 1\nscene = "eth-v0"\n[[change]]\narea = 1\nfactor = 0')
    asked = ["evaluate", "eth-v0", "--scenario", "quiet.toml", "--spawn", "renewal-gmm"]
    asked += ["--policy", "straight", "--seeds", "1", "--workers", "1", "--out", "out"]
    assert main(asked) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "renewal-gmm+quiet × straight" in printed
    assert "is meant to differ from the recording" in printed
    (entry,) = msgspec.json.decode(Path("out/scorecard.json").read_bytes(), type=Scorecard).entries
    assert (entry.spawn, entry.policy) == ("renewal-gmm+quiet.toml", "straight")
    assert (entry.metrics["spawns_per_10_frames"].distance or 0) > 0.5
    assert 0 < entry.persons < 250  # without the busier of the two doors
    report = Path("out/report.html").read_text()
    assert "is meant to differ from the recording" in report
    assert "--spawn renewal-gmm+quiet.toml" in report


def test_who_is_steered_competes_with_nobody() -> None:
    names = ("ntpp-gmm", "ntpp-gmm+busy.toml", "replay", "pkg.module:Class")
    assert [may_rank(name) for name in names] == [True, False, False, True]


def test_a_changed_scenario_makes_new_rollouts(tmp_path: Path) -> None:
    path = tmp_path / "quiet.toml"

    def fingerprints(text: str) -> set[str]:
        path.write_text(text)
        pairs = [(f"poisson-gmm+{path}", "straight"), ("poisson-gmm", "straight")]
        jobs = plan("plaza-v0", PLAZA, pairs, "full", 1, tmp_path)
        return {job.fingerprint for job in jobs}

    before, after = fingerprints(BUSY), fingerprints(BUSY.replace("3]", "2]"))
    assert len(before) == len(after) == 2
    assert len(before & after) == 1  # of the model that is not steered


def test_a_scenarios_times_and_areas_hold_in_an_environment(busy: Path) -> None:
    env = crowdbench.parallel_env("plaza-v0", spawn=f"poisson-gmm+{busy}", horizon_s=60.0)
    env.reset(seed=1)
    while env.agents:
        env.step({agent: env.action_space(agent).low * 0 for agent in env.agents})
    crowd = env.trajectories()
    areas = set(crowd.spawn_area.tolist())
    assert 4 in areas
    assert 2 not in areas
    assert 3 not in set(crowd.goal_area.tolist())


def commands() -> list[list[str]]:
    lines = "\n".join(pages.blocks(PAGE, "sh")).splitlines()
    return [shlex.split(line, comments=True) for line in lines if line.startswith("crowdbench")]


def test_the_page_names_files_that_are_there() -> None:
    named = re.findall(r"\((steering/[^)]*)\)|(docs/steering/[a-z_]*\.toml)", PAGE)
    files = [DOCS.parent / b if b else DOCS / a for a, b in named]
    assert len(files) >= 6
    assert all(file.exists() for file in files)


def test_the_scenarios_of_the_page_are_the_files() -> None:
    shown = pages.blocks(PAGE, "toml")
    files = [
        (DOCS / "steering" / f"{name}.toml").read_text() for name in ("rush_hour", "closed_door")
    ]
    assert all(file in shown for file in files)


@pytest.mark.parametrize("name", ["rush_hour", "closed_door"])
def test_the_tables_of_the_page_are_what_its_commands_print(name: str) -> None:
    asked = next(c for c in commands() if c[2] == "steer" and c[4].endswith(f"{name}.toml"))
    found = steering(asked[3], DOCS.parent / asked[4])
    (shown,) = [block for block in pages.blocks(PAGE, "text") if f"+{name} on" in block]
    lines = [re.findall(r"[\d.]+", line) for line in shown.splitlines() if re.match(r" \d", line)]
    counted = [*area_changes(found), *goal_changes(found)]
    assert len(lines) == len(counted)
    for line, change in zip(lines, counted, strict=True):
        values = [float(v) for v in line[3:6]]
        # Another processor rounds otherwise, and a sample goes on from what it rounded.
        expected = [change.usual, change.asked, change.steered]
        assert values == pytest.approx(expected, rel=0.02, abs=1.0)
    untouched = [a for a in area_changes(found) if a.area not in found.touched]
    assert all(a.same_entry == 1 and a.usual == a.steered for a in untouched)


def test_the_python_of_the_page_runs(capsys: Printed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(DOCS.parent)
    for block in pages.blocks(PAGE, "python"):
        exec(compile(block, "docs/steering.md", "exec"), {})
    assert capsys.readouterr().out
