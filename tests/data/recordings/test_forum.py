"""The Edinburgh Forum: what is known of 1 July 2010, and made-up days in its format."""

import re
from collections import defaultdict
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from crowdbench.data.recordings.catalogue import SOURCES, read_files, read_published, source
from crowdbench.data.recordings.forum import read_forum
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError

FORUM = SOURCES["forum"]
Rows = list[tuple[int, int, int]]


@pytest.fixture(scope="module")
def crowd(opentraj: Path) -> Trajectories:
    return read_published(FORUM, opentraj)


@pytest.fixture(scope="module")
def tracks(opentraj: Path) -> dict[int, np.ndarray]:
    """Column, row and time of the real detections by track, read in another way."""
    found = {}
    for line in (opentraj / FORUM.path).read_text().splitlines():
        if line.strip().startswith("TRACK"):
            number, *values = map(int, re.findall(r"\d+", line))
            found[number] = np.array(values).reshape(-1, 3)
    return found


def speeds(rows: np.ndarray) -> np.ndarray:
    """m/s from each detection to the next that is later, of the first one of each time."""
    _, first = np.unique(rows[:, 2], return_index=True)
    steps = np.diff(rows[first], axis=0)
    return np.hypot(steps[:, 0], steps[:, 1]) * 0.0247 * 9 / steps[:, 2]


def test_there_are_1262_tracks_and_all_that_double_none_are_persons(
    tracks: dict[int, np.ndarray], crowd: Trajectories
):
    assert len(tracks) == 1262
    assert len(crowd) == 1262 - 102
    assert set(crowd.person_id.tolist()) <= set(tracks)


def test_tracks_double_others(tracks: dict[int, np.ndarray], crowd: Trajectories):
    detections = {number: set(map(tuple, rows.tolist())) for number, rows in tracks.items()}
    owners = defaultdict(list)
    for number, each in detections.items():
        for detection in each:
            owners[detection].append(number)
    shared: dict[tuple[int, int], int] = defaultdict(int)
    for numbers in owners.values():
        for pair in combinations(numbers, 2):
            shared[pair] += 1
    share = {
        pair: count / min(len(detections[number]) for number in pair)
        for pair, count in shared.items()
    }
    assert sum(s > 0.5 for s in share.values()) == 105
    assert sum(s >= 0.5 for s in share.values()) == 109
    kept = set(crowd.person_id.tolist())
    assert not any(share[pair] >= 0.5 for pair in share if set(pair) <= kept)
    for number in set(tracks) - kept:
        longer = (len(detections[a + b - number]) for a, b in share
                  if number in (a, b) and share[a, b] >= 0.5)  # fmt: skip
        assert max(longer) >= len(detections[number])


def test_most_tracks_jitter_from_one_frame_of_the_camera_to_the_next(
    tracks: dict[int, np.ndarray], crowd: Trajectories
):
    assert sum((speeds(rows) > 3).any() for rows in tracks.values()) == 1165
    # With the mean of several detections at one time instead of the first it is one less.
    assert crowd.provenance["notes"]["jitter"].startswith("1164 tracks")


def test_over_four_frames_of_the_camera_jitter_is_rare(crowd: Trajectories):
    steps = np.linalg.norm(np.diff(crowd.xy, axis=0), axis=1)[np.diff(crowd.row_person()) == 0]
    assert round(100 * (steps / crowd.dt_s > 3).mean(), 1) == 0.8


def test_people_walk_at_the_speed_of_people(crowd: Trajectories):
    assert 1.2 < np.nanmedian(crowd.mean_speeds()) < 1.5


