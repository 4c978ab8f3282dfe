from pathlib import Path

import numpy as np
import pytest

from crowdbench.data.recordings.catalogue import SOURCES, read_files, read_published
from crowdbench.data.recordings.obsmat import read_obsmat
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError

ETH = SOURCES["eth"]


def line(frame: object, person: object, x: object = 1.0, y: object = 2.0) -> str:
    """A row as the recordings have it: z between x and y, velocities behind."""
    return f"{frame} {person} {x} 0.0 {y} 0.1 0.0 0.2\n"


def read(text: str, *, fps: float = 15.0, frame_step: int = 6) -> Trajectories:
    return read_obsmat(
        text.encode(), name="here", fps=fps, frame_step=frame_step, where="here/obsmat.txt"
    )


def published(folder: Path, data: bytes) -> Path:
    """A folder in OpenTraj's layout that holds `data` as the ETH recording."""
    path = folder / ETH.path
    path.parent.mkdir(parents=True)
    path.write_bytes(data)
    return path


@pytest.fixture
def eth_bytes(opentraj: Path) -> bytes:
    return (opentraj / ETH.path).read_bytes()


def test_columns_are_frame_person_x_z_y():
    crowd = read("780 4 8.5 99 3.5 1 99 0\n786 4 9.5 99 3.75 1 99 0\n")
    assert crowd.person_id.tolist() == [4]
    assert crowd.path(0).tolist() == [[8.5, 3.5], [9.5, 3.75]]


def test_frames_count_from_the_first_annotated_one():
    crowd = read(line(780, 1) + line(786, 1) + line(786, 2))
    assert crowd.first.tolist() == [0, 1]
    assert crowd.frames == 2


def test_a_shifted_phase_is_put_on_the_grid_by_rounding_down():
    crowd = read(line(780, 1) + line(786, 1) + line(797, 2) + line(803, 2))
    assert crowd.first.tolist() == [0, 2]


def test_dt_is_the_annotation_interval_in_seconds():
    assert read(line(0, 1) + line(6, 1)).dt_s == 0.4


BROKEN = {
    "empty": ("", "an empty file", "rows of numbers"),
    "blank": ("\n  \n", "an empty file", "rows of numbers"),
    "broken off": (line(0, 1) + "6 1 1.0 0.0 2", "5 columns in row 2", "8 (frame, person"),
    "six columns": ("0 1 2 3 4 5\n" * 3, "6 columns in row 1", "8 (frame, person"),
    "text": (line(0, 1) + line(6, 1, "left"), "left", "numbers in each row"),
    "header": ("frame id x z y vx vz vy\n" + line(0, 1), "frame", "numbers in each row"),
    "comment": (line(0, 1) + "# 1 2 3 4 5 6 7\n", "#", "numbers in each row"),
    "nan": (line(0, 1) + line(6, 1, "nan"), "not finite, the first for person 1", "finite x and y"),
    "inf": (line(0, 1, 1, "-inf"), "not finite, the first for person 1", "finite x and y"),
    "nan frame": (line(0, 1) + line("nan", 1), "frame nan in row 2", "integers"),
    "half frame": (line(0, 1) + line(6.5, 1), "frame 6.5 in row 2", "integers"),
    "huge frame": (line("1e300", 1), "frame 1e+300 in row 1", "integers"),
    "half person": (line(0, 1.5), "person 1.5 in row 1", "integers"),
    "duplicate": (line(0, 1) + line(6, 1) * 2, "person 1 twice at frame 6", "one row per person"),
    "hole": (
        line(0, 1) + line(6, 1) + line(18, 1),
        "1 of 2 intervals",
        "a row of each person every 6",
    ),
}


@pytest.mark.parametrize(("text", "got", "expected"), BROKEN.values(), ids=BROKEN)
def test_broken_data_are_refused_with_what_was_got_and_expected(text, got, expected):
    with pytest.raises(RecordingError) as caught:
        read_files(ETH, {"obsmat.txt": text.encode()}, "here/obsmat.txt")
    error = caught.value
    assert error.where == "here/obsmat.txt"
    assert got in error.got
    assert expected in error.expected
    assert error.hint
    for part in (error.where, error.got, error.expected, error.hint):
        assert part in str(error)


def test_another_annotation_interval_is_refused():
    with pytest.raises(RecordingError) as caught:
        read("".join(line(frame, 1) for frame in range(0, 100, 10)))
    assert "every 10 frames" in caught.value.got
    assert "every 6 frames (0.4 s at 15 fps)" in caught.value.expected
    assert "another interval" in caught.value.hint


def test_a_real_recording_of_another_interval_is_refused(opentraj):
    data = (opentraj / SOURCES["hotel"].path).read_bytes()
    with pytest.raises(RecordingError, match="every 10 frames"):
        read_obsmat(data, name="eth", fps=ETH.fps, frame_step=ETH.frame_step, where="obsmat.txt")


def test_a_missing_file_is_refused_with_its_public_address(tmp_path):
    with pytest.raises(RecordingError) as caught:
        read_published(ETH, tmp_path)
    assert caught.value.where == str(tmp_path / ETH.path)
    assert caught.value.got == "no such file"
    assert ETH.address in caught.value.hint


def test_a_file_broken_off_within_a_row_is_refused(tmp_path, eth_bytes):
    rows = eth_bytes.splitlines(keepends=True)
    path = published(tmp_path, b"".join(rows[:500]) + rows[500][:60])
    with pytest.raises(RecordingError) as caught:
        read_published(ETH, tmp_path)
    assert caught.value.where == str(path)
    assert "columns in row 501" in caught.value.got


@pytest.mark.parametrize("cut", ["after a row", "within the last number"])
def test_a_file_that_looks_whole_but_is_cut_short_is_refused_by_its_hash(tmp_path, eth_bytes, cut):
    short = b"".join(eth_bytes.splitlines(keepends=True)[:500])
    path = published(tmp_path, short if cut == "after a row" else eth_bytes.rstrip()[:-4])
    with pytest.raises(RecordingError) as caught:
        read_published(ETH, tmp_path)
    assert caught.value.where == str(path)
    assert "SHA-256" in caught.value.got
    assert ETH.sha256[:12] in caught.value.expected
    assert ETH.address in caught.value.hint


def test_a_changed_position_is_refused_by_the_hash(tmp_path, eth_bytes):
    published(tmp_path, eth_bytes.replace(b"8.4568443e+00", b"8.4568444e+00", 1))
    with pytest.raises(RecordingError, match="SHA-256"):
        read_published(ETH, tmp_path)


def test_each_row_of_the_file_is_one_row_of_the_table(opentraj, eth_bytes):
    rows = np.loadtxt(eth_bytes.decode().splitlines())
    crowd = read_published(ETH, opentraj)
    got = np.stack([crowd.person_id[crowd.row_person()], crowd.row_frame()])
    frame = (rows[:, 0] - rows[:, 0].min()) // 6
    order = np.lexsort((frame, rows[:, 1]))
    table = np.lexsort((got[1], got[0]))
    np.testing.assert_array_equal(got[:, table], np.stack([rows[:, 1], frame])[:, order])
    np.testing.assert_allclose(crowd.xy[table], rows[order][:, [2, 4]], rtol=1e-6)
