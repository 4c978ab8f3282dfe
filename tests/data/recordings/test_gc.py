"""Grand Central: what is known of the real folder, and made-up folders in its format."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.data.recordings.catalogue import SOURCES, read_files, read_published
from crowdbench.data.recordings.gc import read_gc
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError

GC = SOURCES["gc"]
Files = dict[str, bytes]


@pytest.fixture(scope="module")
def files(opentraj: Path) -> Files:
    """The real folder's files by name."""
    folder = opentraj / GC.path
    paths = [folder / "H.json", *sorted((folder / "Annotation").iterdir())]
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in paths}


@pytest.fixture(scope="module")
def crowd(opentraj: Path) -> Trajectories:
    return read_published(GC, opentraj)


def rows_of(data: bytes) -> np.ndarray:
    """Column, row and video frame of each annotation."""
    return np.array([int(number) for number in data.split()]).reshape(-1, 3)


def people(files: Files) -> dict[str, np.ndarray]:
    return {name: rows_of(data) for name, data in files.items() if name != "H.json"}


def test_there_are_12684_files_of_which_12671_have_two_annotations(
    files: Files, crowd: Trajectories
):
    annotated = people(files)
    assert len(annotated) == 12_684
    assert sum((rows[:, 2] < 100_000).sum() > 1 for rows in annotated.values()) == 12_671
    assert len(crowd) == 12_671


def test_every_20th_frame_of_the_video_was_annotated(files: Files):
    frames = np.concatenate([rows[:, 2] for rows in people(files).values()])
    assert (frames % 20 == 0).all()
    assert len(np.unique(frames[frames < 100_000])) == 5000


def test_as_many_persons_are_present_as_the_publisher_says(crowd: Trajectories):
    annotated = crowd.present()[::2]
    assert len(annotated) == 5000
    assert round(annotated.mean()) == 123
    assert annotated.max() == 332


def test_frames_are_of_two_fifths_of_a_second_and_arrivals_lie_on_every_second(
    crowd: Trajectories,
):
    assert (crowd.dt_s, crowd.grid_s) == (0.4, 0.8)
    assert (crowd.first % 2 == 0).all()
    np.testing.assert_allclose(crowd.spawn_s, crowd.first * 0.4)


def test_who_runs_on_after_the_recording_is_cut_off_and_has_not_left(
    files: Files, crowd: Trajectories
):
    ends = {int(name[-10:-4]): rows[-1, 2] for name, rows in people(files).items()}
    assert max(ends.values()) == 120_000
    assert crowd.frames == 10_000
    assert crowd.last.max() == 9999
    beyond = np.array([ends[number] >= 100_000 for number in crowd.person_id])
    assert beyond.any()
    assert (crowd.last[beyond] == 9999).all()
    np.testing.assert_array_equal(crowd.left, crowd.last < 9999)


def test_seventy_were_there_when_observation_began(crowd: Trajectories):
    assert (crowd.first == 0).sum() == 70
    np.testing.assert_array_equal(crowd.entered, crowd.first > 0)


def test_people_walk_at_the_speed_of_people(crowd: Trajectories):
    assert 1.1 <= np.nanmedian(crowd.mean_speeds()) < 1.2


def test_with_row_and_column_swapped_they_would_walk_half_as_fast(files: Files):
    homography = np.array(json.loads(files["H.json"])["homog"])
    swapped = json.dumps({"homog": homography[:, [1, 0, 2]].tolist()}).encode()
    wrong = read_gc({**files, "H.json": swapped}, "swapped")
    assert 0.5 < np.nanmedian(wrong.mean_speeds()) < 0.7


def test_one_file_is_one_person_wherever_annotations_pause(files: Files, crowd: Trajectories):
    annotated = people(files)
    pausing = sum((np.diff(rows[:, 2]) > 20).any() for rows in annotated.values())
    assert pausing > 1000
    for k in range(0, len(crowd), 1000):
        inside = annotated[f"Annotation/{crowd.person_id[k]:06}.txt"][:, 2]
        inside = inside[inside < 100_000]
        assert crowd.first[k] == inside[0] // 10
        assert crowd.last[k] >= inside[-1] // 10


