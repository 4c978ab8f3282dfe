"""From the coordinates and times of a file to metres and the frames of a scene."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.data.recordings.mending import LONGEST_GAP_S, Rows, Stamped
from crowdbench.data.table import MAX_FRAMES, interpolated
from crowdbench.errors import RecordingError, SettingError
from crowdbench.files import read_bytes

_MATRIX = "a text file with three rows of three numbers"


def check_placing(scale: float | None, homography: Path | None) -> None:
    """Check the options that convert positions to metres.

    Raises:
        SettingError: both are given, or the scale is not a positive number.
    """
    if scale is not None and homography is not None:
        expected = "one of --scale and --homography"
        raise SettingError("--homography", got="--scale as well", expected=expected)
    if scale is not None and not (np.isfinite(scale) and scale > 0):
        raise SettingError("--scale", got=f"{scale}", expected="a positive number of metres")


def placed(rows: Stamped, scale: float | None, homography: Path | None) -> Stamped:
    """The rows in metres: positions times `scale`, or mapped by the matrix in a file.

    The matrix maps (x, y, 1), in homogeneous coordinates.

    Raises:
        RecordingError: the matrix cannot be read or inverted, or maps positions to infinity.
    """
    if scale is not None:
        return replace(rows, xy=rows.xy * scale)
    if homography is None:
        return rows
    matrix = matrix_of(homography)
    mapped = np.column_stack([rows.xy, np.ones(len(rows.xy))]) @ matrix.T
    with np.errstate(divide="ignore", invalid="ignore"):
        xy = mapped[:, :2] / mapped[:, 2:]
    if not np.isfinite(xy).all():
        row = int((~np.isfinite(xy).all(axis=1)).argmax())
        got = f"a matrix that maps {rows.named(row)} to infinity"
        raise RecordingError(homography, got=got, expected="finite positions in metres")
    return replace(rows, xy=xy)


def matrix_of(path: Path) -> Float[np.ndarray, "3 3"]:
    """The homography in a text file.

    Raises:
        RecordingError: it cannot be read, or has no inverse.
    """
    text = read_bytes(path, RecordingError, "").decode("utf-8-sig", "replace")
    try:
        matrix = np.loadtxt(text.replace(",", " ").splitlines(), ndmin=2)
    except ValueError as error:
        raise RecordingError(path, got=str(error), expected=_MATRIX) from error
    if matrix.shape != (3, 3) or not np.isfinite(matrix).all():
        got = f"numbers of shape {matrix.shape}"
        raise RecordingError(path, got=got, expected=_MATRIX)
    if abs(np.linalg.det(matrix)) < 1e-12 * np.abs(matrix).max() ** 3:
        got = "a matrix that maps an area to a line"
        raise RecordingError(path, got=got, expected="a matrix that can be inverted")
    return np.asarray(matrix)


def resampled(
    rows: Stamped, dt_s: float, where: object, *, longest_gap_s: float = LONGEST_GAP_S
) -> Rows:
    """Positions at frames of `dt_s` from the first row on, interpolated linearly in time.

    `rows` are stamped with seconds, at any intervals. A person without a row for longer than
    `longest_gap_s` ends there and continues as another one. Persons between two frames, who have
    no position at a frame, are left out.

    Raises:
        RecordingError: a person has two rows at the same time, a time is not finite, nobody is
            there at any frame, or the recording is too long.
    """
    time_s = rows.values.astype(np.float64)
    if not np.isfinite(time_s).all():
        row = int((~np.isfinite(time_s)).argmax())
        raise RecordingError(where, got=rows.named(row), expected="finite times")
    order = np.lexsort((time_s, rows.person))
    person, time_s, xy = rows.person[order], time_s[order], rows.xy[order]
    same = np.diff(person) == 0
    if (twice := same & (np.diff(time_s) <= 0)).any():
        k = int(twice.argmax()) + 1
        got = f"person {person[k]} twice at {time_s[k]!r} s ({twice.sum()} such rows)"
        raise RecordingError(where, got=got, expected="one row per person and time")
    origin = np.round(time_s.min(), 6)
    ticks = (time_s - origin) / dt_s
    if ticks.max() > MAX_FRAMES:
        got = f"times from {time_s.min():.10g} to {time_s.max():.10g} s"
        raise RecordingError(where, got=got, expected=f"at most {MAX_FRAMES} frames of {dt_s:g} s")
    nearest = np.round(ticks)  # times are often written with few digits
    ticks = np.where(np.abs(ticks - nearest) < 1e-3 / dt_s, nearest, ticks)
    ends = np.flatnonzero(~same | (np.diff(time_s) > longest_gap_s))
    reach = float(np.median(np.diff(ticks)[same])) if same.any() else 0.0
    reach = reach if reach < 0.5 else 0.0  # as far as that from its ends, a person is there
    pieces, continued, free, out = [], dict[int, int](), int(person.max()) + 1, 0
    before, number = -1, -1
    for part in np.split(np.arange(len(person)), ends + 1):
        if person[part[0]] == before:
            continued[number] = free
            number, free = free, free + 1
        else:
            before = number = int(person[part[0]])
        first, last = ticks[part[0]] - reach, ticks[part[-1]] + reach
        frame = np.arange(max(0.0, np.ceil(first)), np.floor(last) + 1)
        out += len(frame) == 0
        at = interpolated(frame, ticks[part], xy[part])
        source = np.full(len(frame), order[part[0]])
        pieces.append((np.full(len(frame), number), frame.astype(np.int64), at, source))
    person_id, frames, at, source = (np.concatenate(each) for each in zip(*pieces, strict=True))
    if not len(frames):
        raise RecordingError(where, got=f"nobody at any frame of {dt_s:g} s", expected="people")
    apart = float(np.median(np.diff(time_s)[same])) if same.any() else dt_s
    words = [f"from rows about every {apart:.3g} s to every {dt_s:g} s"]
    words += [f"{len(continued)} persons split at gaps above {longest_gap_s:g} s"] * any(continued)
    words += [f"{out} persons between two frames left out"] * (out > 0)
    return Rows(person_id, frames, at, source, continued, {"resampled": "; ".join(words)})
