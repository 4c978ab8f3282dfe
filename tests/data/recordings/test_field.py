"""Files as they lie around: read as what they are, or refused with the true reason.

Each file is made from a crowd that is known, so what is read can be compared with it.
"""

import sqlite3
from pathlib import Path

import made_up
import numpy as np
import pytest

from crowdbench import read as read_table
from crowdbench.cli import main
from crowdbench.data.recordings.formats import read_recording
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError


@pytest.fixture(scope="module")
def yard() -> Trajectories:
    return made_up.record(120.0)


@pytest.fixture(scope="module")
def rows(yard: Trajectories) -> list[tuple[int, int, float, float]]:
    return made_up.rows_of(yard)


def assert_same(found: Trajectories, yard: Trajectories, atol: float = 1e-3) -> None:
    assert len(found) == len(yard)
    assert len(found.xy) == len(yard.xy)
    assert found.dt_s == pytest.approx(0.4)
    order = np.lexsort((yard.start[:, 0], yard.first))
    mine = np.lexsort((found.start[:, 0], found.first))
    np.testing.assert_array_equal(np.diff(found.first[mine]), np.diff(yard.first[order]))
    for a, b in zip(mine.tolist(), order.tolist(), strict=True):
        np.testing.assert_allclose(found.path(a), yard.path(b), atol=atol)


def written(path: Path, lines: list[str]) -> Path:
    path.write_text("\n".join([*lines, ""]))
    return path


def test_frames_and_persons_in_each_others_columns_are_told(
    yard: Trajectories, tmp_path: Path
) -> None:
    """Read in the wrong order, frames would be persons and persons frames."""
    path = made_up.write(yard, "frame-ped-xy", tmp_path)
    with pytest.raises(RecordingError, match=r"each other's columns.*--format frame-ped-xy if"):
        read_recording(path, "jupedsim", name="yard", dt_s=0.4, gaps="interpolate")
    path = written(tmp_path / "swapped.txt", [f"{p} {f} {x} {y}" for p, f, x, y in
                                              made_up.rows_of(yard)])  # fmt: skip
    with pytest.raises(RecordingError, match=r"each other's columns.*--format jupedsim if"):
        read_recording(path, "frame-ped-xy", name="yard", dt_s=0.4)


