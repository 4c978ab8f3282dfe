"""TrajNet++, JuPedSim and PedPy: small files of these formats, and what we write of them."""

import json
import sqlite3
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from conftest import need
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import crowds

from crowdbench.cli import main
from crowdbench.data.recordings.formats import read_recording
from crowdbench.data.recordings.jupedsim import parse_jupedsim, write_jupedsim
from crowdbench.data.recordings.mending import Stamped, on_frames
from crowdbench.data.recordings.timing import checked_dt_s
from crowdbench.data.recordings.trajnet import parse_trajnet, write_trajnet
from crowdbench.data.storage import write_csv
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError

TRACKS = [(10, 3, 1.25, 4.5), (20, 3, 1.75, 4.5), (20, 4, 0.0, 1.0), (40, 4, 2.0, 1.0)]


def ndjson(*lines: object) -> bytes:
    return "\n".join(map(json.dumps, lines)).encode()


def tracks() -> list[object]:
    return [{"track": {"f": f, "p": p, "x": x, "y": y}} for f, p, x, y in TRACKS]


def scene(fps: float) -> object:
    return {"scene": {"id": 0, "p": 3, "s": 10, "e": 20, "fps": fps, "tag": [1, []]}}


def crowd_in(rows: Stamped, stated_s: float | None, asked_s: float | None) -> Trajectories:
    dt_s = checked_dt_s("here", stated_s, asked_s)
    whole = on_frames(rows, gaps="interpolate", dt_s=0.4, where="here")
    return whole.crowd(scene="here", dt_s=dt_s, where="here")


def trajnet(*lines: object, dt_s: float | None = None) -> Trajectories:
    return crowd_in(*parse_trajnet(ndjson(*lines), "here.ndjson"), dt_s)


def jupedsim(data: str | bytes, dt_s: float | None = None) -> Trajectories:
    raw = data.encode() if isinstance(data, str) else data
    return crowd_in(*parse_jupedsim(raw, "here.txt"), dt_s)


def test_tracks_are_people_and_scenes_say_the_rate() -> None:
    crowd = trajnet(scene(2.5), *tracks())
    assert crowd.dt_s == 0.4
    assert crowd.person_id.tolist() == [3, 4]
    assert crowd.first.tolist() == [1, 2]
    assert crowd.path(0).tolist() == [[1.25, 4.5], [1.75, 4.5]]


def test_a_missing_row_is_a_straight_way() -> None:
    assert trajnet(*tracks(), dt_s=0.4).path(1).tolist() == [[0, 1], [1, 1], [2, 1]]


