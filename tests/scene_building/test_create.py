"""A scene made of a recording of a new place: whole or not at all, and checked."""

import json
import os
import re
import shutil
from collections.abc import Iterator
from contextlib import redirect_stdout
from dataclasses import dataclass, replace
from io import StringIO
from pathlib import Path

import made_up
import numpy as np
import pytest
from msgspec import structs
from strategies import crowd_of

import crowdbench
from crowdbench.cli import main
from crowdbench.data.table import Trajectories
from crowdbench.errors import (
    CrowdbenchError,
    OutputError,
    RecordingError,
    SceneError,
    SettingError,
    WeightsError,
)
from crowdbench.registry import recording
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building import NewScene, check_scene, create, create_scene, rules
from crowdbench.scene_building.toml import scene_toml, write_scored
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.plans.links import Adjustment

Printed = pytest.CaptureFixture[str]
SMALL = ["--fits", "1", "--rollouts-per-fit", "2", "--workers", "1"]


def geojson(folder: Path) -> Path:
    """The yard's walls in a file."""
    features = [
        {
            "type": "Feature",
            "properties": {"name": wall.name},
            "geometry": {"type": "Polygon", "coordinates": [[*wall.corners_m, wall.corners_m[0]]]},
        }
        for wall in made_up.WALLS
    ]
    path = folder / "walls.geojson"
    path.write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return path


@dataclass(frozen=True)
class Made:
    """A scene as the command makes it without torch, and what it printed."""

    scene: Scene
    crowd: Trajectories
    home: Path
    out: str


@pytest.fixture(scope="module")
def yard() -> Trajectories:
    """Not much more than three minutes."""
    return made_up.record(200.0)


@pytest.fixture(scope="module")
def made(yard: Trajectories, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Made]:
    folder = tmp_path_factory.mktemp("made")
    table = made_up.write(yard, "csv", folder)
    asked = ["--recording", str(table), "--format", "csv", "--dt-s", "0.4", "--title", "A yard"]
    asked += ["--walls", str(geojson(folder)), *SMALL]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CROWDBENCH_HOME", str(folder / "home"))
        patch.setattr(create.fit, "has_torch", lambda: False)
        # As `unadjusted`, which is a fixture of single tests.
        patch.setattr("crowdbench.scene_building.fit.adjustment", lambda *of: Adjustment())
        patch.chdir(folder)
        with redirect_stdout(StringIO()) as printed:
            assert main(["scene", "create", "yard-v0", *asked]) == 0
    yield Made(load_scene(folder / "yard-v0"), yard, folder / "home", printed.getvalue())
    shutil.rmtree(folder)


@pytest.fixture
def at_home(made: Made, monkeypatch: pytest.MonkeyPatch) -> Made:
    """The recording is imported."""
    monkeypatch.setenv("CROWDBENCH_HOME", str(made.home))
    return made


@pytest.fixture
def copied(made: Made, tmp_path: Path) -> Path:
    """A copy of the scene, to be broken."""
    return Path(shutil.copytree(made.scene.folder, tmp_path / "yard-v0"))


@pytest.mark.long
def test_one_command_makes_all_of_a_scene(made: Made) -> None:
    assert {path.name for path in made.scene.folder.iterdir()} == {
        "anchors.json.gz", "areas.json", "cox-gmm.json", "guided-walker.json", "place.png",
        "plans.json", "poisson-gmm.json", "poisson-groups.json", "reference.json.gz",
        "renewal-gmm.json",
        "scene.toml", "time.png",
    }  # fmt: skip
    assert [path.name for path in made.home.glob("recordings/*")] == ["yard.parquet"]


def test_a_scene_without_the_default_spawn_model_says_what_else_it_has(made: Made) -> None:
    with pytest.raises(WeightsError) as caught:
        crowdbench.parallel_env(made.scene.folder)
    assert caught.value.expected == "the scene's fits of ntpp-gmm"
    assert "needs torch" in caught.value.hint
    assert caught.value.hint.endswith(": poisson-gmm, poisson-groups, renewal-gmm, cox-gmm.")
    assert 'pass spawn="renewal-gmm"' in made.out
    assert crowdbench.parallel_env(made.scene.folder, spawn="renewal-gmm").reset(seed=0)


