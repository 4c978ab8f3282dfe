"""Trajectories that are submitted: what may be listed, and what is refused of them."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import parquet
from submissions import PLAZA, crowd, declare, listed_submission, problem, refusal

from crowdbench import rollout
from crowdbench.data.storage import write_csv, write_parquet
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import RecordingError
from crowdbench.leaderboard.submission import limits
from crowdbench.leaderboard.submission.limits import MOST_COLUMNS, MOST_PERSONS, MOST_ROWS
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.leaderboard.submission.trajectories import (
    DROPPED,
    broken_rules,
    read_table,
    undeclared_drops,
)
from crowdbench.registry import policy, recording, spawn_model
from crowdbench.spawn.areas import read_areas

AREAS = read_areas(PLAZA)
ROWS = 20 * 55


def rules(made: Trajectories, track: Any = "crowd") -> str:
    """What is told of a crowd's broken rules."""
    return "\n".join(str(error) for error in broken_rules("0.parquet", made, track, PLAZA, AREAS))


def submitted(tmp_path: Path, second: Trajectories) -> Path:
    folder = listed_submission(tmp_path / "crowd")
    write_parquet(second, folder / "plaza-v0" / "trajectories" / "1.parquet")
    return folder


@pytest.fixture(scope="module")
def walked() -> Trajectories:
    return rollout(PLAZA, spawn_model("ntpp-gmm", PLAZA), policy("social-force", PLAZA), seed=0)


def test_no_rule_is_broken_by_the_recording_or_by_rollouts(walked: Trajectories) -> None:
    recorded = replace(recording("plaza"), scene="plaza-v0")
    random = rollout(PLAZA, spawn_model("poisson-gmm", PLAZA), policy("random", PLAZA), seed=0)
    for made in (recorded, walked, random, crowd()):
        assert rules(made) == ""
        assert rules(made, "walk") == ""


def test_rollouts_that_crowdbench_wrote_are_listed(walked: Trajectories, tmp_path: Path) -> None:
    submission = read_submission(submitted(tmp_path, walked))
    assert submission.status == "listed"


def test_another_time_step_is_refused(tmp_path: Path) -> None:
    told = problem(submitted(tmp_path, crowd(1, dt_s=0.5)))
    assert "plaza-v0/trajectories/1.parquet: got time step 0.5; expected time step 0.4" in told
    assert str(tmp_path / "crowd" / "plaza-v0") not in told


def test_another_scene_is_refused(tmp_path: Path) -> None:
    assert "scene eth-v0" in problem(submitted(tmp_path, crowd(1, scene="eth-v0")))


def test_another_length_is_refused(tmp_path: Path) -> None:
    assert "got 9000 frames" in problem(submitted(tmp_path, crowd(1, frames=9000)))
    short = crowd(1, frame=np.tile(np.arange(55), 20))
    assert "the last person in frame 54" in rules(short)
    path = tmp_path / "crowd" / "plaza-v0" / "trajectories" / "1.parquet"
    path.unlink()
    late = replace(crowd(1), first=crowd(1).first + 70)
    write_csv(late, path.with_suffix(".csv"))
    assert "expected frames from 0 to 4499" in problem(tmp_path / "crowd")


def test_crowds_that_are_observed_in_part_are_refused() -> None:
    assert "all observed" in rules(crowd(observed=np.array([[0, 4400]])))


@pytest.mark.parametrize("gap", [2, 3000])
def test_an_id_that_comes_back_is_refused(gap: int, tmp_path: Path) -> None:
    folder = listed_submission(tmp_path / "crowd")
    frame = np.concatenate([np.arange(20), np.arange(19 + gap, 39 + gap)])
    rows = "".join(f"7,{f},{10 + 0.1 * k:.2f},9.5\n" for k, f in enumerate(frame))
    path = folder / "plaza-v0" / "trajectories" / "2.csv"
    path.write_text("person_id,frame,x,y\n" + rows)
    told = problem(folder)
    assert f"person 7 without rows between frame 19 and {19 + gap}" in told
    path.write_text(path.read_text().replace("frame", "time_s"))
    assert f"without rows between time_s 19 and {19 + gap}" in problem(folder)


