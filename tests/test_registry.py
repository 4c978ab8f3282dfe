"""Names of recordings, spawn models and policies."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from crowdbench.cli import main
from crowdbench.data.blocks import SPLITS
from crowdbench.data.recordings.catalogue import cached
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError, WeightsError
from crowdbench.policies import ReplayPolicy
from crowdbench.registry import (
    POLICIES,
    RECORDINGS,
    SPAWN_MODELS,
    WEIGHTS,
    import_recording,
    list_policies,
    list_spawn_models,
    policy,
    recording,
    recording_of,
    spawn_model,
)
from crowdbench.run.jobs import plan
from crowdbench.scene import load_scene
from crowdbench.spawn import Replay
from crowdbench.spawn.names import replays

PLAZA = load_scene("plaza-v0")
SHIPPED = [name for name in SPAWN_MODELS if not name.endswith("-paper")]


@pytest.fixture(scope="module")
def plaza() -> Trajectories:
    return recording("plaza")


@pytest.fixture
def imported(plaza: Trajectories, home: Path) -> Path:
    """The user's copy of the plaza, imported earlier."""
    path = cached("plaza")
    write_parquet(plaza, path)
    return path


def test_the_plaza_is_there_without_an_import(plaza: Trajectories) -> None:
    assert plaza.frames == load_scene("plaza-v0").recording.frames


def test_an_imported_plaza_is_the_generated_one(plaza: Trajectories) -> None:
    import_recording("plaza")
    assert np.array_equal(recording("plaza").xy, plaza.xy)


def test_the_imported_plaza_is_read_from_the_users_folder(imported: Path) -> None:
    imported.write_bytes(b"no table")
    with pytest.raises(RecordingError, match=r"plaza\.parquet"):
        recording("plaza")


@pytest.mark.parametrize("list_names", [list_spawn_models, list_policies])
def test_each_name_is_listed_once(list_names: Callable[[str], list[str]]) -> None:
    names = list_names("plaza-v0")  # whose recording is there
    assert sorted(names) == sorted(set(names))
    assert {"replay", "straight"} & set(names)


