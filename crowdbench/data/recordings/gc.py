"""Reader of the Grand Central Station annotation: one file per person, and a homography to metres.

A person's file is a list of numbers, three per annotated frame: column and row in the image of
1920 x 1080 pixels, and the frame of the 25 fps video. Every 20th frame was annotated.
"""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.table import Trajectories, from_rows
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

_HINT = "Use the folder datasets/GC of github.com/crowdbotp/OpenTraj without changes."


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
    homography = homography_of(files.get(HOMOGRAPHY), where)
    tracks = annotations(files, where)
    if video_frames is None:
        video_frames = max(int(rows[-1, 2]) for rows in tracks.values()) + FRAME
    pieces, persons, single, beyond = [], [], 0, 0
    for person, rows in tracks.items():
        inside = rows[:, 2] < video_frames
        beyond += int((~inside).sum())
        if inside.sum() < 2:
            single += 1
            continue
        upto = inside.sum() + (not inside.all())  # one more row, to interpolate up to the end
        frame, at = _each_frame(rows[:upto], video_frames)
        pieces.append(np.column_stack([frame, at]))
        persons.append(np.full(len(frame), person))
    if not pieces:
        raise RecordingError(
            where,
            got=f"{single} files with a single annotation each",
            expected="at least one person with two annotations",
            hint=_HINT,
        )
    table = np.concatenate(pieces)
    crowd = from_rows(
        scene=name,
        dt_s=FRAME / FPS,
        grid_s=STEP / FPS,
        frames=video_frames // FRAME,
        person_id=np.concatenate(persons),
        frame=table[:, 0].astype(np.int64),
        xy=metres(table[:, 1:], homography),
        where=where,
    )
    notes = {
        "files": f"{len(tracks)}, {single} of them left out for having a single annotation",
        "cut off": f"{beyond} positions after video frame {video_frames}",
    }
    return replace(crowd, provenance={"notes": notes})


def files_in(folder: Path, hint: str = _HINT) -> dict[str, bytes]:
    """The files that `read_gc` reads, by name.

    Raises:
        RecordingError: a file cannot be read.
    """
    names = [HOMOGRAPHY, *(f"Annotation/{p.name}" for p in (folder / "Annotation").glob("*.txt"))]
    return {name: read_bytes(folder / name, RecordingError, hint) for name in sorted(names)}


def annotations(files: Mapping[str, bytes], where: object) -> dict[int, Int[np.ndarray, "n 3"]]:
    """Column, row and video frame of each annotation, by person.

    Raises:
        RecordingError: there is no file of a person, or one is broken.
    """
    tracks = {
        _person(name, where): _rows(data, f"{where}/{name}")
        for name, data in files.items()
        if name != HOMOGRAPHY
    }
    if not tracks:
        raise RecordingError(
            where, got="no file of a person", expected="files Annotation/NUMBER.txt", hint=_HINT
        )
    return tracks


def _rows(data: bytes, where: str) -> Int[np.ndarray, "n 3"]:
    """Column, row and video frame of each annotation of a person, in order of time."""
    try:
        numbers = np.array(data.split(), dtype=np.int64)
    except (ValueError, OverflowError) as error:
        raise RecordingError(
            where, got=str(error)[:100], expected="whole numbers", hint=_HINT
        ) from error
    if len(numbers) == 0 or len(numbers) % 3:
        raise RecordingError(
            where,
            got=f"{len(numbers)} numbers",
            expected="three per annotation: column, row, frame",
            hint=f"The file may be truncated. {_HINT}",
        )
    rows = numbers.reshape(-1, 3)
    if (rows[:, 2] % STEP).any() or (rows[:, 2] < 0).any():
        wrong = rows[(rows[:, 2] % STEP != 0) | (rows[:, 2] < 0), 2]
        raise RecordingError(
            where,
            got=f"an annotation of frame {wrong[0]}",
            expected=f"annotations of every {STEP}th frame",
            hint=_HINT,
        )
    if (np.diff(rows[:, 2]) <= 0).any():
        at = int(np.flatnonzero(np.diff(rows[:, 2]) <= 0)[0])
        raise RecordingError(
            where,
            got=f"frame {rows[at + 1, 2]} after frame {rows[at, 2]}",
            expected="frames in ascending order",
            hint=_HINT,
        )
    return rows


def _each_frame(
    rows: Int[np.ndarray, "n 3"], stop: int
) -> tuple[Int[np.ndarray, " f"], Float[np.ndarray, "f 2"]]:
    """Frames of the scene and pixel positions in them, from the first annotation to `stop`.

    Positions are interpolated in pixels, as in the published data. Between consecutive annotations
    the result is practically the same as in metres. Where a person was lost for minutes, the true
    path is unknown in any case.
    """
    video = np.arange(rows[0, 2], min(rows[-1, 2] + 1, stop), FRAME)
    at = np.stack([np.interp(video, rows[:, 2], rows[:, k]) for k in (0, 1)], axis=1)
    return video // FRAME, at


def metres(
    pixels: Float[np.ndarray, "n 2"], homography: Float[np.ndarray, "3 3"]
) -> Float[np.ndarray, "n 2"]:
    """World positions in metres of pixels (column, row).

    The homography expects (row, column): with the opposite order people would walk at 0.6 m/s.
    """
    plane = np.column_stack([pixels[:, 1], pixels[:, 0], np.ones(len(pixels))]) @ homography.T
    with np.errstate(divide="ignore", invalid="ignore"):  # values not finite are rejected later
        return UNIT_M * plane[:, :2] / plane[:, 2:]


def homography_of(data: bytes | None, where: object) -> Float[np.ndarray, "3 3"]:
    """The matrix in `H.json`.

    Raises:
        RecordingError: the file is missing or broken.
    """
    if data is None:
        raise RecordingError(where, got=f"no {HOMOGRAPHY}", expected="the homography", hint=_HINT)
    try:
        matrix = np.array(json.loads(data)["homog"], dtype=np.float64)
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        got = str(error)[:100]
        raise RecordingError(
            f"{where}/{HOMOGRAPHY}", got=got, expected='{"homog": 3 x 3 numbers}', hint=_HINT
        ) from error
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        raise RecordingError(
            f"{where}/{HOMOGRAPHY}",
            got=f"shape {matrix.shape}",
            expected="3 x 3 finite numbers",
            hint=_HINT,
        )
    return matrix


def _person(name: str, where: object) -> int:
    stem = name.removeprefix("Annotation/").removesuffix(".txt")
    if not (stem.isascii() and stem.isdecimal() and len(stem) == 6):  # so that numbers are unique
        raise RecordingError(
            where,
            got=f"a file {name}",
            expected="Annotation/NUMBER.txt with a number of six digits",
            hint=_HINT,
        )
    return int(stem)
