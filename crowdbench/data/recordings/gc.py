"""Reader of the Grand Central Station annotation: one file per person, and a homography to metres.

A person's file is a list of numbers, three per annotated frame: column and row in the image of
1920 x 1080 pixels, and the frame of the 25 fps video. Every 20th frame was annotated.
"""

import re
from collections.abc import Mapping
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.table import Trajectories, from_rows, interpolated
from crowdbench.errors import RecordingError
from crowdbench.files import read_bytes

FPS = 25.0
STEP = 20
"""Video frames from one annotation to the next."""
VIDEO_FRAMES = 100_000
"""Length of the recording in video frames; the tracks of some persons continue after its end."""
FRAME = 10
"""Video frames per frame of the scene; positions between two annotations are interpolated."""
HOMOGRAPHY = "H.json"
UNIT_M = 0.8
"""Metres per unit of the homography's plane."""
_PERSON = re.compile(r"Annotation/([0-9]{6})\.txt")  # six digits, so that numbers are unique
_Row = tuple[float, float, float]


class _Homography(msgspec.Struct):
    homog: tuple[_Row, _Row, _Row]


def read_gc(
    files: Mapping[str, bytes],
    where: object,
    *,
    name: str = "gc",
    video_frames: int | None = VIDEO_FRAMES,
) -> Trajectories:
    """Read the folder's files by name: `H.json`, and `Annotation/NUMBER.txt` of each person.

    One file is one person. Missing positions between two annotations are interpolated linearly.
    Positions after the recording's 100,000 frames are removed, and people who have any are still
    present at the end; `video_frames` sets another length, and None reads up to the last
    annotation. People with fewer than two annotations within the length are left out.

    Raises:
        RecordingError: a file is missing or broken.
    """
    homography = _homography(files.get(HOMOGRAPHY), where)
    tracks = {
        _person(name, where): _annotations(data, f"{where}/{name}")
        for name, data in files.items()
        if name != HOMOGRAPHY
    }
    if not tracks:
        raise RecordingError(
            where, got="no file of a person", expected="files Annotation/NUMBER.txt"
        )
    if video_frames is None:
        video_frames = max(int(rows[-1, 2]) for rows in tracks.values()) + FRAME
    pieces, single, beyond = [], 0, 0
    for person, rows in tracks.items():
        inside = rows[:, 2] < video_frames
        beyond += int((~inside).sum())
        if inside.sum() < 2:
            single += 1
            continue
        upto = inside.sum() + (not inside.all())  # one more row, to interpolate up to the end
        # Interpolated in pixels, as in the published data; between consecutive annotations that is
        # practically the same as in metres.
        video = np.arange(rows[0, 2], min(rows[upto - 1, 2] + 1, video_frames), FRAME)
        at = interpolated(video, rows[:upto, 2], rows[:upto, :2])
        pieces.append(np.column_stack([np.full(len(video), person), video // FRAME, at]))
    if not pieces:
        got = f"{single} files with a single annotation each"
        raise RecordingError(where, got=got, expected="at least one person with two annotations")
    table = np.concatenate(pieces)
    # The homography expects (row, column): with the opposite order people would walk at 0.6 m/s.
    plane = np.column_stack([table[:, [3, 2]], np.ones(len(table))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):  # values not finite are rejected below
        xy = UNIT_M * plane[:, :2] / plane[:, 2:]
    return from_rows(
        scene=name,
        dt_s=FRAME / FPS,
        grid_s=STEP / FPS,
        frames=video_frames // FRAME,
        person_id=table[:, 0].astype(np.int64),
        frame=table[:, 1].astype(np.int64),
        xy=xy,
        provenance={
            "notes": {
                "files": f"{len(tracks)}, {single} of them left out for having a single annotation",
                "cut off": f"{beyond} positions after video frame {video_frames}",
            }
        },
        where=where,
    )


def files_in(folder: Path, hint: str) -> dict[str, bytes]:
    """The files that `read_gc` reads, by name.

    Raises:
        RecordingError: a file cannot be read.
    """
    names = [HOMOGRAPHY, *(f"Annotation/{p.name}" for p in (folder / "Annotation").glob("*.txt"))]
    return {name: read_bytes(folder / name, RecordingError, hint) for name in sorted(names)}


def _annotations(data: bytes, where: str) -> Int[np.ndarray, "n 3"]:
    """Column, row and video frame of each annotation of a person, in order of time."""
    try:
        numbers = np.array(data.split(), dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise RecordingError(where, got=str(error)[:100], expected="whole numbers") from error
    if len(numbers) == 0 or len(numbers) % 3:
        got = f"{len(numbers)} numbers"
        raise RecordingError(where, got=got, expected="three per annotation: column, row, frame")
    rows = numbers.reshape(-1, 3)
    frame = rows[:, 2]
    wrong = (frame % STEP != 0) | (frame < 0)
    if wrong.any():
        got = f"an annotation of frame {frame[wrong][0]}"
        raise RecordingError(where, got=got, expected=f"annotations of every {STEP}th frame")
    back = np.flatnonzero(np.diff(frame) <= 0)
    if len(back):
        before, after = frame[back[0] : back[0] + 2]
        raise RecordingError(
            where, got=f"frame {after} after frame {before}", expected="frames in ascending order"
        )
    return rows


def _homography(data: bytes | None, where: object) -> Float[np.ndarray, "3 3"]:
    if data is None:
        raise RecordingError(where, got=f"no {HOMOGRAPHY}", expected="the homography")
    try:
        return np.array(msgspec.json.decode(data, type=_Homography).homog)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        got = str(error)[:100]
        expected = '{"homog": 3 x 3 finite numbers}'
        raise RecordingError(f"{where}/{HOMOGRAPHY}", got=got, expected=expected) from error


def _person(name: str, where: object) -> int:
    number = _PERSON.fullmatch(name)
    if number is None:
        expected = "Annotation/NUMBER.txt with a number of six digits"
        raise RecordingError(where, got=f"a file {name}", expected=expected)
    return int(number[1])
