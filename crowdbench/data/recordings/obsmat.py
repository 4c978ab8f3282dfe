"""The `obsmat.txt` format of the ETH and UCY recordings.

One row per person and annotated frame: video frame, person, x, z, y, vx, vz, vy, in metres and
m/s with z pointing up (unused).
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from crowdbench.data.recordings.mending import Stamped, on_frames
from crowdbench.data.recordings.timing import with_pauses
from crowdbench.data.table import Trajectories, integers
from crowdbench.errors import RecordingError

_COLUMNS = 8
_STANDING_MPS = 0.2
_OTHER_INTERVAL = (
    "Copies of this recording with another interval exist; their speeds are wrong by the same "
    "factor. Use the file from the address that `crowdbench data list` shows."
)


def read_obsmat(
    data: bytes, *, name: str, fps: float, frame_step: int, where: object
) -> Trajectories:
    """Read the bytes of an `obsmat.txt` annotated every `frame_step` frames of an `fps` video.

    Frames are rounded down to the recording's grid. The phase of the annotation shifts at some
    pauses, so rounding to the nearest frame would put a person twice into one frame.

    Raises:
        RecordingError: the data are empty, truncated, not finite, or not annotated every
            `frame_step` frames.
    """
    rows, _ = parse_obsmat(data, where)
    if len(np.unique(rows.person)) < len(rows.person) and rows.step != frame_step:
        got = f"positions every {rows.step:.0f} frames"
        expected = f"positions every {frame_step} frames ({frame_step / fps:g} s at {fps:g} fps)"
        raise RecordingError(where, got=got, expected=expected, hint=_OTHER_INTERVAL)
    rows = replace(rows, step=float(frame_step))
    whole = on_frames(rows, gaps=None, dt_s=frame_step / fps, where=where, hint=_OTHER_INTERVAL)
    return with_pauses(whole.crowd(scene=name, dt_s=frame_step / fps, where=where))


def parse_obsmat(data: bytes, where: object) -> tuple[Stamped, Float[np.ndarray, "R 2"]]:
    """The rows of a file, and their velocities.

    Raises:
        RecordingError: the data are empty or broken.
    """
    lines = [line for line in data.decode("utf-8", "replace").split("\n") if line.strip()]
    if not lines:
        raise RecordingError(where, got="an empty file", expected="rows of numbers")
    for number, line in enumerate(lines, start=1):
        if len(line.split()) != _COLUMNS:
            got = f"{len(line.split())} columns in row {number}"
            expected = f"{_COLUMNS} (frame, person, x, z, y, vx, vz, vy)"
            raise RecordingError(where, got=got, expected=expected)
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None)
    except ValueError as error:
        raise RecordingError(where, got=str(error), expected="numbers in each row") from error
    frame, person = (
        integers(table[:, k], what, where) for k, what in enumerate(("frame", "person"))
    )
    rows = Stamped.of_frames(person, frame, table[:, [2, 4]], origin=float(frame.min()))
    return rows, table[:, [5, 7]]


def step_by_speed_s(rows: Stamped, velocity: Float[np.ndarray, "R 2"]) -> float | None:
    """Seconds from row to row: the median of distance over speed; None if nobody has a speed."""
    order = np.lexsort((rows.values, rows.person))
    person, frame = rows.person[order], rows.values[order]
    follows = (np.diff(person) == 0) & (np.diff(frame) == rows.step)
    way = np.linalg.norm(np.diff(rows.xy[order], axis=0), axis=1)[follows]
    speed = np.linalg.norm(velocity[order][1:], axis=1)[follows]
    walks = speed > _STANDING_MPS
    return float(np.median(way[walks] / speed[walks])) if walks.any() else None