def test_no_settings_of_the_paper_are_made_up(made: Made) -> None:
    assert list(made.scene.clustering) == ["default"]


def test_its_settings_follow_from_the_recording(made: Made) -> None:
    scene = made.scene
    assert (scene.id, scene.title, scene.dt_s, scene.grid_s) == ("yard-v0", "A yard", 0.4, 0.4)
    assert scene.recording.frames == made.crowd.frames
    assert scene.inside(made.crowd.xy.astype(np.float64)).all()
    assert {wall.name for wall in scene.walls} == {wall.name for wall in made_up.WALLS}
    assert (scene.protocol.block_s, scene.protocol.resample_s) == (20.0, 20.0)
    assert (scene.protocol.fits, scene.protocol.rollouts_per_fit) == (1, 2)
    assert "inter_spawn" in scene.protocol.scored


def test_what_is_written_of_a_scene_is_read_again(tmp_path: Path) -> None:
    shipped = load_scene("gc-v0")
    scene = replace(
        shipped,
        title='Two "lines",\nand a back\\slash – é',
        clustering={"default": shipped.clustering["default"]},
        protocol=structs.replace(shipped.protocol, scored=()),
        folder=tmp_path,
    )
    text = scene_toml(scene, source="a\nb.csv", walls_file="w\nx.geojson")
    (tmp_path / "scene.toml").write_text(text)
    assert load_scene(tmp_path) == scene


def test_it_tells_times_and_what_was_left_out(made: Made) -> None:
    for step in ("read", "areas", "fits", "plans", "rollouts", "power", "walker", "pictures"):
        assert any(line.startswith(step) and "0:0" in line for line in made.out.splitlines())
    assert "left out: fitting needs torch" in made.out
    assert "fano 60 s: the time blocks are too short" in made.out
    policies = "--policy social-force guided-walker"
    assert f"crowdbench evaluate yard-v0 {policies} --spawn renewal-gmm" in made.out


@pytest.mark.long
def test_it_is_evaluated_with_its_recording(at_home: Made, tmp_path: Path, capsys: Printed) -> None:
    folder = str(at_home.scene.folder)
    pairs = ["--spawn", "renewal-gmm", "replay", "--policy", "straight", "replay"]
    assert main(["evaluate", folder, *pairs, "--workers", "1", "--out", str(tmp_path)]) == 0
    out = capsys.readouterr().out
    assert "renewal-gmm × straight" in out
    assert "need the recording" not in out
    entries = {
        (e["spawn"], e["policy"]): e
        for e in json.loads((tmp_path / "scorecard.json").read_text())["entries"]
    }
    assert entries["replay", "replay"]["metrics"]["dwell"]["distance"] == 0.0


