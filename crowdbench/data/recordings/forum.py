"""Reader for a day of the Edinburgh Informatics Forum: tracks in pixels of a ceiling camera.

The file is Matlab code. For each track it has `Properties.Rn= [...]`, which is ignored, and
`TRACK.Rn=[[x y t];[x y t];...];` with t in frames of about 9 fps.
"""

import re
from collections import Counter, defaultdict
from itertools import permutations

import numpy as np
from jaxtyping import Int

from crowdbench.data.table import Trajectories, from_rows, interpolated
from crowdbench.errors import RecordingError

FPS = 9.0
FRAME = 4
"""Camera frames per frame of the scene. Tracks jitter: most of them have a step above 3 m/s from
one camera frame to the next, which is rare over four camera frames."""
PIXEL_M = 0.0247
IMAGE_ROWS = 480

MAX_ROWS = 10_000_000
"""Maximum number of rows (persons times frames); a busy day has 100,000."""
MAX_SHARING = 100
"""Maximum number of tracks that share a detection; on 1 July 2010 it is at most four."""

_STATED = re.compile(rb"Total number of trajectories in file are\s+(\d{1,9})\b")


def read_forum(data: bytes, *, name: str, where: object) -> Trajectories:
    """Read the bytes of a day's `tracks` file.

    Positions are those in every fourth camera frame (4/9 s), interpolated if the camera missed
    one; arrival times are kept on the camera's frames. Observation begins with camera frame 0 and
    ends with the last detection. If two tracks share at least half of the shorter one's detections
    (the same pixel at the same time), both follow one person, and the shorter is left out. If a
    track has several detections at one time, their mean is used.

    Raises:
        RecordingError: the file is empty, truncated, or holds no tracks.
    """
    tracks = _tracks(data, where)
    doubles = _doubles(tracks, where)
    spans = sum((int(rows[-1, 2]) - int(rows[0, 2])) // FRAME + 1 for rows in tracks.values())
    if spans > MAX_ROWS:
        got = f"{spans} rows (persons times frames)"
        expected = f"at most {MAX_ROWS}"
        raise RecordingError(where, got=got, expected=expected, hint="A time may be wrong.")
    pieces, fast, short = [], 0, 0
    for number, rows in tracks.items():
        tick, of_row, count = np.unique(rows[:, 2], return_inverse=True, return_counts=True)
        x, y = (np.bincount(of_row, rows[:, k]) / count for k in (0, 1))
        at = PIXEL_M * np.stack([x, IMAGE_ROWS - y], axis=1)
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(tick) * FPS
        fast += bool((speed > 3.0).any())
        frame = np.arange(-(-tick[0] // FRAME), tick[-1] // FRAME + 1)
        if number in doubles:
            continue
        if len(frame) == 0:
            short += 1
            continue
        of_person = (np.full(len(frame), value) for value in (number, tick[0] / FPS))
        pieces.append((*of_person, frame, interpolated(frame * FRAME, tick, at)))
    if not pieces:
        got = f"{len(tracks)} tracks, all of them between two frames of {FRAME}/9 s"
        raise RecordingError(where, got=got, expected="at least one track that spans a frame")
    person, entered_s, frame, xy = (np.concatenate(part) for part in zip(*pieces, strict=True))
    notes = {
        "tracks": f"{len(tracks)}; left out: {len(doubles)} duplicates of other tracks, {short} "
        "between two frames",
        "jitter": f"{fast} tracks with a step above 3 m/s within 1/9 s",
    }
    return from_rows(
        scene=name,
        dt_s=FRAME / FPS,
        grid_s=1 / FPS,
        person_id=person,
        frame=frame,
        xy=xy,
        persons={"spawn_s": entered_s},
        provenance={"notes": notes},
        where=where,
    )


def _tracks(data: bytes, where: object) -> dict[int, Int[np.ndarray, "n 3"]]:
    """Column, row and time of the detections of each track, by track number."""
    stated = _STATED.search(data)
    if stated is None:
        raise RecordingError(
            where,
            got="no line with the number of trajectories",
            expected="a tracks file of the Edinburgh Informatics Forum",
        )
    tracks: dict[int, Int[np.ndarray, "n 3"]] = {}
    for piece in data.split(b"TRACK.R")[1:]:
        label, _, body = piece.partition(b"=")
        if not label.strip().isdigit() or len(label) > 18:
            got = f"a track named TRACK.R{_shown(label)}"
            raise RecordingError(where, got=got, expected="TRACK.RNUMBER=[...]")
        number = int(label)
        if number in tracks:
            raise RecordingError(where, got=f"TRACK.R{number} twice", expected="each track once")
        body = body.partition(b"Properties")[0].partition(b"%")[0]
        tracks[number] = _detections(body, f"{where}, TRACK.R{number}")
    if len(tracks) != int(stated[1]) or not tracks:
        expected = f"{int(stated[1])}, as stated in the file's first line, and at least one"
        raise RecordingError(where, got=f"{len(tracks)} tracks", expected=expected)
    return tracks


def _detections(body: bytes, where: str) -> Int[np.ndarray, "n 3"]:
    """The rows of `[[x y t];[x y t];...];`."""
    # Split at brackets: a regular expression could backtrack for very long on a broken file.
    body = body.strip().removesuffix(b";").rstrip()
    if not (body.startswith(b"[") and body.endswith(b"]")) or len(body) < 2:
        raise _no_detections(body[-40:], where)
    *pieces, last = body[1:-1].split(b"]")
    rows = []
    for piece in pieces:
        before, _, numbers = piece.partition(b"[")
        row = numbers.split()
        if before.strip() not in (b"", b";") or len(row) != 3:
            raise _no_detections(piece, where)
        rows.append(row)
    if last.strip() not in (b"", b";") or not rows:
        raise _no_detections(last, where)
    try:
        detections = np.array(rows, dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise RecordingError(
            where, got=str(error)[:100], expected="[column row time] in whole numbers"
        ) from error
    back = np.flatnonzero(np.diff(detections[:, 2]) < 0)
    if len(back):
        before, after = detections[back[0] : back[0] + 2, 2]
        raise RecordingError(
            where, got=f"time {after} after time {before}", expected="times in ascending order"
        )
    return detections


def _no_detections(got: bytes, where: str) -> RecordingError:
    expected = "[[column row time];…], all in brackets"
    return RecordingError(where, got=f"{_shown(got)} among the detections", expected=expected)


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))


def _doubles(tracks: dict[int, Int[np.ndarray, "n 3"]], where: object) -> set[int]:
    """Numbers of the tracks that are duplicates: a longer track has half of their detections.

    Of two tracks of equal length, the one with the smaller number counts as longer.
    """
    detections = {number: {tuple(row) for row in rows.tolist()} for number, rows in tracks.items()}
    owners: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for number, each in detections.items():
        for detection in each:
            owners[detection].append(number)
    most = max(len(of) for of in owners.values())
    if most > MAX_SHARING:  # the loop over pairs below would take too long
        got = f"a detection that {most} tracks share"
        raise RecordingError(where, got=got, expected=f"at most {MAX_SHARING} tracks per detection")
    shared = Counter(pair for of in owners.values() for pair in permutations(of, 2))
    length = {number: (len(each), -number) for number, each in detections.items()}
    return {
        a for (a, b), count in shared.items() if length[a] < length[b] and 2 * count >= length[a][0]
    }