def test_the_description_says_what_was_left_out(crowd: Trajectories):
    assert crowd.provenance["notes"] == {
        "files": "12684, 13 of them left out for having a single annotation",
        "cut off": "5751 positions after video frame 100000",
    }


DECIMETRES = b'{"homog":[[0.125,0,0],[0,0.125,0],[0,0,1]]}'
"""A homography after which a pixel is 0.1 m, and x goes along the image's rows."""


def text(rows: list[tuple[int, int, int]]) -> bytes:
    return "\n".join(" ".join(map(str, row)) for row in rows).encode()


def folder(persons: Mapping[int, list[tuple[int, int, int]]], homography: bytes = DECIMETRES):
    annotated = {f"Annotation/{number:06}.txt": text(rows) for number, rows in persons.items()}
    return {"H.json": homography, **annotated}


def test_positions_between_two_annotations_are_interpolated():
    crowd = read_gc(folder({7: [(100, 10, 40), (120, 10, 60), (120, 30, 80)]}), "here")
    assert crowd.person_id.tolist() == [7]
    assert crowd.first.tolist() == [4]
    expected = [[1, 10], [1, 11], [1, 12], [2, 12], [3, 12]]
    np.testing.assert_allclose(crowd.path(0), expected, rtol=1e-6)


def test_a_pause_is_walked_straight():
    crowd = read_gc(folder({1: [(0, 0, 0), (100, 0, 100)]}), "here")
    np.testing.assert_allclose(crowd.path(0)[:, 1], np.arange(11), rtol=1e-6)


def test_a_homography_with_perspective_divides():
    perspective = b'{"homog":[[1,0,0],[0,1,0],[0.5,0,1]]}'
    crowd = read_gc(folder({1: [(3, 2, 0), (3, 2, 20)]}, perspective), "here")
    np.testing.assert_allclose(crowd.path(0)[0], [0.8, 1.2], rtol=1e-6)


def test_who_is_annotated_after_the_end_walks_until_the_end():
    crowd = read_gc(folder({1: [(0, 0, 99_960), (0, 20, 99_980), (0, 60, 100_020)]}), "here")
    np.testing.assert_allclose(crowd.path(0)[:, 0], [0, 1, 2, 3], rtol=1e-6)
    assert crowd.last.tolist() == [9999]
    assert not crowd.left.any()


def test_who_is_annotated_once_is_left_out():
    once = [(0, 0, 99_980), (0, 0, 100_000)]
    crowd = read_gc(folder({1: [(0, 0, 0), (0, 0, 20)], 2: [(0, 0, 0)], 3: once}), "here")
    assert crowd.person_id.tolist() == [1]


@st.composite
def annotated_people(draw: st.DrawFn) -> dict[int, list[tuple[int, int, int]]]:
    pixel = st.integers(0, 1919)
    steps = st.lists(st.integers(0, 4999), min_size=2, max_size=6, unique=True)
    made = {}
    for number in draw(st.sets(st.integers(1, 999_999), min_size=1, max_size=5)):
        made[number] = [(draw(pixel), draw(pixel), 20 * step) for step in sorted(draw(steps))]
    return made


@given(annotated_people())
def test_each_annotation_is_read_where_and_when_it_was_made(made):
    crowd = read_gc(folder(made), "here")
    assert sorted(crowd.person_id.tolist()) == sorted(made)
    assert crowd.frames == 10_000
    for k, number in enumerate(crowd.person_id.tolist()):
        rows = np.array(made[number])
        frame = rows[:, 2] // 10
        assert (crowd.first[k], crowd.last[k]) == (frame[0], frame[-1])
        at = crowd.path(k)[frame - frame[0]]
        np.testing.assert_allclose(at, rows[:, [1, 0]] * 0.1, atol=1e-4)


