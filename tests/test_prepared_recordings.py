"""Prepared recordings are kept, and made anew if they are stale or damaged."""

from dataclasses import fields, replace
from pathlib import Path

import msgspec
import numpy as np
import pytest

from crowdbench.data.recordings.catalogue import cached, prepared_folder, remove_imported
from crowdbench.data.storage import write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.registry import recording, recording_of, recordings
from crowdbench.scene import load_scene

PLAZA = load_scene("plaza-v0")


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The clusterings that were done; no recording is in memory."""
    monkeypatch.setattr(recordings, "_memory", {})
    found: list[str] = []
    fit = recordings.fit_areas

    def counted(crowd: Trajectories, scene: object, settings: object) -> object:
        found.append(crowd.scene)
        return fit(crowd, scene, settings)  # type: ignore[arg-type]

    monkeypatch.setattr(recordings, "fit_areas", counted)
    return found


def same(one: Trajectories, other: Trajectories) -> bool:
    return all(
        np.array_equal(getattr(one, f.name), getattr(other, f.name))
        if isinstance(getattr(one, f.name), np.ndarray)
        else getattr(one, f.name) == getattr(other, f.name)
        for f in fields(one)
    )


def test_a_recording_is_prepared_once(made: list[str]) -> None:
    first, second = recording_of(PLAZA), recording_of(PLAZA)
    assert len(made) == 1
    first.xy[:] = 0.0  # a copy of its own
    assert second.xy.any()
    assert recording_of(PLAZA).xy.any()


def test_another_process_finds_the_same(made: list[str]) -> None:
    first = recording_of(PLAZA)
    recordings._memory.clear()
    assert same(recording_of(PLAZA), first)
    assert len(made) == 1


def test_a_damaged_file_is_made_anew(made: list[str]) -> None:
    first = recording_of(PLAZA)
    (path,) = prepared_folder("plaza").iterdir()
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    recordings._memory.clear()
    assert same(recording_of(PLAZA), first)
    assert len(made) == 2
    assert sorted(prepared_folder("plaza").iterdir()) == [path]


def test_other_settings_and_other_tables_are_not_taken_for_it(made: list[str]) -> None:
    recording_of(PLAZA)
    wider = msgspec.structs.replace(PLAZA.clustering["default"], spawn_min_persons=4)
    recording_of(replace(PLAZA, clustering={"default": wider}))
    assert len(made) == 2
    crowd = recording("plaza")
    write_parquet(replace(crowd, provenance={"source": "changed"}), cached("plaza"))
    assert recording_of(PLAZA).provenance == {"source": "changed"}
    assert len(made) == 3


def test_it_is_removed_with_its_recording() -> None:
    write_parquet(recording("plaza"), cached("plaza"))
    recording_of(PLAZA)
    assert list(prepared_folder("plaza").iterdir())
    remove_imported("plaza")
    assert not prepared_folder("plaza").exists()


def test_a_folder_that_cannot_be_written_is_no_error(home: Path, made: list[str]) -> None:
    (home / "prepared").write_text("in the way")
    recording_of(PLAZA)
    assert len(made) == 1