def test_people_inside_walls_are_refused() -> None:
    for share in (0.009, 0.02):
        xy = crowd().xy.astype(np.float64)
        xy[: int(share * len(xy))] = [2.0, 2.0]
        told = rules(replace(crowd(), xy=xy.astype(np.float32)))
        assert ("2.00% of positions more than 0.1 m inside walls" in told) == (share > 0.01)
    grazing = crowd().xy.copy()
    grazing[10:30] = [2.0, 5.95]
    assert "walls" not in rules(replace(crowd(), xy=grazing))


def test_people_far_outside_are_refused() -> None:
    xy = crowd().xy.copy()
    xy[3] = [1e30, 0.0]
    assert "1e+30 m outside the scene's bounds; expected at most 10 m" in rules(
        replace(crowd(), xy=xy)
    )


def test_leaps_are_refused() -> None:
    jitter = np.zeros((ROWS, 2), dtype=np.float32)
    jitter[20:24, 1] = 4.0
    assert rules(replace(crowd(), xy=crowd().xy + jitter)) == ""
    jitter[20:400:20, 1] = 4.0
    told = rules(replace(crowd(), xy=crowd().xy + jitter))
    assert "of speeds over 0.8 s above 3 m/s; expected at most 1%" in told


def test_rollouts_that_are_the_same_are_refused(tmp_path: Path) -> None:
    renamed = crowd(0, person_id=np.repeat(np.arange(100, 120), 55))
    told = problem(submitted(tmp_path, renamed))
    assert "1.parquet: got the same crowd as in plaza-v0/trajectories/0.parquet" in told


def ending(at_frame: int, outcome: str, left: bool = True) -> Trajectories:
    """The crowd, of which five persons end after so many frames."""
    kept = np.ones(ROWS, dtype=bool).reshape(20, 55)
    kept[5:10, at_frame:] = False
    full = crowd()
    how = np.zeros((20, 55))
    how[5:10] = OUTCOMES.index(outcome)
    stays = np.ones((20, 55), dtype=bool)
    stays[5:10] = left
    choose = kept.ravel()
    return crowd(
        person_id=full.person_id[full.row_person()][choose],
        frame=full.row_frame()[choose],
        xy=full.xy[choose].astype(np.float64),
        persons={"outcome": how.ravel()[choose], "left": stays.ravel()[choose]},
    )


@pytest.mark.parametrize(
    ("outcome", "left", "track", "drops"),
    [
        ("unknown", True, "crowd", 5),
        ("goal", True, "crowd", 5),
        ("exit", True, "crowd", 5),
        ("horizon", True, "crowd", 5),
        ("recorded", True, "crowd", 5),
        ("timeout", True, "crowd", 0),
        ("timeout", False, "crowd", 5),
        ("recorded", False, "walk", 0),
        ("timeout", True, "walk", 0),
        ("unknown", True, "walk", 5),
    ],
)
def test_who_vanishes_without_a_word_is_dropped(
    outcome: str, left: bool, track: Any, drops: int
) -> None:
    made = ending(30, outcome, left)
    assert undeclared_drops(made, track, PLAZA, AREAS).sum() == drops
    assert ("25.00% of trips ending away from the edge" in rules(made, track)) == (drops > 0)
    assert drops / 20 > DROPPED or drops == 0


def test_who_walks_out_or_is_there_at_the_end_is_not_dropped() -> None:
    assert not undeclared_drops(ending(55, "unknown"), "crowd", PLAZA, AREAS).any()
    beyond = crowd().xy.copy()
    beyond[54::55] = [30.5, 12.0]
    assert not undeclared_drops(replace(crowd(), xy=beyond), "crowd", PLAZA, AREAS).any()


@pytest.mark.parametrize(
    ("column", "value"),
    [
        ("spawn_area", 4),
        ("goal_area", 2**31 - 1),
        ("spawn_area", -2),
        ("spawn_s", 1e9),
        ("spawn_s", 0.0),
        ("requested_s", 1e9),
        ("entered", False),
    ],
)
def test_columns_of_persons_agree_with_their_rows(column: str, value: float) -> None:
    values = getattr(crowd(), column).copy()
    values[7] = value
    assert f"got {column} {values[7]} of person 7 (1 in all)" in rules(
        replace(crowd(), **{column: values})
    )


def made_of(path: Path, rows: int, **columns: pa.Array) -> Path:
    """A Parquet file of constant columns, which take no space."""
    zeros = {name: pa.array(np.zeros(rows, np.int8)) for name in ("person_id", "frame", "x", "y")}
    parquet.write_table(pa.table(zeros | columns), path, compression="zstd")
    return path