@pytest.mark.parametrize(
    ("lines", "dt_s", "message"),
    [
        (tracks(), None, "does not state the time .*--dt-s SECONDS"),
        (
            [scene(2.5), *tracks()],
            0.1,
            "every 0.4 s according to the file; expected rows every 0.1 s",
        ),
        ([scene(2.5), scene(10), *tracks()], None, "scenes of 2.5, 10 rows per second"),
        ([scene(0.0), *tracks()], None, "scenes of 0 rows per second"),
        ([scene(2.5)], None, "got no track"),
        ([{"track": {"f": 1, "p": 2, "x": "here"}}], 0.4, "line 1: got .*float.*Lines look like"),
        (
            [{"track": {"f": 1, "p": 2, "x": 0, "y": 0, "prediction_number": 0}}],
            0.4,
            "line 1: got a predicted track",
        ),
    ],
)
def test_broken_tracks_are_refused(lines: list[object], dt_s: float | None, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        trajnet(*lines, dt_s=dt_s)


TEXT = """# description: a corridor
# framerate: 2.50
# id frame x/m y/m z/m
7 0 1.5 2.5 0.0
7 1 2.0 2.5 0.0
8\t1\t0.0\t1.0\t0.0
"""


def test_a_text_file_says_its_rate() -> None:
    crowd = jupedsim(TEXT)
    assert crowd.dt_s == 0.4
    assert crowd.person_id.tolist() == [7, 8]
    assert crowd.path(0).tolist() == [[1.5, 2.5], [2.0, 2.5]]


def test_centimetres_are_known_by_the_head() -> None:
    crowd = jupedsim(TEXT.replace("x/m y/m", "x/cm y/cm"))
    np.testing.assert_allclose(crowd.path(1), [[0.0, 0.01]])


def test_frames_far_apart_at_the_rate_of_the_camera_are_rows() -> None:
    crowd = jupedsim("# framerate: 25\n1 0 0 0 0\n1 10 0.5 0 0\n1 20 1 0 0\n")
    assert crowd.dt_s == 0.4
    assert len(crowd.path(0)) == 3


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1 0 0 0 0\n", "does not state the time"),
        ("# framerate: 2.5\n", "got no rows"),
        ("# framerate: 2.5\n1 0\n", "expected rows of numbers: id frame x y z"),
        ("# framerate: 2.5\n1 0 here 2 0\n", "expected rows of numbers"),
        ("# framerate: 0\n1 0 1 2 0\n", "got 0 frames per second"),
        ("# framerate: 2.5\n1 0.5 1 2 0\n", "frame 0.5 in row 1; expected integers"),
        ("# framerate: 2.5\n1 0 nan 2 0\n", "not finite"),
        ("# framerate: 2.5\n1 0 1 2 0\n1 0 1 2 0\n", "person 1 twice at frame 0"),
    ],
)
def test_broken_texts_are_refused(text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        jupedsim(text)


def database(path: Path, *, fps: str | None = "2.5") -> bytes:
    """A file with the tables that JuPedSim writes."""
    connection = sqlite3.connect(path)
    connection.execute(
        "CREATE TABLE trajectory_data (frame INTEGER NOT NULL, id INTEGER NOT NULL, pos_x REAL "
        "NOT NULL, pos_y REAL NOT NULL, ori_x REAL NOT NULL, ori_y REAL NOT NULL)"
    )
    connection.execute("CREATE TABLE metadata (key TEXT NOT NULL, value TEXT NOT NULL)")
    rows = [(f, p, x, y, 1.0, 0.0) for f, p, x, y in TRACKS]
    connection.executemany("INSERT INTO trajectory_data VALUES (?, ?, ?, ?, ?, ?)", rows)
    if fps is not None:
        connection.execute("INSERT INTO metadata VALUES ('fps', ?)", (fps,))
    connection.commit()
    connection.close()
    return path.read_bytes()


def test_a_database_is_read_like_a_text(tmp_path: Path) -> None:
    crowd = jupedsim(database(tmp_path / "jps.sqlite", fps="25.0"))
    assert crowd.dt_s == 0.4
    assert crowd.person_id.tolist() == [3, 4]
    assert crowd.path(1).tolist() == [[0, 1], [1, 1], [2, 1]]


@pytest.mark.parametrize("fps", [None, "often"])
def test_a_database_without_a_rate_is_refused(tmp_path: Path, fps: str | None) -> None:
    with pytest.raises(RecordingError, match="tables trajectory_data and metadata, the latter"):
        jupedsim(database(tmp_path / "jps.sqlite", fps=fps))


def test_a_database_that_broke_off_is_refused(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match="JuPedSim's tables"):
        jupedsim(database(tmp_path / "jps.sqlite")[:5000])


@pytest.mark.parametrize("layout", ["csv", "trajnet", "jupedsim"])
@given(crowd=crowds(dt_s=0.4), starts=st.integers(0, 3))
@settings(max_examples=25, deadline=None)
def test_what_is_written_is_read_again(
    tmp_path_factory: pytest.TempPathFactory, layout: str, crowd: Trajectories, starts: int
) -> None:
    write = {"csv": write_csv, "trajnet": write_trajnet, "jupedsim": write_jupedsim}[layout]
    path = tmp_path_factory.mktemp("crowd") / "crowd.csv"
    write(crowd, path)
    again = read_recording(path, layout, name="again", dt_s=0.4, at_frames=False)
    of_ids = {p: k for k, p in enumerate(again.person_id.tolist())}
    assert set(of_ids) == set(crowd.person_id.tolist())
    for k, person in enumerate(crowd.person_id.tolist()):
        found = of_ids[person]
        assert again.first[found] == crowd.first[k]
        np.testing.assert_array_equal(again.path(found), crowd.path(k))


def test_converting_goes_round(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "jps.sqlite"
    database(source, fps="25")
    here = tmp_path / "crowd.txt"
    asked = [
        "data",
        "convert",
        str(source),
        "--format",
        "jupedsim",
        "--to",
        "jupedsim",
        "--out",
        str(here),
    ]
    assert main(asked) == 2
    assert "got person 4 at frame 40, 20 frames after its previous row" in capsys.readouterr().err
    assert main([*asked, "--gaps", "interpolate"]) == 0
    out = capsys.readouterr().out
    assert "mended: 1 row interpolated (person 4 after frame 20)" in out
    assert "2 persons, 5 frames of 0.4 s" in out
    assert here.read_text().splitlines()[0] == "# framerate: 2.5"
    assert here.read_text().splitlines()[2] == "3\t1\t1.25\t4.5\t0.0"
    back = tmp_path / "crowd.csv"
    asked = [
        "data",
        "convert",
        str(here),
        "--format",
        "jupedsim",
        "--to",
        "csv",
        "--out",
        str(back),
    ]
    assert main(asked) == 0
    crowd = read_recording(back, "csv", name="back", dt_s=0.4, at_frames=False)
    other = read_recording(here, "jupedsim", name="here", at_frames=False)
    np.testing.assert_array_equal(crowd.xy, other.xy)


def test_pedpy_loads_what_is_written(tmp_path: Path) -> None:
    need(find_spec("pedpy"), "the extra pedpy")
    import pedpy

    path = tmp_path / "crowd.txt"
    write_jupedsim(trajnet(scene(2.25), *tracks()), path)
    loaded = pedpy.load_trajectory(trajectory_file=path)
    assert loaded.frame_rate == 2.25
    assert loaded.data[["id", "frame", "x", "y"]].values.tolist()[0] == [3, 1, 1.25, 4.5]