@pytest.mark.parametrize(
    ("named", "command"),
    [
        ("runs/ppo.zip", "crowdbench policy export runs/ppo.zip runs/ppo.onnx --name NAME"),
        ("ppo.zip", "crowdbench policy export ppo.zip ppo.onnx --name NAME --scene plaza-v0"),
        ("net.pt", "crowdbench policy export pkg.module:NAME net.onnx"),
    ],
)
def test_a_network_that_is_not_exported_is_answered_with_the_command_that_does_it(
    named: str, command: str, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    with pytest.raises(SettingError, match="Export it first") as refused:
        policy(named, PLAZA)
    assert command in refused.value.hint
    asked = ["evaluate", "plaza-v0", "--policy", named, "--seeds", "1", "--out", str(tmp_path)]
    assert main(asked) == 2
    assert command in capsys.readouterr().err


def test_a_recording_must_have_been_imported() -> None:
    with pytest.raises(RecordingError, match="crowdbench data import eth"):
        recording("eth")


@pytest.mark.parametrize("find", [recording, import_recording])
def test_an_unknown_recording_is_refused(find: object) -> None:
    with pytest.raises(SettingError, match=r"'moon'.*eth, hotel, zara01, gc, forum"):
        find("moon")  # type: ignore[operator]


def test_imported_recordings_are_found(opentraj: Path) -> None:
    persons = {}
    for name in set(RECORDINGS) - {"plaza"}:
        import_recording(name, opentraj)
        persons[name] = len(recording(name))
    counted = {"eth": 360, "hotel": 390, "zara01": 148, "gc": 12_671, "forum": 1160}
    assert persons == counted


def test_a_scenes_recording_knows_its_areas(imported: Path) -> None:
    crowd = recording_of(load_scene("plaza-v0"))
    assert (crowd.spawn_area[crowd.entered] >= 0).all()
    assert (crowd.goal_area[crowd.left] >= 0).all()


@pytest.mark.parametrize("name", SHIPPED)
def test_each_listed_spawn_model_is_found(name: str, imported: Path) -> None:
    assert spawn_model(name, "plaza-v0").name == name


@pytest.mark.parametrize("name", [name for name in SHIPPED if not replays(name)])
def test_each_part_has_a_spawn_model_of_its_own(name: str, imported: Path) -> None:
    drawn = set()
    for split in SPLITS:
        model = spawn_model(name, "plaza-v0", split)
        events = model.sample(200.0, load_scene("plaza-v0"), np.random.default_rng(0))
        drawn.add(events.time_s.tobytes())
    assert len(drawn) == len(SPLITS)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_part_that_is_none_is_refused(name: str) -> None:
    with pytest.raises(SettingError, match="one of full, fold0, fold1, fold2"):
        spawn_model(name, "plaza-v0", "fold7")


def test_block_replay_needs_the_recording() -> None:
    with pytest.raises(RecordingError, match="crowdbench data import eth"):
        spawn_model("block-replay", "eth-v0")


@pytest.mark.parametrize("name", POLICIES)
def test_each_listed_policy_is_found(name: str, imported: Path) -> None:
    assert policy(name, "plaza-v0").name == name


@pytest.mark.parametrize("find", [spawn_model, policy])
def test_replay_needs_the_recording(find: object) -> None:
    with pytest.raises(RecordingError, match="crowdbench data import eth"):
        find("replay", "eth-v0")  # type: ignore[operator]


def test_both_replays_walk_the_same_recording(imported: Path) -> None:
    spawn, walker = spawn_model("replay", "plaza-v0"), policy("replay", "plaza-v0")
    assert isinstance(spawn, Replay)
    assert isinstance(walker, ReplayPolicy)
    assert np.array_equal(spawn.recording.xy, walker.recording.xy)


@pytest.mark.parametrize("file", [file for file, name in WEIGHTS.items() if name in SHIPPED])
def test_a_folder_with_fits_is_the_model_that_they_are_of(file: str, tmp_path: Path) -> None:
    folder = tmp_path / "one+more"
    folder.mkdir()
    shutil.copy(PLAZA.folder / file, folder)
    events = [
        spawn_model(name, PLAZA, "fold1", fit=2).sample(200.0, PLAZA, np.random.default_rng(0))
        for name in (str(folder), WEIGHTS[file])
    ]
    assert np.array_equal(events[0].time_s, events[1].time_s)
    with pytest.raises(WeightsError, match=r"crowdbench scene fit eth-v0 --out FOLDER"):
        spawn_model(str(folder), "eth-v0")


def test_a_folder_holds_the_fits_of_one_model(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match="no fits"):
        spawn_model(str(tmp_path), PLAZA)
    for file in ("poisson-gmm.json", "renewal-gmm.json"):
        shutil.copy(PLAZA.folder / file, tmp_path)
    with pytest.raises(
        SettingError, match=r"poisson-gmm\.json, renewal-gmm\.json; expected exactly"
    ):
        spawn_model(str(tmp_path), PLAZA)


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_evaluate_takes_a_folder_of_fits_and_sees_that_they_changed(tmp_path: Path) -> None:
    folder = tmp_path / "rates"
    folder.mkdir()
    file = Path(shutil.copy(PLAZA.folder / "poisson-gmm.json", folder))
    asked = ["evaluate", "plaza-v0", "--spawn", str(folder), "--policy", "straight", "--seeds", "2"]
    assert main([*asked, "--workers", "1", "--out", str(tmp_path / "out")]) == 0
    cards = json.loads((tmp_path / "out" / "scorecard.json").read_text())["entries"]
    assert str(folder) in {entry["spawn"] for entry in cards}

    def fingerprints() -> set[str]:
        pairs = [(str(folder), "straight")]
        return {job.fingerprint for job in plan("plaza-v0", PLAZA, pairs, "full", 1, tmp_path)}

    before = fingerprints()
    file.write_text(file.read_text() + " ")
    assert fingerprints() != before
