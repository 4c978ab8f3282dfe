"""Recordings with small faults: named by person and frame, mended as asked, and told so."""

from pathlib import Path
from typing import get_args

import made_up
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.cli import main, options
from crowdbench.data.recordings.formats import read_recording
from crowdbench.data.recordings.mending import LONGEST_GAP_S, Gaps, Stamped, on_frames
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.registry import recording

OPTIONS = ["--format", "csv", "--dt-s", "0.4"]
Printed = pytest.CaptureFixture[str]


@pytest.fixture(scope="module")
def campus(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording as UCY's: frames from 1 on, one row three frames of the video late."""
    folder = tmp_path_factory.mktemp("campus")
    lines = made_up.write(made_up.record(120.0), "obsmat", folder).read_text().splitlines()
    rows = [[str(int(line.split()[0]) + 1), *line.split()[1:]] for line in lines]
    late = [row for row in rows if row[1] == rows[300][1]][7]
    late[0] = str(int(late[0]) + 3)
    (folder / "campus.txt").write_text("\n".join(map(" ".join, rows)))
    table = [f"{p},{int(frame) / 25:.2f},{x},{y}" for frame, p, x, _, y, *_ in rows]
    (folder / "campus.csv").write_text("\n".join(["person_id,time_s,x,y", *table]))
    (folder / "late").write_text(f"{late[1]} {late[0]} {int(late[0]) / 25:.10g}")
    return folder


@pytest.fixture
def late(campus: Path) -> list[str]:
    """Person, frame and time of the row that is late."""
    return (campus / "late").read_text().split()


def test_a_step_off_the_grid_is_refused_by_person_and_frame(campus: Path, late: list[str]) -> None:
    with pytest.raises(RecordingError) as told:
        read_recording(campus / "campus.txt", "obsmat", name="campus", dt_s=0.4)
    person, frame, _ = late
    assert told.value.got.startswith(f"person {person} at frame {frame}, 13 frames after its prev")
    assert "(2 of " in told.value.got
    assert told.value.expected == "a row of each person every 10 frames"
    assert "--gaps interpolate" in told.value.hint
    assert "--gaps split" in told.value.hint


@pytest.mark.parametrize("gaps", get_args(Gaps))
def test_a_row_off_the_grid_is_moved_onto_it(campus: Path, late: list[str], gaps: Gaps) -> None:
    crowd = read_recording(campus / "campus.txt", "obsmat", name="c", dt_s=0.4, gaps=gaps)
    person, frame, _ = late
    words = f"1 row moved to frames (person {person} at frame {frame})"
    assert crowd.provenance["notes"]["mended"] == words
    (p,) = np.flatnonzero(crowd.person_id == int(person)).tolist()
    right = made_up.record(120.0)
    others = crowd.person_id != int(person)
    assert crowd.person_id.tolist() == right.person_id.tolist()
    assert np.diff(crowd.offsets).tolist() == np.diff(right.offsets).tolist()
    for k in np.flatnonzero(others)[:10].tolist():
        np.testing.assert_allclose(crowd.path(k), right.path(k), atol=1e-4)
    # It was at its place 0.12 s later than it should have been: less than a third of a step off.
    seventh = (right.path(p)[7] - right.path(p)[6]) * (10 / 13) + right.path(p)[6]
    np.testing.assert_allclose(crowd.path(p)[7], seventh, atol=1e-3)


def test_a_constant_offset_is_told_with_the_option_that_mends_it(
    campus: Path, late: list[str]
) -> None:
    table = campus / "campus.csv"
    with pytest.raises(RecordingError, match=r"person 0 at 0.04 s .* --offset-s 0\.04 to"):
        read_recording(table, "csv", name="campus", dt_s=0.4, gaps="interpolate")
    with pytest.raises(RecordingError, match=f"person {late[0]} at {late[2]} s, between two fr"):
        read_recording(table, "csv", name="campus", dt_s=0.4, offset_s=0.04)
    crowd = read_recording(table, "csv", name="c", dt_s=0.4, offset_s=0.04, gaps="interpolate")
    other = read_recording(campus / "campus.txt", "obsmat", name="c", dt_s=0.4, gaps="interpolate")
    np.testing.assert_allclose(crowd.xy, other.xy, atol=1e-4)
    assert crowd.first.tolist() == other.first.tolist()
    assert crowd.spawn_s.tolist() == pytest.approx(other.spawn_s.tolist())
    assert crowd.provenance["notes"]["times"] == "reduced by 0.04 s"


def test_the_command_tells_what_it_mended_and_so_does_describe(
    campus: Path, capsys: Printed
) -> None:
    asked = ["data", "import", "campus", "--source", str(campus / "campus.csv"), *OPTIONS]
    assert main(asked) == 2
    assert "--offset-s 0.04" in capsys.readouterr().err
    assert main([*asked, "--offset-s", "0.04", "--gaps", "split"]) == 0
    imported = capsys.readouterr().out
    assert main(["data", "describe", "campus"]) == 0
    for out in (imported, capsys.readouterr().out):
        assert "1 row moved to frames (person " in out
        assert "reduced by 0.04 s" in out


def table_of(folder: Path, times: list[float], name: str = "walk.csv") -> Path:
    """Two who walk in a straight line at 1 m/s: one always there, one at these times."""
    path = folder / name
    rows = [f"1,{0.4 * k:.1f},{0.4 * k:.1f},0" for k in range(20)]
    rows += [f"7,{t:g},{t:g},5" for t in times]
    path.write_text("\n".join(["person_id,time_s,x,y", *rows]))
    return path


GAP = [0.4, 0.8, 1.2, 2.8, 3.2]


def read(path: Path, **asked: object) -> Trajectories:
    return read_recording(path, "csv", name="walk", dt_s=0.4, **asked)  # type: ignore[arg-type]


@pytest.mark.parametrize("asked_s", [0.4, 0.25, 1.0])
def test_another_time_between_rows_is_told_with_both_mends(asked_s: float, tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    rows = [f"{p},{0.5 * k:g},{0.5 * k:g},{p}" for p in (1, 2) for k in range(20)]
    path.write_text("\n".join(["person_id,time_s,x,y", *rows]))
    with pytest.raises(RecordingError) as refused:
        read_recording(path, "csv", name="walk", dt_s=asked_s)
    assert refused.value.got == "rows of a person mostly 0.5 s apart"
    assert refused.value.hint == (
        f"Use --dt-s 0.5 if that is right, or --resample {asked_s:g} to interpolate positions "
        f"every {asked_s:g} s."
    )
    assert read_recording(path, "csv", name="walk", dt_s=0.5).dt_s == 0.5


def test_missing_rows_are_filled_by_a_straight_way(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"person 7 at 2.8 s, 1.6 s after its previous row"):
        read(table_of(tmp_path, GAP))
    crowd = read(table_of(tmp_path, GAP), gaps="interpolate")
    assert crowd.person_id.tolist() == [1, 7]
    np.testing.assert_allclose(crowd.path(1)[:, 0], np.arange(1, 9) * 0.4, atol=1e-6)
    assert crowd.provenance["notes"]["mended"] == "3 rows interpolated (person 7 after 1.2 s)"


def test_who_is_split_has_neither_left_nor_entered_at_the_gap(tmp_path: Path) -> None:
    crowd = read(table_of(tmp_path, GAP), gaps="split")
    assert crowd.person_id.tolist() == [1, 7, 8]
    assert crowd.first.tolist() == [0, 1, 7]
    assert crowd.last.tolist() == [19, 3, 8]
    assert crowd.entered.tolist() == [False, True, False]
    assert crowd.left.tolist() == [False, False, True]
    words = "1 gap where a person was split into two (person 7 after 1.2 s, now person 8)"
    assert crowd.provenance["notes"]["mended"] == words


def test_a_split_persons_own_columns_stay_with_its_first_part(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    rows = [f"1,{k},{0.4 * k:.1f},0,0.0" for k in range(20)]
    rows += [f"7,{k},{0.4 * k:.1f},5,0.3" for k in (1, 2, 3, 7, 8)]
    path.write_text("\n".join(["person_id,frame,x,y,spawn_s", *rows]))
    crowd = read(path, gaps="split")
    assert crowd.spawn_s.tolist() == pytest.approx([0.0, 0.3, 2.8])


def test_nothing_to_mend_is_told_and_changes_nothing(tmp_path: Path, capsys: Printed) -> None:
    path = table_of(tmp_path, [0.4, 0.8, 1.2])
    assert read(path, gaps="split").provenance == read(path).provenance
    asked = ["data", "import", "walk", "--source", str(path), *OPTIONS, "--gaps", "split"]
    assert main(asked) == 0
    assert "nothing; no faults found" in capsys.readouterr().out


def test_the_same_file_mended_otherwise_is_another_recording(
    tmp_path: Path, capsys: Printed
) -> None:
    path = table_of(tmp_path, GAP)
    asked = ["data", "import", "walk", "--source", str(path), *OPTIONS]
    assert main([*asked, "--gaps", "interpolate"]) == 0
    assert main([*asked, "--gaps", "split"]) == 2
    assert "`crowdbench data remove walk`" in capsys.readouterr().err
    assert main(["data", "remove", "walk"]) == 0
    assert main([*asked, "--gaps", "split"]) == 0
    assert len(recording("walk")) == 3


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("walk", "no imported recording of that name"),
        ("../up", "the name '../up'"),
        ("eth", "no imported recording"),
    ],
)
def test_what_is_not_imported_cannot_be_removed(name: str, message: str, capsys: Printed) -> None:
    assert main(["data", "remove", name]) == 2
    assert message in capsys.readouterr().err


def test_times_that_are_not_those_of_their_frames_name_the_row(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    rows = [f"3,{k},{0.4 * k + 0.1:.1f},{0.4 * k:.1f},0" for k in range(9)]
    path.write_text("\n".join(["person_id,frame,time_s,x,y", *rows]))
    with pytest.raises(RecordingError, match=r"person 3 in frame 0 at 0.1 s.*--offset-s 0.1 to"):
        read(path)
    assert read(path, offset_s=0.1).frames == 9


def test_frames_of_a_video_are_no_gaps(tmp_path: Path) -> None:
    path = tmp_path / "walk.csv"
    rows = [f"3,{10 * k},{0.4 * k:.1f},0" for k in range(9)]
    path.write_text("\n".join(["person_id,frame,x,y", *rows]))
    crowd = read(path)
    assert crowd.provenance["notes"]["frames"] == "every 10th has rows"
    np.testing.assert_allclose(crowd.path(0)[:, 0], 0.4 * np.arange(9), atol=1e-6)


@pytest.mark.parametrize(
    ("layout", "asked", "message"),
    [
        ("obsmat", {"offset_s": 0.04}, "frames are numbered; expected the format csv"),
        ("forum", {"gaps": "split"}, "missing rows are always interpolated"),
    ],
)
def test_options_that_nothing_answers_to_are_refused(
    layout: str, asked: dict, message: str, tmp_path: Path
) -> None:
    with pytest.raises(SettingError, match=message):
        read_recording(tmp_path / "none", layout, name="walk", dt_s=0.4, **asked)


def test_published_recordings_are_not_mended(capsys: Printed) -> None:
    for option, value in (("--gaps", "split"), ("--offset-s", "1"), ("--dt-s", "0.4")):
        assert main(["data", "import", "eth", option, value]) == 2
        assert f"{option} without --format" in capsys.readouterr().err
    assert get_args(options.Gaps) == get_args(Gaps)


# Any crowd: rows may be missing, and shifted by up to a third of a step.

LIFE = st.tuples(
    st.integers(0, 30),
    st.lists(st.sampled_from(["there", "late", "missing"]), min_size=1).filter(
        # Of most rows it would be no fault, but the person's own phase.
        lambda states: states.count("late") <= states.count("there")
    ),
)


@given(trips=st.lists(LIFE, min_size=1, max_size=5), gaps=st.sampled_from(get_args(Gaps)))
def test_what_is_mended_stands_on_the_ways_that_were_seen(
    trips: list[tuple[int, list[str]]], gaps: Gaps
) -> None:
    """People who walk at constant speed do so after it; nobody is seen earlier, later or twice."""
    rows = [(9, k, 0.0) for k in range(200)]
    for person, (start, states) in enumerate(trips):
        for k, state in enumerate(["there", *states, "there"]):
            if state != "missing":
                rows.append((person, start + k, 0.3 * (state == "late")))
    person, frame, by = (np.array(column) for column in zip(*rows, strict=True))
    ticks = frame + np.round(10 * by) / 10
    xy = np.stack([ticks * (1 + person), -ticks], axis=1)
    rows = Stamped(person, 10 * frame + np.round(10 * by), xy, "frame", step=10.0)
    found = on_frames(rows, gaps=gaps, dt_s=0.4, where="here")
    mine = person[found.source]
    np.testing.assert_allclose(found.xy[:, 0], found.frame * (1 + mine), atol=1e-9)
    crowd = found.crowd(scene="here", dt_s=0.4, where="here")
    assert len(crowd.xy) == len(found.xy)  # nobody is there twice, and nothing more is filled
    for p in range(len(trips)):
        seen, known = np.sort(found.frame[mine == p]), np.sort(frame[person == p])
        assert seen[0] == known[0]
        assert seen[-1] == known[-1]
        whole = list(range(known[0], known[-1] + 1))
        longest_s = 0.4 * np.diff(known).max(initial=1)
        assert (seen.tolist() == whole) or gaps == "split" or longest_s > LONGEST_GAP_S
        missing = set(whole) - set(seen.tolist())
        assert missing <= set(whole) - set(known[by[person == p] == 0].tolist())
    faults = (by > 0).any() or any("missing" in states for _, states in trips)
    assert ("mended" in found.notes) == faults