@given(st.binary(max_size=60) | st.text("0123456789 \n-_.", max_size=60).map(str.encode))
def test_any_bytes_are_a_person_or_an_error(data: bytes):
    try:
        crowd = read_gc({**person(data), "Annotation/000002.txt": WELL}, "here")
    except RecordingError:
        return
    assert 2 in crowd.person_id


WELL = text([(1, 2, 0), (1, 2, 20)])


def person(data: bytes) -> Files:
    """A folder with this person's file only."""
    return {"H.json": DECIMETRES, "Annotation/000001.txt": data}


def homography(data: bytes) -> Files:
    """A folder with this homography."""
    return {**person(WELL), "H.json": data}


BROKEN = {
    "an empty folder": ({}, "no H.json"),
    "no homography": ({"Annotation/000001.txt": WELL}, "no H.json"),
    "no persons": ({"H.json": DECIMETRES}, "no file of a person"),
    "another shape": (homography(b'{"homog":[[1,2],[3,4]]}'), "`array` of length 3"),
    "not finite": (homography(b'{"homog":[[1,2,3],[4,5,6],[7,8,1e999]]}'), "finite"),
    "words": (homography(b'{"homog":"none"}'), "got `str`"),
    "another key": (homography(b'{"H":[]}'), "homog"),
    "no JSON": (homography(b"homog"), "H.json"),
    "nested without end": (homography(b"[" * 100_000), "H.json"),
    "no text": (homography(b"\xff\xfe"), "H.json"),
    "a horizon": (homography(b'{"homog":[[1,0,0],[0,1,0],[0,0,0]]}'), "not finite"),
    "nothing": (person(b""), "0 numbers"),
    "broken off": (person(WELL + b"\n1 2"), "8 numbers"),
    "a header": (person(b"column row frame"), "invalid literal"),
    "fractions": (person(b"1.5 2 0 1 2 20"), "invalid literal"),
    "huge": (person(b"1 2 0 1 2 " + b"9" * 30), "too large"),
    "a megabyte of digits": (person(b"1 2 " + b"9" * 1_000_000), "digits"),
    "another step": (person(text([(1, 2, 0), (1, 2, 10)])), "an annotation of frame 10"),
    "a negative frame": (person(text([(1, 2, -20), (1, 2, 0)])), "an annotation of frame -20"),
    "descending": (person(text([(1, 2, 20), (1, 2, 0)])), "frame 0 after frame 20"),
    "a frame twice": (person(text([(1, 2, 20), (1, 3, 20)])), "frame 20 after frame 20"),
    "nobody twice": (person(text([(1, 2, 0)])), "1 files with a single annotation"),
    "no number": ({**person(WELL), "Annotation/one.txt": WELL}, "Annotation/one.txt"),
    "a number another way": ({**person(WELL), "Annotation/1.txt": WELL}, "Annotation/1.txt"),
}


@pytest.mark.parametrize(("files", "got"), BROKEN.values(), ids=BROKEN)
def test_broken_files_are_refused_with_what_was_got_and_expected(files: Files, got: str):
    with pytest.raises(RecordingError) as caught:
        read_files(GC, files, "here")
    error = caught.value
    assert error.where.startswith("here")
    assert got in str(error)
    assert error.expected
    assert error.hint
    assert len(str(error)) < 1000


def test_a_folder_without_the_files_is_refused(tmp_path: Path):
    with pytest.raises(RecordingError, match="no such file") as caught:
        read_published(GC, tmp_path)
    assert "crowdbench data fetch gc" in caught.value.hint


def test_a_folder_that_lacks_a_person_is_refused_by_its_hash(opentraj: Path, tmp_path: Path):
    here, there = opentraj / GC.path, tmp_path / GC.path
    (there / "Annotation").mkdir(parents=True)
    (there / "H.json").symlink_to(here / "H.json")
    for path in (here / "Annotation").iterdir():
        if path.name != "012684.txt":
            (there / "Annotation" / path.name).symlink_to(path)
    with pytest.raises(RecordingError, match="SHA-256"):
        read_published(GC, tmp_path)
