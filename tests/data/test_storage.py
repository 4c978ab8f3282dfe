import inspect
import json
import os
import pickle
from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pyarrow import parquet
from strategies import crowd_of, crowds, differences

from crowdbench import errors
from crowdbench.data.storage import read, read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import CrowdbenchError, OutputError, RecordingError
from crowdbench.files import replacing, temporary_folder, write_json, write_text


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("tables")


def read_csv(folder: Path, text: str, *, dt_s: float = 0.4, frames: int | None = None):
    path = folder / "crowd.csv"
    path.write_text(text)
    return read(path, scene="eth-v0", dt_s=dt_s, frames=frames)


@given(crowd=crowds())
def test_a_table_comes_back_from_parquet_as_it_was(folder: Path, crowd: Trajectories):
    write_parquet(crowd, folder / "crowd.parquet")
    assert differences(read_own(folder / "crowd.parquet"), crowd) == []


@given(crowd=crowds())
def test_equal_tables_give_equal_bytes(folder: Path, crowd: Trajectories):
    write_parquet(crowd, folder / "one.parquet")
    write_parquet(read_own(folder / "one.parquet"), folder / "two.parquet")
    assert (folder / "one.parquet").read_bytes() == (folder / "two.parquet").read_bytes()


def test_the_order_of_the_provenance_does_not_change_the_bytes(tmp_path):
    for name, order in (("one", ["seed", "policy"]), ("two", ["policy", "seed"])):
        crowd = replace(crowd_of([(0, 3)]), provenance=dict.fromkeys(order, 7))
        write_parquet(crowd, tmp_path / f"{name}.parquet")
    assert (tmp_path / "one.parquet").read_bytes() == (tmp_path / "two.parquet").read_bytes()


def test_any_parquet_reader_sees_one_row_per_person_and_frame(tmp_path):
    write_parquet(crowd_of([(0, 1), (1, 1)]), tmp_path / "crowd.parquet")
    table = parquet.read_table(tmp_path / "crowd.parquet").to_pydict()
    assert table["person_id"] == [0, 0, 1]
    assert table["frame"] == [0, 1, 1]
    assert table["entered"] == [False, False, True]


def test_another_simulators_csv_is_read_by_frame(tmp_path):
    crowd = read_csv(tmp_path, "person_id,frame,x,y\n7,2,0.5,1.5\n7,3,1.0,1.5\n8,3,0,0\n")
    assert crowd.person_id.tolist() == [7, 8]
    assert crowd.first.tolist() == [2, 3]
    assert crowd.path(0).tolist() == [[0.5, 1.5], [1.0, 1.5]]


def test_another_simulators_csv_is_read_by_time(tmp_path):
    crowd = read_csv(tmp_path, "person_id,time_s,x,y\n7,0.8,0.5,1.5\n7,1.2,1.0,1.5\n")
    assert crowd.first.tolist() == [2]
    assert crowd.last.tolist() == [3]


def test_whole_numbers_are_positions_too(tmp_path):
    crowd = read_csv(tmp_path, "person_id,frame,x,y\n7,0,1,2\n7,1,2,2\n")
    assert crowd.path(0).tolist() == [[1, 2], [2, 2]]


def test_gaps_within_a_person_of_a_csv_are_interpolated(tmp_path):
    crowd = read_csv(tmp_path, "person_id,frame,x,y\n7,0,0.0,4.0\n7,4,2.0,0.0\n")
    assert crowd.path(0)[:, 0].tolist() == [0.0, 0.5, 1.0, 1.5, 2.0]


def test_a_csv_is_as_long_as_asked_for(tmp_path):
    assert read_csv(tmp_path, "person_id,frame,x,y\n7,0,0,0\n", frames=50).frames == 50


def test_a_csv_may_bring_columns_of_persons(tmp_path):
    crowd = read_csv(tmp_path, "person_id,frame,x,y,entered,goal_area\n7,0,0,0,true,3\n")
    assert crowd.entered.tolist() == [True]
    assert crowd.goal_area.tolist() == [3]


