"""The `obsmat.txt` format of the ETH and UCY recordings.

One row per person and annotated frame: video frame, person, x, z, y, vx, vz, vy, in metres and
m/s with z pointing up (unused).
"""

import io
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.recordings.gaps import observed_intervals
from crowdbench.data.recordings.mending import Gaps, Stamps, on_frames
from crowdbench.data.recordings.timing import usual_step
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError

_COLUMNS = 8
_STANDING_MPS = 0.2
_HINT = "Use the file from the address that `crowdbench data list` shows."
_OTHER_INTERVAL = (
    "Copies of this recording with another interval exist; their speeds are wrong by the same "
    f"factor. {_HINT}"
)


def read_obsmat(
    data: bytes,
    *,
    name: str,
    fps: float,
    frame_step: int,
    where: object,
    gaps: Gaps | None = None,
    hint: str = _OTHER_INTERVAL,
) -> Trajectories:
    """Read the bytes of an `obsmat.txt` annotated every `frame_step` frames of an `fps` video.

    Frames are rounded down to the recording's grid. The phase of the annotation shifts at some
    pauses, so rounding to the nearest frame would put a person twice into one frame. `gaps` says
    how steps of another length are repaired (see `mending`); if it is None they are rejected, with
    `hint` in the message.

    Raises:
        RecordingError: the data are empty, truncated, not finite, or not annotated every
            `frame_step` frames.
    """
    table = _parse(data, where)
    video_frame = _whole(table[:, 0], "frame", where)
    person = _whole(table[:, 1], "person", where)
    _check_interval(person, video_frame, frame_step, fps, where)
    stamps = Stamps(video_frame, "frame", step=float(frame_step), origin=float(video_frame.min()))
    rows = on_frames(person, stamps, table[:, [2, 4]], gaps=gaps, where=where, hint=hint)
    crowd = rows.crowd(scene=name, dt_s=frame_step / fps, where=where)
    known = crowd.observed_in(observed_intervals(crowd))
    return replace(known, entered=known.entered & crowd.entered, left=known.left & crowd.left)


def step_of(data: bytes, where: object) -> tuple[int, float | None]:
    """The interval between rows of a person, in frames of the video and in seconds.

    The interval in seconds is the median of distance over speed, from the velocities in the file;
    None if the file has no velocities.

    Raises:
        RecordingError: the data are broken.
    """
    table = _parse(data, where)
    person = _whole(table[:, 1], "person", where)
    frame = _whole(table[:, 0], "frame", where)
    order = np.lexsort((frame, person))
    step = usual_step(person, frame)
    follows = (np.diff(person[order]) == 0) & (np.diff(frame[order]) == step)
    way = np.linalg.norm(np.diff(table[order][:, [2, 4]], axis=0), axis=1)[follows]
    speed = np.linalg.norm(table[order][1:, [5, 7]], axis=1)[follows]
    walks = speed > _STANDING_MPS
    return step, float(np.median(way[walks] / speed[walks])) if walks.any() else None


def _parse(data: bytes, where: object) -> Float[np.ndarray, "R 8"]:
    lines = [line for line in io.StringIO(data.decode("utf-8", "replace")) if line.strip()]
    if not lines:
        raise RecordingError(where, got="an empty file", expected="rows of numbers", hint=_HINT)
    for number, line in enumerate(lines, start=1):
        if len(line.split()) != _COLUMNS:
            raise RecordingError(
                where,
                got=f"{len(line.split())} columns in row {number}",
                expected=f"{_COLUMNS} (frame, person, x, z, y, vx, vz, vy)",
                hint=f"The file may be truncated or in another format. {_HINT}",
            )
    try:
        table = np.loadtxt(lines, ndmin=2, comments=None)
    except ValueError as error:
        raise RecordingError(
            where, got=str(error), expected="numbers in each row", hint=_HINT
        ) from error
    return table


def _whole(values: Float[np.ndarray, " R"], column: str, where: object) -> Int[np.ndarray, " R"]:
    whole = (np.abs(values) < 2.0**53) & (values == np.floor(values))  # false for NaN
    if not whole.all():
        row = int(np.flatnonzero(~whole)[0])
        raise RecordingError(
            where, got=f"{column} {values[row]} in row {row + 1}", expected="a whole number",
            hint=_HINT,
        )  # fmt: skip
    return values.astype(np.int64)


def _check_interval(
    person: Int[np.ndarray, " R"],
    video_frame: Int[np.ndarray, " R"],
    frame_step: int,
    fps: float,
    where: object,
) -> None:
    """Raise if the usual interval between rows of the same person is not `frame_step`."""
    usual = usual_step(person, video_frame)
    followed = len(np.unique(person)) < len(person)
    if followed and usual != frame_step:
        raise RecordingError(
            where,
            got=f"positions every {usual} frames",
            expected=f"positions every {frame_step} frames ({frame_step / fps:g} s at {fps:g} fps)",
            hint=_OTHER_INTERVAL,
        )
