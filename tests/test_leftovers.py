"""What is temporary goes with the processes that made it, or at the next start."""

import os
from pathlib import Path

import pytest

from crowdbench import leftovers
from crowdbench.files import replacing
from crowdbench.leftovers import swept, temporary, temporary_folder

LONG_AGO = 1_000_000_000


@pytest.fixture(autouse=True)
def temporaries(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "tmp"
    folder.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(folder))
    return folder


def test_a_folder_is_there_in_the_block_and_not_after_it(temporaries: Path) -> None:
    with temporary_folder("test") as folder:
        (folder / "inside").mkdir()
        assert folder.parent == temporaries
    assert list(temporaries.iterdir()) == []


def test_what_dead_runs_left_is_removed_at_the_next_start_and_what_is_in_use_is_not(
    temporaries: Path,
) -> None:
    abandoned, young = (temporaries / f"crowdbench-tmp-test-{name}" for name in ("old", "new"))
    for folder in (abandoned, young):
        folder.mkdir()
        (folder / "file").touch()
    os.utime(abandoned, (LONG_AGO, LONG_AGO))
    other = temporaries / "of-somebody-else"
    other.mkdir()
    os.utime(other, (LONG_AGO, LONG_AGO))
    with temporary_folder("test") as used:
        os.utime(used, (LONG_AGO, LONG_AGO))
        with temporary_folder("test"):
            assert not abandoned.exists()
            assert used.exists()
    assert sorted(temporaries.iterdir()) == sorted([young, other])


def test_the_sweeper_removes_what_is_left_and_nothing_else(tmp_path: Path) -> None:
    names = ("left", "folder", "renamed", "with a\nline", "other")
    left, folder, renamed, strange, other = (tmp_path / name for name in names)
    with swept():
        folder.mkdir()
        (folder / "inside").touch()
        for path in (left, strange, other):
            path.touch()
        for path in (left, folder, strange):
            with temporary(path):
                pass
        with temporary(renamed):
            renamed.touch()
            renamed.rename(tmp_path / "kept")
        renamed.touch()  # another file of that name
    assert sorted(p.name for p in tmp_path.iterdir()) == ["kept", "other", "renamed", "tmp"]


def test_one_sweeper_is_enough_and_it_ends_with_the_block(tmp_path: Path) -> None:
    with swept():
        first = leftovers.pipe()
        with swept():
            assert leftovers.pipe() == first
        assert leftovers.pipe() == first
    assert leftovers.pipe() is None
    with replacing(tmp_path / "file") as path:  # which needs none
        path.write_text("done")
    assert (tmp_path / "file").read_text() == "done"