def test_columns_that_crowdbench_does_not_know_are_ignored(tmp_path):
    crowd = read_csv(tmp_path, "person_id,frame,x,y,note,weight\n7,0,0,0,hello,\n")
    assert len(crowd) == 1


ROW = "person_id,frame,x,y\n7,0,0.5,0.5\n"
BROKEN = {
    "empty": ("", "", "readable table"),
    "no rows": ("person_id,frame,x,y\n", "no rows", "at least one row"),
    "no person": ("id,frame,x,y\n7,0,0,0\n", "columns id, frame, x, y", "a column person_id"),
    "no y": ("person_id,frame,x\n7,0,0\n", "columns person_id, frame, x", "a column y"),
    "no time": ("person_id,x,y\n7,0,0\n", "columns person_id, x, y", "a column frame (or time_s)"),
    "two x": ("person_id,frame,x,x,y\n7,0,0,0,0\n", "more than one column x", "only one"),
    "empty cell": (
        ROW + "7,1,,0.5\n",
        "value in 1 rows of column x, first in row 2",
        "a value in each row",
    ),
    "ragged": (ROW + "7,1,0.5\n", "3", "readable table"),
    "text": (ROW + "7,1,left,0.5\n", "text in column x", "numbers in each row"),
    "date": ("person_id,time_s,x,y\n7,2020-01-01,0,0\n", "values in column time_s", "numbers"),
    "text outcome": ("person_id,frame,x,y,outcome\n7,0,0,0,goal\n", "text in column outcome", ""),
    "half area": ("person_id,frame,x,y,spawn_area\n7,0,0,0,0.5\n", "spawn_area 0.5", "integers"),
    "endless entry": ("person_id,frame,x,y,spawn_s\n7,0,0,0,inf\n", "spawn_s inf", "finite"),
    "infinite": (ROW + "7,1,inf,0.5\n", "not finite, the first for person 7 in frame 1", "finite"),
    "half frame": (ROW + "7,1.5,0.5,0.5\n", "frame 1.5", "integers"),
    "huge frame": (ROW + "7,1e30,0.5,0.5\n", "frame 1e+30", "integers of 64 bits"),
    "duplicate": (ROW + "7,0,0.5,0.5\n", "person 7 twice in frame 0", "one position"),
    "other step": (
        "person_id,time_s,x,y\n7,0.1,0,0\n",
        "are not on the scene's",
        "multiples of 0.4 s",
    ),
}


@pytest.mark.parametrize(("text", "got", "expected"), BROKEN.values(), ids=BROKEN)
def test_a_broken_csv_is_refused_with_what_was_got_and_expected(tmp_path, text, got, expected):
    with pytest.raises(RecordingError) as caught:
        read_csv(tmp_path, text)
    assert caught.value.where == str(tmp_path / "crowd.csv")
    assert got in caught.value.got
    assert expected in caught.value.expected
    assert caught.value.hint


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="no such file"):
        read(tmp_path / "crowd.csv", scene="eth-v0", dt_s=0.4)


def test_a_file_of_another_kind_is_refused(tmp_path):
    (tmp_path / "crowd.xlsx").write_text(ROW)
    with pytest.raises(RecordingError, match=r"a \.xlsx file; expected \.parquet or \.csv"):
        read(tmp_path / "crowd.xlsx", scene="eth-v0", dt_s=0.4)


def test_a_csv_that_runs_past_the_end_is_refused(tmp_path):
    with pytest.raises(RecordingError, match="expected frames from 0 to 9"):
        read_csv(tmp_path, "person_id,frame,x,y\n7,10,0,0\n", frames=10)


@pytest.mark.parametrize(
    ("scene", "dt_s", "got"),
    [("plaza-v0", 1.0, "scene made by hand"), ("made by hand", 0.4, "time step 1.0")],
)
def test_a_crowd_of_another_scene_or_step_is_refused(tmp_path, scene, dt_s, got):
    write_parquet(crowd_of([(0, 3)]), tmp_path / "crowd.parquet")
    with pytest.raises(RecordingError) as caught:
        read(tmp_path / "crowd.parquet", scene=scene, dt_s=dt_s)
    assert caught.value.got == got