def test_parquet_that_inflates_is_refused_before_it_is_read(tmp_path: Path) -> None:
    path = made_of(tmp_path / "0.parquet", MOST_ROWS + 1)
    assert path.stat().st_size < 100_000
    with pytest.raises(RecordingError, match=f"got {MOST_ROWS + 1} rows; expected at most"):
        read_table(path)


def test_parquet_that_says_less_is_refused_while_it_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = made_of(tmp_path / "0.parquet", 100_000)
    monkeypatch.setattr(limits, "LARGEST_DECODED", 200_000)
    with pytest.raises(RecordingError, match="takes more memory"):
        read_table(path)


def test_text_where_numbers_belong_is_refused_before_it_is_read(tmp_path: Path) -> None:
    long = pa.array(["x" * 1000] * 10_000).dictionary_encode()
    path = made_of(tmp_path / "0.parquet", 10_000, x=long)
    with pytest.raises(RecordingError, match="in column x; expected numbers"):
        read_table(path)


def test_columns_of_one_name_are_refused(tmp_path: Path) -> None:
    twice = pa.table([[1], [2]], names=["x", "x"])
    parquet.write_table(twice, tmp_path / "0.parquet")
    with pytest.raises(RecordingError, match="two columns of the same name"):
        read_table(tmp_path / "0.parquet")
    (tmp_path / "0.csv").write_text("x, x\n1,2\n")
    with pytest.raises(RecordingError, match="two columns of the same name"):
        read_table(tmp_path / "0.csv")


def test_columns_whose_names_are_no_text_are_refused(tmp_path: Path) -> None:
    path = made_of(tmp_path / "0.parquet", 10)
    path.write_bytes(path.read_bytes().replace(b"frame", b"\xff\xff\xff\xff\xff"))
    with pytest.raises(RecordingError, match=r"0\.parquet"):
        read_table(path)


def test_other_columns_are_left_unread(tmp_path: Path) -> None:
    path = made_of(tmp_path / "0.parquet", 10, note=pa.array(["x"] * 10))
    assert read_table(path).column_names == ["person_id", "frame", "x", "y"]


def test_too_many_columns_are_refused(tmp_path: Path) -> None:
    more = {f"c{k}": pa.array([0]) for k in range(MOST_COLUMNS)}
    with pytest.raises(RecordingError, match=f"at most {MOST_COLUMNS}"):
        read_table(made_of(tmp_path / "0.parquet", 1, **more))
    (tmp_path / "0.csv").write_text(",".join(more) + ",x\n")
    with pytest.raises(RecordingError, match=f"at most {MOST_COLUMNS}"):
        read_table(tmp_path / "0.csv")
    (tmp_path / "0.csv").write_text("x" * 10_001)
    with pytest.raises(RecordingError, match="a first line over 10 kB"):
        read_table(tmp_path / "0.csv")


def test_too_many_persons_are_refused(tmp_path: Path) -> None:
    folder = declare(tmp_path / "crowd", "walk")
    place = folder / "plaza-v0" / "trajectories"
    place.mkdir(parents=True)
    ids = pa.array(np.arange(MOST_PERSONS + 1))
    made_of(place / "0.parquet", MOST_PERSONS + 1, person_id=ids)
    assert f"got {MOST_PERSONS + 1} persons" in problem(folder)


@pytest.mark.parametrize("name", ["0.parquet", "1.parquet", "2.csv"])
@pytest.mark.parametrize("data", [b"", b"PAR1", b"\xff" * 100, b"person_id,frame,x,y\n", b"a\n1\n"])
def test_what_is_no_table_is_refused(name: str, data: bytes, tmp_path: Path) -> None:
    folder = listed_submission(tmp_path / "crowd")
    (folder / "plaza-v0" / "trajectories" / name).write_bytes(data)
    assert f"plaza-v0/trajectories/{name}" in problem(folder)


def test_rollouts_are_numbered_from_0_on(tmp_path: Path) -> None:
    folder = listed_submission(tmp_path / "crowd")
    place = folder / "plaza-v0" / "trajectories"
    (place / "1.parquet").rename(place / "5.parquet")
    assert "got files 0, 2, 5; expected 2 to 30 rollouts" in problem(folder)
    (place / "5.parquet").rename(place / "2.parquet")
    assert "got files 0, 2, 2" in refusal(folder)
    (place / "2.parquet").rename(place / "01.parquet")
    assert "01.parquet: got an unexpected file" in refusal(folder)
