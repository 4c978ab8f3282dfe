"""A day of the Edinburgh Informatics Forum: tracks in the pixels of a camera on the ceiling.

The file is Matlab code. Of each track it has `Properties.Rn= [...]`, which is not read, and
`TRACK.Rn=[[x y t];[x y t];...];` with t in frames of about 9 fps.
"""

import re
from collections import defaultdict
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from crowdbench.errors import RecordingError
from crowdbench.trajectories.table import Trajectories, from_rows

FPS = 9.0
FRAME = 4
"""Frames of the camera in one of the scene. Tracks jitter: in most of them someone steps faster
than 3 m/s from one frame of the camera to the next, over four that is rare."""
PIXEL_M = 0.0247
IMAGE_ROWS = 480

MAX_ROWS = 10_000_000
"""Persons times frames; a busy day has 100,000."""
MAX_SHARING = 100
"""Tracks that share a detection; on 1 July 2010 four at most."""

_STATED = re.compile(rb"Total number of trajectories in file are\s+(\d{1,9})\b")
_HINT = "Fetch the file anew with `crowdbench data fetch`; if it is there already, delete it first."


def read_forum(data: bytes, *, name: str, where: object) -> Trajectories:
    """Read the bytes of a day's `tracks` file.

    Positions are the tracks' in every fourth frame of the camera (4/9 s), interpolated where the
    camera missed one; arrivals stay on the camera's frames. Observation begins with the camera's
    frame 0 and ends with the last detection. Of two tracks that share half of the shorter one's
    detections (the same pixel at the same time) the shorter is left out: both follow one person.
    Where a track has several detections at one time, their mean is taken.

    Raises:
        RecordingError: the file is empty, broken off, or holds no tracks.
    """
    tracks = _tracks(data, where)
    doubles = _doubles(tracks, where)
    spans = sum((int(rows[-1, 2]) - int(rows[0, 2])) // FRAME + 1 for rows in tracks.values())
    if spans > MAX_ROWS:
        raise RecordingError(
            where,
            got=f"{spans} persons times frames",
            expected=f"{MAX_ROWS} at most",
            hint=f"A time may be wrong. {_HINT}",
        )
    persons, frames, positions, entered_s = [], [], [], []
    fast = short = 0
    for number, rows in tracks.items():
        tick, at = _at_each_time(rows)
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(tick) * FPS
        fast += bool((speed > 3.0).any())
        frame = np.arange(-(-tick[0] // FRAME), tick[-1] // FRAME + 1)
        if number in doubles:
            continue
        if len(frame) == 0:
            short += 1
            continue
        persons.append(np.full(len(frame), number))
        frames.append(frame)
        positions.append(
            np.stack([np.interp(frame * FRAME, tick, at[:, k]) for k in (0, 1)], axis=1)
        )
        entered_s.append(np.full(len(frame), tick[0] / FPS))
    if not persons:
        raise RecordingError(
            where,
            got=f"{len(tracks)} tracks, all of them between two frames of {FRAME}/9 s",
            expected="at least one that is there in a frame",
            hint=_HINT,
        )
    crowd = from_rows(
        scene=name,
        dt_s=FRAME / FPS,
        grid_s=1 / FPS,
        person_id=np.concatenate(persons),
        frame=np.concatenate(frames),
        xy=np.concatenate(positions),
        persons={"spawn_s": np.concatenate(entered_s)},
        where=where,
    )
    notes = {
        "tracks": f"{len(tracks)}; left out: {len(doubles)} that double another, {short} that fall "
        "between two frames",
        "jitter": f"{fast} tracks with a step above 3 m/s within 1/9 s",
    }
    return replace(crowd, provenance={"notes": notes})


def _tracks(data: bytes, where: object) -> dict[int, Int[np.ndarray, "n 3"]]:
    """Column, row and time of the detections of each track, by its number."""
    stated = _STATED.search(data)
    if stated is None:
        raise RecordingError(
            where,
            got="no line with the number of trajectories",
            expected="a tracks file of the Edinburgh Informatics Forum",
            hint=_HINT,
        )
    tracks: dict[int, Int[np.ndarray, "n 3"]] = {}
    for piece in data.split(b"TRACK.R")[1:]:
        label, _, body = piece.partition(b"=")
        number = _number(label, where)
        if number in tracks:
            raise RecordingError(
                where, got=f"TRACK.R{number} twice", expected="each track once", hint=_HINT
            )
        body = body.partition(b"Properties")[0].partition(b"%")[0]
        tracks[number] = _detections(body, f"{where}, TRACK.R{number}")
    if len(tracks) != int(stated[1]) or not tracks:
        raise RecordingError(
            where,
            got=f"{len(tracks)} tracks",
            expected=f"{int(stated[1])}, as the file's first line says, and at least one",
            hint=f"The file may be broken off. {_HINT}",
        )
    return tracks


def _number(label: bytes, where: object) -> int:
    if not label.strip().isdigit() or len(label) > 18:
        raise RecordingError(
            where,
            got=f"a track named TRACK.R{_shown(label)}",
            expected="TRACK.RNUMBER=[...]",
            hint=_HINT,
        )
    return int(label)


def _detections(body: bytes, where: str) -> Int[np.ndarray, "n 3"]:
    """The rows of `[[x y t];[x y t];...];`.

    Split at brackets: a regular expression would try a broken file again and again.
    """
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
            where, got=str(error)[:100], expected="[column row time] in whole numbers", hint=_HINT
        ) from error
    back = np.flatnonzero(np.diff(detections[:, 2]) < 0)
    if len(back):
        before, after = detections[back[0] : back[0] + 2, 2]
        raise RecordingError(
            where, got=f"time {after} after time {before}", expected="ascending times", hint=_HINT
        )
    return detections


def _no_detections(got: bytes, where: str) -> RecordingError:
    return RecordingError(
        where,
        got=f"{_shown(got)} among the detections",
        expected="[column row time] of each, the whole in brackets",
        hint=f"The file may be broken off. {_HINT}",
    )


def _shown(text: bytes) -> str:
    return repr(text[:40].decode("ascii", "replace"))


def _at_each_time(
    rows: Int[np.ndarray, "n 3"],
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 2"]]:
    """Times, each once, and the mean position in metres of what was detected then."""
    tick, of_row, count = np.unique(rows[:, 2], return_inverse=True, return_counts=True)
    x = np.bincount(of_row, rows[:, 0]) / count
    y = np.bincount(of_row, rows[:, 1]) / count
    return tick, PIXEL_M * np.stack([x, IMAGE_ROWS - y], axis=1)


def _doubles(tracks: dict[int, Int[np.ndarray, "n 3"]], where: object) -> set[int]:
    """Tracks half of whose detections a longer one (of equal ones: an earlier) has too."""
    detections = {number: {tuple(row) for row in rows.tolist()} for number, rows in tracks.items()}
    owners: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for number, each in detections.items():
        for detection in each:
            owners[detection].append(number)
    most = max(len(of) for of in owners.values())
    if most > MAX_SHARING:  # the pairs below would be too many
        raise RecordingError(
            where,
            got=f"a detection that {most} tracks share",
            expected=f"at most {MAX_SHARING}",
            hint=_HINT,
        )
    shared: dict[tuple[int, int], int] = defaultdict(int)
    for of in owners.values():
        for a in of:
            for b in of:
                if (-len(detections[a]), a) > (-len(detections[b]), b):
                    shared[a, b] += 1
    return {a for (a, _), count in shared.items() if count >= len(detections[a]) / 2}