def test_it_is_evaluated_held_out(made: Made, tmp_path: Path, capsys: Printed) -> None:
    asked = ["evaluate", str(made.scene.folder), "--protocol", "heldout", "--seeds", "1"]
    asked += ["--spawn", "renewal-gmm", "--policy", "straight", "--workers", "1"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    assert re.search(r"inter spawn +scored +[0-9.]+ s +0\.\d", capsys.readouterr().out)


def test_a_folder_here_is_found_by_its_name(
    made: Made, monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.chdir(made.scene.folder.parent)
    assert load_scene("yard-v0").title == "A yard"
    assert main(["scene", "check", "yard-v0"]) == 0
    assert "yard is not imported: nothing was compared with it" in capsys.readouterr().out


def test_nothing_is_wrong_with_it(at_home: Made) -> None:
    findings = {finding.part: finding for finding in check_scene(at_home.scene.folder)}
    assert all(finding.problem is None for finding in findings.values())
    assert findings["ntpp-gmm"].state == "missing (optional)"
    assert findings["recording"].state.endswith("areas and statistics match")


@pytest.mark.parametrize("name", ["eth-v0", "zara1-v0"])
def test_nothing_is_wrong_with_shipped_scenes(name: str) -> None:
    assert [f for f in check_scene(name) if f.problem is not None] == []


def problems(folder: Path) -> dict[str, str]:
    return {f.part: str(f.problem) for f in check_scene(folder) if f.problem is not None}


def rewrite(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))


def test_other_fits_than_the_anchors_are_told(copied: Path) -> None:
    rewrite(copied / "scene.toml", "goal_radius_m = 0.2", "goal_radius_m = 0.6")
    assert list(problems(copied)) == ["anchors"]
    assert "Run `crowdbench scene anchors" in problems(copied)["anchors"]


def test_each_missing_file_is_told_once(copied: Path) -> None:
    (copied / "areas.json").unlink()
    (copied / "anchors.json.gz").unlink()
    assert list(problems(copied)) == ["areas"]  # what needs the areas is not looked at
    (copied / "scene.toml").unlink()
    with pytest.raises(SceneError):
        problems(copied)


def test_areas_of_another_clustering_are_told(copied: Path, at_home: Made) -> None:
    rewrite(copied / "scene.toml", "spawn_eps_m = 0.", "spawn_eps_m = 1.")
    assert "areas.json: got values that do not follow" in problems(copied)["recording"]


def test_walls_where_people_walk_are_told(copied: Path, at_home: Made) -> None:
    wall = '[[walls]]\nname = "new"\ncorners_m = [[1.0, 1.0], [13.0, 1.0], [13.0, 4.0], [1.0, 4.0]]'
    rewrite(copied / "scene.toml", "[motion]", f"{wall}\n\n[motion]")
    assert (
        "of the recorded positions outside the bounds or in a wall"
        in (problems(copied)["recording"])
    )


def test_another_recording_under_its_name_is_told(copied: Path, at_home: Made) -> None:
    rewrite(copied / "scene.toml", 'sha256 = "', 'sha256 = "0')
    assert "Import the recording from which the scene was created" in problems(copied)["recording"]


def test_a_power_study_that_found_no_metric_is_no_problem(copied: Path) -> None:
    write_scored(load_scene(copied), [])
    told = {f.part: f for f in check_scene(copied)}["scored metrics"]
    assert told.problem is None
    assert told.state == "none: no metric distinguishes the anchor from the recording"
    text = (copied / "scene.toml").read_text()
    (copied / "scene.toml").write_text(text.replace("scored = []\n", ""))
    assert "no protocol.scored" in problems(copied)["scored metrics"]


def test_the_command_tells_each_problem_and_exits_with_2(copied: Path, capsys: Printed) -> None:
    (copied / "reference.json.gz").unlink()
    (copied / "poisson-gmm.json").unlink()
    assert main(["scene", "check", str(copied)]) == 2
    told = capsys.readouterr()
    assert told.out.count("wrong") == 2
    assert told.err.count("no such file") == 2
    assert "got 2 problems; expected none" in told.err


def attempt(folder: Path, crowd: Trajectories, name: str = "new-v0", **asked: object) -> None:
    table = made_up.write(crowd, "csv", folder)
    numbers = {key: asked.pop(key) for key in ("fits", "rollouts_per_fit") if key in asked}
    new = NewScene(name=name, out=folder / "new-v0", **numbers)  # type: ignore[arg-type]
    options = {"dt_s": 0.4, "layout": "csv", "workers": 1}
    create_scene(new, table, **(options | asked))  # type: ignore[arg-type]


def remains(folder: Path) -> list[str]:
    """What a failed attempt left, beside the recording that it was given."""
    imported = Path(os.environ["CROWDBENCH_HOME"]).rglob("*.parquet")
    return [path.name for path in (*folder.iterdir(), *imported) if "yard-csv" not in path.name]


@pytest.mark.parametrize(
    ("asked", "error", "message"),
    [
        ({"name": "Yard"}, SettingError, "lower-case letters, digits and _, followed by -v0"),
        ({"name": "eth-v0"}, SettingError, "a scene that comes with crowdbench"),
        ({"name": "plaza-v1"}, SettingError, "a new name of lower-case letters"),
        ({"fits": 0}, SettingError, "--fits: got 0; expected 1 to 100"),
        ({"rollouts_per_fit": 1}, SettingError, "expected 2 to 100"),
        ({"dt_s": None}, RecordingError, "--dt-s SECONDS"),
        ({"walls": Path("nowhere.wkt")}, SceneError, "no such file"),
    ],
)
def test_what_cannot_be_made_leaves_nothing(
    yard: Trajectories,
    tmp_path: Path,
    asked: dict[str, object],
    error: type[CrowdbenchError],
    message: str,
) -> None:
    with pytest.raises(error, match=message):
        attempt(tmp_path, yard, **asked)
    assert remains(tmp_path) == []


@pytest.mark.usefixtures("unadjusted")
def test_what_breaks_on_the_way_leaves_nothing(
    yard: Trajectories, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object, **__: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(create, "power_study", interrupt)
    monkeypatch.setattr(create.fit, "has_torch", lambda: False)
    with pytest.raises(KeyboardInterrupt):
        attempt(tmp_path, yard)
    assert remains(tmp_path) == []


def test_a_folder_that_is_there_is_not_touched(yard: Trajectories, tmp_path: Path) -> None:
    (tmp_path / "new-v0").mkdir()
    (tmp_path / "new-v0" / "mine.txt").write_text("mine")
    with pytest.raises(OutputError, match="a path that exists already"):
        attempt(tmp_path, yard)
    assert [path.name for path in (tmp_path / "new-v0").iterdir()] == ["mine.txt"]


def test_walls_that_people_walk_through_are_refused(yard: Trajectories, tmp_path: Path) -> None:
    walls = tmp_path / "walls.wkt"
    walls.write_text("POLYGON ((1 1, 13 1, 13 4, 1 4, 1 1))")
    with pytest.raises(SceneError, match=r"walls\.wkt: got walls that contain \d+.\d%"):
        attempt(tmp_path, yard, walls=walls)


def test_a_recording_that_is_too_short_is_told_how_long_it_must_be(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"got 100 s of observation; expected 180 s or more"):
        attempt(tmp_path, made_up.record(99.5))


def test_a_recording_of_too_few_is_refused() -> None:
    crowd = crowd_of([(k, k + 20) for k in range(1, 20)], frames=1000, dt_s=0.4)
    with pytest.raises(RecordingError, match=r"got 19 persons .* expected 30 or more"):
        rules.check_size(crowd, "here")


@pytest.mark.parametrize(
    "name", ["eth-v0", "hotel-v0", "zara1-v0", "forum-v0", "gc-v0", "plaza-v0"]
)
def test_the_shipped_scenes_have_about_the_protocol_of_the_rules(name: str) -> None:
    """Blocks by the observed time, which their reference statistics know."""
    scene = load_scene(name)
    observed = read_reference(scene).blocks.frames
    crowd = crowd_of([(0, 1)], frames=scene.recording.frames, observed=observed, dt_s=scene.dt_s)
    found = rules.protocol_of(crowd, fits=None, rollouts_per_fit=None)
    assert (found.block_s, found.resample_s) == (
        scene.protocol.block_s, scene.protocol.resample_s,
    )  # fmt: skip


def test_areas_are_found_in_eth_with_the_settings_that_it_ships(opentraj: Path) -> None:
    assert main(["data", "import", "eth", "--source", str(opentraj)]) == 0
    assert (
        rules.clustering_of(recording("eth"), "eth") == load_scene("eth-v0").clustering["default"]
    )


def test_people_who_start_all_over_the_place_are_no_areas() -> None:
    rng = np.random.default_rng(0)
    xy = rng.uniform(0, 200, (80, 2))
    crowd = crowd_of([(2 * k + 1, 2 * k + 2) for k in range(40)], frames=200, dt_s=0.4, xy=xy)
    with pytest.raises(RecordingError, match="Tracks may be fragmented"):
        rules.clustering_of(crowd, "here")


def test_faster_people_raise_the_speed_limit() -> None:
    steps = np.cumsum(np.r_[np.full(50, 0.4), np.full(50, 3.0)])
    crowd = crowd_of([(0, 99)], dt_s=0.4, xy=np.c_[steps, np.zeros(100)])
    assert rules.motion_of(crowd).max_speed_mps == 8.0
    slow = replace(crowd, xy=(crowd.xy / 10).astype(np.float32))
    assert rules.motion_of(slow).max_speed_mps == 5.0
    assert rules.motion_of(slow).goal_radius_m == 0.2