def test_rows_with_commas_are_read(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    lines = ["# frame, person, x, y", *(f"{f},{p},{x},{y}" for p, f, x, y in rows)]
    path = written(tmp_path / "rows.csv", lines)
    assert_same(read_recording(path, "frame-ped-xy", name="yard", dt_s=0.4), yard)


def test_fragments_are_refused(yard: Trajectories, tmp_path: Path) -> None:
    lines, number = ["person_id,frame,x,y"], 0
    for p in range(len(yard)):
        way = yard.path(p)
        for start in range(0, len(way) - 7, 8):
            number += 1
            lines += [f"{number},{yard.first[p] + k},{way[k, 0]},{way[k, 1]}"
                      for k in range(start, start + 8)]  # fmt: skip
    path = written(tmp_path / "fragments.csv", lines)
    with pytest.raises(RecordingError, match=rf"{number} persons with 8 rows each.*fragments"):
        read_recording(path, "csv", name="yard", dt_s=0.4)


def test_numbers_of_video_frames_are_divided(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    lines = ["person_id,frame,x,y", *(f"{p},{780 + 10 * f},{x},{y}" for p, f, x, y in rows)]
    found = read_recording(written(tmp_path / "v.csv", lines), "csv", name="yard", dt_s=0.4)
    assert_same(found, yard)
    assert found.provenance["notes"]["frames"] == "every 10th has rows"


def database(path: Path, step_m: float) -> Path:
    """Twenty people who move by so much in each frame, 25 times a second."""
    with sqlite3.connect(path) as file:
        file.execute("CREATE TABLE metadata (key, value)")
        file.execute("INSERT INTO metadata VALUES ('fps', '25')")
        file.execute("CREATE TABLE trajectory_data (frame, id, pos_x, pos_y)")
        file.executemany(
            "INSERT INTO trajectory_data VALUES (?, ?, ?, ?)",
            [(f, p, step_m * f, 0.6 * p) for p in range(20) for f in range(p, 500)],
        )
    file.close()
    return path


def test_a_jam_is_accepted_where_the_file_states_rate_and_unit(tmp_path: Path) -> None:
    found = read_recording(database(tmp_path / "jam.sqlite", 0.006), "jupedsim", name="jam")
    assert len(found) == 20
    assert found.provenance["notes"]["speed warning"].startswith("a median of 0.15 m/s is slow")
    lines = ["person_id,frame,x,y"]
    lines += [f"{p},{f},{0.06 * f},{0.6 * p}" for p in range(20) for f in range(p, 200)]
    with pytest.raises(RecordingError, match=r"0.15 m/s.*A jam is accepted from a file that st"):
        read_recording(written(tmp_path / "jam.csv", lines), "csv", name="jam", dt_s=0.4)


def test_a_fast_crowd_is_warned_of(tmp_path: Path) -> None:
    found = read_recording(database(tmp_path / "run.sqlite", 0.1), "jupedsim", name="run")
    assert "2.50 m/s is fast for people" in found.provenance["notes"]["speed warning"]


@pytest.fixture(scope="module")
def jittered(yard: Trajectories, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A tracker's table: unix times, about 27 rows per second at irregular intervals."""
    rng, lines = np.random.default_rng(0), []
    for p, person in enumerate(yard.person_id.tolist()):
        known = np.arange(yard.first[p], yard.last[p] + 1) * 0.4
        steps = rng.uniform(0.02, 0.055, 40 * len(known))
        times = np.r_[known[0], known[0] + np.cumsum(steps)]
        times = np.r_[times[times < known[-1] - 0.01], known[-1]]
        way = yard.path(p)
        x, y = (np.interp(times, known, way[:, k]) for k in (0, 1))
        lines += [(1353895000.0 + t, person, a, b) for t, a, b in zip(times, x, y, strict=True)]
    text = [f"{t:.3f},{p},{x:.4f},{y:.4f}" for t, p, x, y in sorted(lines)]
    folder = tmp_path_factory.mktemp("tracker")
    return written(folder / "tracker.csv", ["time_s,person_id,x,y", *text])


def test_irregular_rows_are_resampled(yard: Trajectories, jittered: Path) -> None:
    found = read_recording(jittered, "csv", name="yard", resample=0.4)
    assert_same(found, yard, atol=0.08)
    assert found.provenance["notes"]["resampled"].startswith("from rows about every 0.03")


def test_resampling_replaces_other_options(jittered: Path) -> None:
    for asked in ({"offset_s": 5.0}, {"dt_s": 0.04}, {"gaps": "interpolate"}):
        with pytest.raises(SettingError, match="with --resample"):
            read_recording(jittered, "csv", name="yard", resample=0.4, **asked)


def test_resampling_keeps_what_a_table_says_of_persons(tmp_path: Path) -> None:
    lines = ["person_id,time_s,x,y,group,spawn_s"]
    lines += [f"{p},{100 + 0.3 * k + p},{0.4 * k},{p},{p // 2},{99.9 + p}"
              for p in range(4) for k in range(30)]  # fmt: skip
    path = written(tmp_path / "t.csv", lines)
    found = read_recording(path, "csv", name="yard", resample=0.4)
    assert found.group.tolist() == [0, 0, 1, 1]
    np.testing.assert_allclose(found.spawn_s, np.maximum(0, np.arange(4) - 0.1), atol=1e-6)


def test_irregular_rows_are_not_called_duplicates(jittered: Path) -> None:
    with pytest.raises(RecordingError, match=r"mostly 0\.03\d* s apart, at irr.*--resample 0.4"):
        read_recording(jittered, "csv", name="yard", dt_s=0.4)
    with pytest.raises(RecordingError, match=r"at 13538950\d\d\.\d+ s .*--resample 0.4"):
        read_recording(jittered, "csv", name="yard", dt_s=0.04, gaps="interpolate")


def test_a_rate_with_a_decimal_comma_is_read(yard: Trajectories, tmp_path: Path) -> None:
    path = made_up.write(yard, "jupedsim", tmp_path)
    path.write_text(path.read_text().replace("framerate: 2.5", "framerate: 2,5"))
    assert_same(read_recording(path, "jupedsim", name="yard"), yard)


def test_ids_may_be_text(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    lines = ["person_id,frame,x,y", *(f"ped_{p},{f},{x},{y}" for p, f, x, y in rows)]
    path = written(tmp_path / "ids.csv", lines)
    assert_same(read_recording(path, "csv", name="yard", dt_s=0.4), yard)
    assert len(read_table(path, "plaza-v0")) == len(yard)


def test_semicolons_and_decimal_commas_are_read(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    lines = ["person_id;frame;x;y", *(f"{p};{f};{x};{y}" for p, f, x, y in rows)]
    points = written(tmp_path / "points.csv", lines)
    commas = written(tmp_path / "commas.csv", [line.replace(".", ",") for line in lines])
    tabs = written(tmp_path / "tabs.csv", [line.replace(";", "\t") for line in lines])
    for path in (points, commas, tabs):
        assert_same(read_recording(path, "csv", name="yard", dt_s=0.4), yard)


def test_centimetres_and_pixels_are_scaled(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    lines = [f"{p} {f} {100 * x:.3f} {100 * y:.3f} 168.0" for p, f, x, y in rows]
    path = written(tmp_path / "cm.txt", lines)
    with pytest.raises(RecordingError, match="centimetres"):
        read_recording(path, "jupedsim", name="yard", dt_s=0.4)
    found = read_recording(path, "jupedsim", name="yard", dt_s=0.4, scale=0.01)
    assert_same(found, yard)
    boxes = made_up.write(yard, "sdd", tmp_path)
    with pytest.raises(RecordingError, match=r"in pixels; expected --scale .* or --homography"):
        read_recording(boxes, "sdd", name="yard")


def test_a_homography_maps_pixels_to_metres(yard: Trajectories, tmp_path: Path) -> None:
    """A camera that looks at an angle: what is further away is smaller."""
    matrix = np.array([[0.021, 0.001, 0.5], [-0.002, 0.022, 0.3], [1e-5, 2e-5, 1.0]])
    lines, back = ["person_id,frame,x,y"], np.linalg.inv(matrix)
    for p, f, x, y in made_up.rows_of(yard):
        pixel = back @ [x, y, 1.0]
        u, v = pixel[:2] / pixel[2]
        lines.append(f"{p},{f},{u:.6f},{v:.6f}")
    path = written(tmp_path / "pixels.csv", lines)
    np.savetxt(tmp_path / "H.txt", matrix)
    found = read_recording(path, "csv", name="yard", dt_s=0.4, homography=tmp_path / "H.txt")
    assert_same(found, yard)
    for text, message in (
        ("1 0 0\n0 1 0\n", r"numbers of shape \(2, 3\)"), ("a b c", "could not convert"),
        ("1 0 0\n2 0 0\n0 0 1\n", "maps an area to a line"),
    ):  # fmt: skip
        (tmp_path / "bad.txt").write_text(text)
        with pytest.raises(RecordingError, match=message):
            read_recording(path, "csv", name="yard", dt_s=0.4, homography=tmp_path / "bad.txt")


def test_a_number_that_is_given_to_another_person_is_split(
    yard: Trajectories, rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    first = int(yard.last.argmin())
    later = int(np.flatnonzero(yard.first > yard.last[first] + 8)[0])
    one, other = yard.person_id[first], yard.person_id[later]
    lines = ["person_id,frame,x,y"]
    lines += [f"{one if p == other else p},{f},{x},{y}" for p, f, x, y in rows]
    path = written(tmp_path / "reused.csv", lines)
    found = read_recording(path, "csv", name="yard", dt_s=0.4, gaps="interpolate")
    assert_same(found, yard)
    assert "1 gap where a person was split into two" in found.provenance["notes"]["mended"]


def test_more_missing_rows_than_a_fifth_are_not_made_up(
    rows: list[tuple[int, int, float, float]], tmp_path: Path
) -> None:
    kept = [row for k, row in enumerate(rows) if k % 4]
    lines = ["person_id,frame,x,y", *(f"{p},{f},{x},{y}" for p, f, x, y in kept)]
    with pytest.raises(RecordingError, match=r"missing rows, 3\d % of the real ones"):
        read_recording(
            written(tmp_path / "holes.csv", lines), "csv", name="yard", dt_s=0.4, gaps="interpolate"
        )


def test_jumps_are_refused(rows: list[tuple[int, int, float, float]], tmp_path: Path) -> None:
    lines = ["person_id,frame,x,y"]
    lines += [f"{p},{f},{x + 9 * (f % 20 == 0)},{y}" for p, f, x, y in rows]
    with pytest.raises(RecordingError, match=r"5 % of the speeds from row to row above 2\d"):
        read_recording(written(tmp_path / "jumps.csv", lines), "csv", name="yard", dt_s=0.4)


def test_splines_follow_their_points_and_do_not_overshoot(tmp_path: Path) -> None:
    """A person stands between two points, and walks on."""
    lines = ["1 - the number of splines", "5 - Num of control points"]
    points = ((-300, 0, 0), (-200, 0, 50), (-100, 0, 100), (-100, 0, 300), (300, 0, 500))
    lines += [f"{x} {y} {frame} 0 - (2D point, m_id)" for x, y, frame in points]
    path = written(tmp_path / "one.vsp", lines)
    found = read_recording(path, "vsp", name="one", scale=0.02)
    column = found.path(0)[:, 1] / 0.02 - 360
    frame = 10 * np.arange(len(column))
    assert len(column) == 51
    for x, _, at in points:
        assert column[frame == at] == pytest.approx(x, abs=1e-3)
    assert np.ptp(column[(frame >= 100) & (frame <= 300)]) == pytest.approx(0, abs=1e-3)


@pytest.mark.parametrize(
    ("layout", "text", "message"),
    [
        ("vsp", "2 - the number of splines\n1 - Num of control points\n1 2 3 4\n", "UCY's splines"),
        ("vsp", "hello", "UCY's splines"),
        ("sdd", "1 2 3 4 5 6 0 0 0\n", "line 1.*a row `track xmin"),
        ("sdd", '1 2 3 4 5 6 0 0 0 "Biker"\n', "no pedestrian"),
        ("sumo", "<fcd-export><timestep>", "SUMO's FCD"),
        ("sumo", "<fcd-export></fcd-export>", "no time step"),
        ("frame-ped-xy", "1 2 3\n", "rows of numbers: frame person x y"),
        ("frame-ped-xy", "", "no rows"),
        ("vadere", "a b c\n1 2 3\n", "that PedPy reads as vadere"),
        ("hdf5", "no HDF5", "that PedPy reads as hdf5"),
    ],
)
def test_broken_files_are_refused(layout: str, text: str, message: str, tmp_path: Path) -> None:
    path = tmp_path / "broken"
    path.write_text(text)
    with pytest.raises(RecordingError, match=message):
        read_recording(path, layout, name="yard", dt_s=0.4, scale=0.02)


def test_options_are_checked(yard: Trajectories, tmp_path: Path) -> None:
    for asked, message in (
        ({"scale": -1.0}, "--scale: got -1.0; expected a positive number"),
        ({"scale": 0.1, "homography": tmp_path / "H"}, "one of --scale and --homography"),
        ({"resample": 7.0}, "--resample: got 7.0; expected an interval"),
        ({"resample": 0.4, "gaps": "split"}, "--gaps: got split with --resample"),
    ):
        table = made_up.write(yard, "trajnet", tmp_path)
        with pytest.raises(SettingError, match=message):
            read_recording(table, "trajnet", name="yard", **asked)  # type: ignore[arg-type]
    forum = made_up.write(yard, "forum", tmp_path)
    with pytest.raises(SettingError, match="--scale with the format forum"):
        read_recording(forum, "forum", name="yard", scale=2.0)


def test_import_and_convert_take_the_options(
    yard: Trajectories, jittered: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.setenv("CROWDBENCH_HOME", str(tmp_path))
    given = ["--source", str(jittered), "--format", "csv", "--resample", "0.4"]
    assert main(["data", "import", "tracker", *given]) == 0
    assert "from rows about every" in capsys.readouterr().out
    boxes = made_up.write(yard, "sdd", tmp_path)
    out = tmp_path / "out.csv"
    asked = ["--format", "sdd", "--scale", "0.02", "--to", "csv", "--out", str(out)]
    assert main(["data", "convert", str(boxes), *asked]) == 0
    assert_same(read_recording(out, "csv", name="yard", dt_s=0.4), yard)
