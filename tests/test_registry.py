"""Names of recordings, spawn models and policies."""

from pathlib import Path

import numpy as np
import pytest

from crowdbench.blocks import PARTS
from crowdbench.errors import RecordingError, SettingError
from crowdbench.policies import ReplayPolicy
from crowdbench.recordings.catalogue import cached
from crowdbench.registry import (
    POLICIES,
    RECORDINGS,
    SPAWN_MODELS,
    import_recording,
    policy,
    recording,
    recording_of,
    spawn_model,
)
from crowdbench.scene import load_scene
from crowdbench.spawn import Replay
from crowdbench.tables import write_parquet
from crowdbench.trajectories import Trajectories


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


@pytest.mark.parametrize("name", SPAWN_MODELS)
def test_each_listed_spawn_model_is_found(name: str, imported: Path) -> None:
    assert spawn_model(name, "plaza-v0").name == name


@pytest.mark.parametrize("name", [name for name in SPAWN_MODELS if name != "replay"])
def test_each_part_has_a_spawn_model_of_its_own(name: str, imported: Path) -> None:
    drawn = set()
    for part in PARTS:
        model = spawn_model(name, "plaza-v0", part)
        events = model.sample(200.0, load_scene("plaza-v0"), np.random.default_rng(0))
        drawn.add(events.time_s.tobytes())
    assert len(drawn) == len(PARTS)


@pytest.mark.parametrize("name", SPAWN_MODELS)
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