def test_a_truncated_parquet_file_is_refused(tmp_path):
    path = tmp_path / "crowd.parquet"
    write_parquet(crowd_of([(0, 3)]), path)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(RecordingError, match="expected a readable table"):
        read_own(path)


@given(crowds(), st.integers(0, 2**32), st.integers(0, 7))
def test_a_flipped_bit_is_refused_or_changes_nothing(
    folder: Path, crowd: Trajectories, where: int, bit: int
) -> None:
    path = folder / "flipped.parquet"
    write_parquet(crowd, path)
    data = bytearray(path.read_bytes())
    data[where % len(data)] ^= 1 << bit
    path.write_bytes(data)
    try:
        found = read_own(path)
    except RecordingError:
        return
    assert differences(found, crowd) == []


def test_an_edited_table_is_refused_and_one_without_a_hash_is_read(tmp_path: Path) -> None:
    path = tmp_path / "crowd.parquet"
    write_parquet(crowd_of([(0, 3), (1, 4)]), path)
    table = parquet.read_table(path)
    moved = table.set_column(
        table.column_names.index("x"), "x", pa.array(table["x"].to_numpy() + 1)
    )
    parquet.write_table(moved, path)
    with pytest.raises(RecordingError, match="differ from what was written"):
        read_own(path)
    stated = json.loads(table.schema.metadata[b"crowdbench"])
    del stated["content"]
    older = moved.replace_schema_metadata({b"crowdbench": json.dumps(stated).encode()})
    parquet.write_table(older, path)
    assert len(read_own(path)) == 2


def test_a_parquet_file_of_another_program_is_not_crowdbenchs_own(tmp_path):
    parquet.write_table(pa.table({"person_id": [1]}), tmp_path / "crowd.parquet")
    with pytest.raises(RecordingError, match="without crowdbench's metadata"):
        read_own(tmp_path / "crowd.parquet")


@pytest.mark.parametrize(
    ("was", "becomes", "got"),
    [
        (b'"schema":1', b'"schema":2', "schema version 2"),
        (b'"scene":', b'"place":', "invalid metadata"),
        (b'"frames":4', b'"frames":"4"', "invalid metadata"),
        (b'"observed":[[0,4]]', b'"observed":[]', "observed intervals"),
        (b'"observed":[[0,4]]', b'"observed":[[0,5]]', "observed intervals"),
        (b'"observed":[[0,4]]', b'"observed":[[0,3],[2,4]]', "observed intervals"),
    ],
    ids=["schema", "field", "type", "never observed", "past the end", "overlapping"],
)
def test_metadata_that_do_not_fit_are_refused(tmp_path, was, becomes, got):
    path = tmp_path / "crowd.parquet"
    write_parquet(crowd_of([(0, 3)]), path)
    table = parquet.read_table(path)
    metadata = table.schema.metadata[b"crowdbench"]
    assert was in metadata
    changed = {b"crowdbench": metadata.replace(was, becomes)}
    parquet.write_table(table.replace_schema_metadata(changed), path)
    with pytest.raises(RecordingError, match=got):
        read_own(path)


def test_an_integer_column_of_a_table_may_have_any_width(tmp_path):
    columns = {"person_id": [7], "frame": [0], "x": [0], "y": [0]}
    table = pa.table({name: pa.array(values, pa.uint8()) for name, values in columns.items()})
    parquet.write_table(table, tmp_path / "crowd.parquet")
    crowd = read(tmp_path / "crowd.parquet", scene="eth-v0", dt_s=0.4)
    assert crowd.person_id.dtype == np.int64


def test_a_place_that_cannot_be_written_is_refused(tmp_path):
    (tmp_path / "file").write_text("in the way")
    path = tmp_path / "file" / "crowd.parquet"
    with pytest.raises(OutputError) as caught:
        write_parquet(crowd_of([(0, 3)]), path)
    assert caught.value.where == str(path)