def test_frames_are_of_four_ninths_of_a_second_and_arrivals_lie_on_each_ninth(
    tracks: dict[int, np.ndarray], crowd: Trajectories
):
    assert (crowd.dt_s, crowd.grid_s) == (4 / 9, 1 / 9)
    begins = np.array([tracks[number][0, 2] for number in crowd.person_id])
    np.testing.assert_allclose(crowd.spawn_s * 9, begins, atol=1e-6)
    np.testing.assert_array_equal(crowd.requested_s, crowd.spawn_s)
    np.testing.assert_array_equal(crowd.first, -(-begins // 4))
    assert set(begins % 4) == {0, 1, 2, 3}


def test_the_day_lasts_ten_hours(tracks: dict[int, np.ndarray], crowd: Trajectories):
    assert crowd.frames - 1 == max(rows[-1, 2] for rows in tracks.values()) // 4
    assert 9.9 < crowd.duration_s / 3600 < 10.1
    assert crowd.entered.all()
    assert (~crowd.left).sum() == 1


def test_real_tracks_have_several_detections_at_one_time_and_gaps(tracks: dict[int, np.ndarray]):
    steps = [np.diff(rows[:, 2]) for rows in tracks.values()]
    assert sum((s == 0).any() for s in steps) == 92
    assert max(s.max(initial=0) for s in steps) == 12


def test_a_pixel_is_24_7_mm_and_rows_count_from_the_top(
    tracks: dict[int, np.ndarray], crowd: Trajectories
):
    for k, number in enumerate(crowd.person_id.tolist()):
        rows = tracks[number]
        times, count = np.unique(rows[:, 2], return_counts=True)
        once = np.isin(rows[:, 2], times[count == 1]) & (rows[:, 2] % 4 == 0)
        at = crowd.path(k)[rows[once, 2] // 4 - crowd.first[k]]
        np.testing.assert_allclose(at[:, 0], 0.0247 * rows[once, 0], rtol=1e-5)
        np.testing.assert_allclose(at[:, 1], 0.0247 * (480 - rows[once, 1]), rtol=1e-5, atol=1e-6)


def matlab(tracks: dict[int, Rows], stated: int | None = None) -> bytes:
    """A day's file."""
    lines = [f"% Total number of trajectories in file are  {stated or len(tracks)} \n"]
    for number, rows in tracks.items():
        points = ";".join(f"[{x} {y} {t}]" for x, y, t in rows)
        lines.append(f"Properties.R{number}=[{len(rows)} {rows[0][2]} {rows[-1][2]} 568.49 ];")
        lines.append(f" TRACK.R{number}=[{points}];\n\n")
    return "\n".join(lines).encode()


def read(data: bytes) -> Trajectories:
    return read_forum(data, name="forum-14jul", where="tracks.14Jul.txt")


def test_positions_in_every_fourth_frame_of_the_camera_are_taken():
    crowd = read(matlab({5: [(0, 480, 2), (20, 480, 4), (40, 470, 8), (50, 470, 9)]}))
    assert crowd.scene == "forum-14jul"
    assert crowd.person_id.tolist() == [5]
    assert crowd.first.tolist() == [1]
    np.testing.assert_allclose(crowd.path(0), [[0.494, 0], [0.988, 0.247]], rtol=1e-6)
    np.testing.assert_allclose(crowd.spawn_s, 2 / 9)


def test_what_the_camera_missed_is_interpolated():
    crowd = read(matlab({1: [(0, 480, 0), (100, 480, 10)]}))
    np.testing.assert_allclose(crowd.path(0)[:, 0] / 0.0247, [0, 40, 80], rtol=1e-6)


def test_of_several_detections_at_one_time_the_mean_is_taken():
    crowd = read(matlab({1: [(10, 100, 4), (20, 120, 4), (30, 110, 8)]}))
    np.testing.assert_allclose(crowd.path(0)[0] / 0.0247, [15, 480 - 110], rtol=1e-6)


def test_who_is_there_between_two_frames_only_is_left_out_and_counted():
    crowd = read(matlab({1: [(0, 0, 1), (0, 0, 3)], 2: [(9, 9, 3), (9, 9, 4)]}))
    assert crowd.person_id.tolist() == [2]
    assert "1 between two frames" in crowd.provenance["notes"]["tracks"]


def line(number: int, begin: int, length: int) -> Rows:
    """Detections of someone who walks through a row of the image."""
    return [(k, number, k) for k in range(begin, begin + length)]


@pytest.mark.parametrize(
    ("shared", "kept"), [(5, [1]), (4, [1, 2])], ids=["half of it", "less than half"]
)
def test_the_shorter_of_two_tracks_that_share_half_of_it_is_left_out(shared: int, kept: list[int]):
    follower = line(7, 0, shared) + line(8, shared, 10 - shared)
    crowd = read(matlab({1: line(7, 0, 12), 2: follower}))
    assert crowd.person_id.tolist() == kept


def test_of_two_equal_tracks_the_first_is_kept():
    assert read(matlab({8: line(7, 0, 12), 3: line(7, 0, 12)})).person_id.tolist() == [3]


def test_line_breaks_and_missing_semicolons_are_as_good():
    plain = matlab({1: [(1, 2, 0), (3, 4, 4)], 2: [(5, 6, 0), (7, 8, 4)]})
    broken = plain.replace(b";[", b"\r\n [ ").replace(b"]];", b" ] ]").replace(b"=[", b" = \n[")
    np.testing.assert_array_equal(read(broken).xy, read(plain).xy)


@st.composite
def days(draw: st.DrawFn) -> dict[int, Rows]:
    made = {}
    for number in draw(st.sets(st.integers(1, 9999), min_size=1, max_size=5)):
        times = sorted(draw(st.sets(st.integers(0, 300), min_size=1, max_size=8)))
        # Each track has a column of its own: none doubles another.
        made[number] = [(number, draw(st.integers(0, 479)), t) for t in times]
    return made


@given(days())
def test_each_detection_is_read_where_and_when_it_was_made(made: dict[int, Rows]):
    seen = {n: rows for n, rows in made.items() if -(-rows[0][2] // 4) <= rows[-1][2] // 4}
    if not seen:
        with pytest.raises(RecordingError, match="between two frames"):
            read(matlab(made))
        return
    crowd = read(matlab(made))
    assert sorted(crowd.person_id.tolist()) == sorted(seen)
    for k, number in enumerate(crowd.person_id.tolist()):
        rows = np.array(made[number])
        assert crowd.first[k] == -(-rows[0, 2] // 4)
        assert crowd.last[k] == rows[-1, 2] // 4
        assert round(crowd.spawn_s[k] * 9) == rows[0, 2]
        on = rows[rows[:, 2] % 4 == 0]
        at = crowd.path(k)[on[:, 2] // 4 - crowd.first[k]]
        expected = 0.0247 * np.stack([on[:, 0], 480 - on[:, 1]], axis=1)
        np.testing.assert_allclose(at, expected, rtol=1e-5, atol=1e-6)


WELL = matlab({1: line(7, 0, 9), 2: line(8, 3, 9)})


@given(st.integers(0, len(WELL) - 1), st.binary(max_size=3))
def test_any_altered_bytes_are_a_crowd_or_an_error(at: int, put: bytes):
    try:
        crowd = read(WELL[:at] + put + WELL[at + 1 :])
    except RecordingError:
        return
    assert len(crowd) <= 2


@given(st.integers(0, len(WELL.rstrip()) - 3))
def test_a_file_broken_off_anywhere_is_refused(at: int):
    with pytest.raises(RecordingError):
        read(WELL[:at])


def first_track(body: str) -> bytes:
    return f"% Total number of trajectories in file are 1\nTRACK.R1={body}\n".encode()


BROKEN = {
    "empty": (b"", "no line with the number"),
    "another file": (b"0 1 2\n3 4 5\n", "no line with the number"),
    "no track": (matlab({1: line(7, 0, 9)}).split(b"\n")[0], "0 tracks"),
    "none stated": (b"% Total number of trajectories in file are 0", "0 tracks"),
    "too few": (matlab({1: line(7, 0, 9)}, stated=2), "1 tracks; expected 2"),
    "too many": (WELL.replace(b"are  2", b"are  1"), "2 tracks; expected 1"),
    "twice": (WELL.replace(b"TRACK.R2", b"TRACK.R1"), "TRACK.R1 twice"),
    "no number": (WELL.replace(b"TRACK.R2", b"TRACK.Rx"), "a track named TRACK.R'x'"),
    "a number without end": (WELL.replace(b"K.R2", b"K.R" + b"2" * 5000), "a track named"),
    "text": (first_track("[[left 2 3]]"), "invalid literal"),
    "fractions": (first_track("[[1.5 2 3]]"), "invalid literal"),
    "two numbers": (first_track("[[1 2];[1 2 3]]"), "[1 2' among the detections"),
    "four numbers": (first_track("[[1 2 3 4]]"), "among the detections"),
    "no brackets": (first_track("1 2 3"), "among the detections"),
    "nothing": (first_track("[]"), "among the detections"),
    "something between": (first_track("[[1 2 3], [1 2 4]]"), "among the detections"),
    "broken off": (first_track("[[1 2 3];[1 2"), "among the detections"),
    "broken off after a point": (first_track("[[1 2 3];[1 2 4]"), "among the detections"),
    "huge": (first_track(f"[[1 2 {9**30}]]"), "too large"),
    "descending": (first_track("[[1 2 8];[1 2 7]]"), "time 7 after time 8"),
    "before the day": (first_track("[[1 2 -8];[1 2 8]]"), "frames -2 to 2"),
    "a day of years": (first_track("[[1 2 0];[1 2 4000000000]]"), "persons times frames"),
    "in years": (first_track("[[1 2 4000000000]]"), "1000000001 frames"),
    "nobody in a frame": (first_track("[[1 2 1];[1 2 2]]"), "between two frames"),
    "all the same": (matlab({n: line(7, 0, 2) for n in range(101)}), "that 101 tracks share"),
}


@pytest.mark.parametrize(("data", "got"), BROKEN.values(), ids=BROKEN)
def test_broken_data_are_refused_with_what_was_got_and_expected(data: bytes, got: str):
    with pytest.raises(RecordingError) as caught:
        read_files(source("forum-14jul"), {"tracks": data}, "tracks.14Jul.txt")
    error = caught.value
    assert error.where.startswith("tracks.14Jul.txt")
    assert got in str(error)
    assert error.hint
    assert len(str(error)) < 1000


TEN_MB = 10_000_000
HOSTILE = {
    "tracks without an end": b"TRACK.R1=[[1 2 3];" * (TEN_MB // 18),
    "blanks": b"TRACK.R1=[[1 2 3]" + b" " * TEN_MB + b"x",
    "opening brackets": b"TRACK.R1=[" + b"[" * TEN_MB,
    "closing brackets": b"TRACK.R1=[[1 2 3]" + b"]" * TEN_MB,
    "semicolons": b"TRACK.R1=[[1 2 3]" + b";" * TEN_MB + b"]",
    "one number": b"TRACK.R1=[[1 2 " + b"3" * TEN_MB + b"]]",
    "one word": b"TRACK.R1=[[1 2 " + b"x" * TEN_MB + b"]]",
    "names": b"TRACK.R" * (TEN_MB // 7),
}


@pytest.mark.parametrize("body", HOSTILE.values(), ids=HOSTILE)
def test_ten_hostile_megabytes_are_refused(body: bytes):
    # What is quadratic in them would take hours.
    with pytest.raises(RecordingError) as caught:
        read(b"% Total number of trajectories in file are 1\n" + body)
    assert len(str(caught.value)) < 1000


def test_other_days_have_names_of_their_own():
    day = source("forum-14jul")
    assert day.path == "datasets/Edinburgh/annotations/tracks.14Jul.txt"
    assert day.address == "https://homepages.inf.ed.ac.uk/rbf/FORUMTRACKING/DAYS/Jul.14.zip"
    assert day.sha256 is None


@pytest.mark.parametrize(
    "name",
    [
        "forum-1jul",
        "forum-01JUL",
        "forum-",
        "forum-01jul ",
        "forum-99jul",
        "forum-14xyz",
        "Forum",
    ],
)
def test_what_is_no_day_is_refused(name: str):
    with pytest.raises(SettingError, match="a day of the Forum like forum-14jul"):
        source(name)
