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
from crowdbench.trajectories import Trajectories, from_rows

FPS = 9.0
FRAME = 4
"""Frames of the camera in one of the scene. Tracks jitter: in most of them someone steps faster
than 3 m/s from one frame of the camera to the next, over four that is rare."""
PIXEL_M = 0.0247
IMAGE_ROWS = 480

_TRACK = re.compile(rb"TRACK\.R(\d+)\s*=\s*\[(.*?)\]\s*;?\s*(?=Properties|TRACK|%|\Z)", re.DOTALL)
_POINT = re.compile(rb"\[\s*(\S+)\s+(\S+)\s+(\S+?)\s*\]")
_MEND = "Take the file from the address that `crowdbench data list` names."


def read_forum(data: bytes, *, name: str, where: object) -> Trajectories:
    """Read the bytes of a day's `tracks` file.

    Positions are the tracks' in every fourth frame of the camera (4/9 s), interpolated where the
    camera missed one; arrivals stay on the camera's frames. Observation begins with the camera's
    frame 0 and ends with the last detection. Of two tracks that share half of the shorter one's
    detections (the same pixel at the same time) the shorter is left out: both follow one person.

    Raises:
        RecordingError: the file is empty, broken off, or holds no tracks.
    """
    tracks = _tracks(data, where)
    doubles = _doubles(tracks)
    persons, frames, positions, entered_s = [], [], [], []
    fast = 0
    for number, rows in tracks.items():
        tick, at = _at_each_time(rows)
        speed = np.linalg.norm(np.diff(at, axis=0), axis=1) / np.diff(tick) * FPS
        fast += bool((speed > 3.0).any())
        frame = np.arange(-(-tick[0] // FRAME), tick[-1] // FRAME + 1)
        if number in doubles or len(frame) == 0:
            continue
        persons.append(np.full(len(frame), number))
        frames.append(frame)
        positions.append(
            np.stack([np.interp(frame * FRAME, tick, at[:, k]) for k in (0, 1)], axis=1)
        )
        entered_s.append(np.full(len(frame), tick[0] / FPS))
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
        "tracks": f"{len(tracks)}, {len(doubles)} of them double another and are left out",
        "jitter": f"{fast} tracks with a step above 3 m/s within 1/9 s",
    }
    return replace(crowd, provenance={"notes": notes})


def _tracks(data: bytes, where: object) -> dict[int, Int[np.ndarray, "n 3"]]:
    """Column, row and time of the detections of each track, by its number."""
    stated = re.search(rb"Total number of trajectories in file are\s+(\d+)", data)
    if stated is None:
        raise RecordingError(
            where,
            got="no line with the number of trajectories",
            expected="a tracks file of the Edinburgh Informatics Forum",
            mend=_MEND,
        )
    tracks: dict[int, Int[np.ndarray, "n 3"]] = {}
    for number, body in _TRACK.findall(data):
        points = _POINT.findall(body + b"]")
        try:
            rows = np.array(points, dtype=np.int64).reshape(-1, 3)
        except (ValueError, OverflowError) as error:
            raise RecordingError(
                f"{where}, TRACK.R{int(number)}",
                got=str(error),
                expected="[column row time] in whole numbers",
                mend=_MEND,
            ) from error
        if len(rows) == 0 or len(rows) != body.count(b"[") or (np.diff(rows[:, 2]) < 0).any():
            raise RecordingError(
                f"{where}, TRACK.R{int(number)}",
                got=f"{len(rows)} detections among {body.count(b'[')} brackets",
                expected="detections [column row time], ascending in time",
                mend=_MEND,
            )
        if int(number) in tracks:
            raise RecordingError(
                where, got=f"TRACK.R{int(number)} twice", expected="each track once", mend=_MEND
            )
        tracks[int(number)] = rows
    if len(tracks) != int(stated[1]) or not tracks:
        raise RecordingError(
            where,
            got=f"{len(tracks)} tracks",
            expected=f"{int(stated[1])}, as the file's first line says, and at least one",
            mend=f"The file may be broken off. {_MEND}",
        )
    return tracks


def _at_each_time(
    rows: Int[np.ndarray, "n 3"],
) -> tuple[Int[np.ndarray, " t"], Float[np.ndarray, "t 2"]]:
    """Times, each once, and the mean position in metres of what was detected then."""
    tick, of_row, count = np.unique(rows[:, 2], return_inverse=True, return_counts=True)
    x = np.bincount(of_row, rows[:, 0]) / count
    y = np.bincount(of_row, rows[:, 1]) / count
    return tick, PIXEL_M * np.stack([x, IMAGE_ROWS - y], axis=1)


def _doubles(tracks: dict[int, Int[np.ndarray, "n 3"]]) -> set[int]:
    """Tracks half of whose detections a longer one (of equal ones: an earlier) has too."""
    detections = {number: {tuple(row) for row in rows.tolist()} for number, rows in tracks.items()}
    owners: dict[tuple[int, ...], list[int]] = defaultdict(list)
    for number, each in detections.items():
        for detection in each:
            owners[detection].append(number)
    shared: dict[tuple[int, int], int] = defaultdict(int)
    for of in owners.values():
        for a in of:
            for b in of:
                if (-len(detections[a]), a) > (-len(detections[b]), b):
                    shared[a, b] += 1
    return {a for (a, _), count in shared.items() if count >= len(detections[a]) / 2}