def test_writing_over_a_folder_is_refused_and_leaves_no_temporary_file(tmp_path):
    (tmp_path / "crowd.parquet").mkdir()
    with pytest.raises(OutputError):
        write_parquet(crowd_of([(0, 3)]), tmp_path / "crowd.parquet")
    assert [path.name for path in tmp_path.iterdir()] == ["crowd.parquet"]


def test_a_write_that_breaks_off_leaves_the_old_file_and_nothing_else(tmp_path):
    path = tmp_path / "result.json"
    write_text(path, "old")

    def break_off() -> None:
        with replacing(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_a_write_that_breaks_off_leaves_no_folders_that_were_made_for_it(tmp_path):
    (tmp_path / "there").mkdir()

    def break_off() -> None:
        with replacing(tmp_path / "there" / "new" / "newer" / "result.json"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        break_off()
    assert list(tmp_path.rglob("*")) == [tmp_path / "there"]


def test_written_files_are_as_readable_as_any_other(tmp_path):
    (tmp_path / "plain").write_text("")
    write_text(tmp_path / "result", "")
    assert (tmp_path / "result").stat().st_mode == (tmp_path / "plain").stat().st_mode


def test_json_of_equal_values_is_equal_whatever_their_order(tmp_path):
    write_json(tmp_path / "one", {"a": 1, "b": [0.1]})
    write_json(tmp_path / "two", {"b": [0.1], "a": 1})
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


KINDS = [
    kind
    for _, kind in inspect.getmembers(errors, inspect.isclass)
    if issubclass(kind, CrowdbenchError)
]


@pytest.mark.parametrize("kind", KINDS)
def test_errors_travel_between_processes_whole(kind):
    error = kind(Path("place"), got="this", expected="that", hint="Do so.")
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is kind
    assert str(copy) == str(error) == "place: got this; expected that. Do so."
    assert (copy.where, copy.got, copy.expected, copy.hint) == ("place", "this", "that", "Do so.")


def test_the_next_write_removes_what_killed_processes_left_of_the_same_file(tmp_path):
    path = tmp_path / "a.json"
    (left := tmp_path / ".a-0123abcd.json").touch()
    os.utime(left, (0, 0))
    (young := tmp_path / ".a-4567cdef.json").touch()  # perhaps its writer has not locked it yet
    others = {tmp_path / name for name in (".b-0123abcd.json", ".a-b-0123abcd.json", ".a-x.json")}
    for other in others:
        other.touch()
    with replacing(path) as used:
        write_text(path, "meanwhile")
        assert used.exists()
        used.write_text("last")
    assert path.read_text() == "last"
    assert set(tmp_path.iterdir()) == {path, young, *others}


LONG_AGO = 1_000_000_000


@pytest.fixture
def temporaries(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    return tmp_path


def test_a_folder_is_there_in_the_block_and_not_after_it(temporaries):
    with temporary_folder("test") as folder:
        (folder / "inside").mkdir()
        assert folder.parent == temporaries
    assert list(temporaries.iterdir()) == []


def test_folders_of_killed_processes_are_removed_and_those_in_use_are_not(temporaries):
    names = ("crowdbench-tmp-a-old", "crowdbench-tmp-b-new", "somebodys-old", ".scene-old")
    old, new, other, hidden = (temporaries / name for name in names)
    for folder in (old, new, other, hidden):
        folder.mkdir()
        (folder / "file").touch()
        if folder.name.endswith("old"):
            os.utime(folder, (LONG_AGO, LONG_AGO))
    with temporary_folder("test") as used:
        os.utime(used, (LONG_AGO, LONG_AGO))
        with temporary_folder("test"):
            assert not old.exists()
            assert used.exists()
    with temporary_folder("scene", temporaries) as made:
        assert made.name.startswith(".scene-")
        assert not hidden.exists()
    assert set(temporaries.iterdir()) == {new, other}
