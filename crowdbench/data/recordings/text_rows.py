"""Plain text with rows `frame person x y`, as in TrajNet and Social GAN; and tables of rows."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.recordings.mending import Stamped
from crowdbench.data.table import integers
from crowdbench.errors import RecordingError

FRAME_PED_XY = "frame-ped-xy"
FEWEST = 100
"""Number of rows from which two columns can be told apart."""
REGULAR = 0.9
"""Share of equal intervals between the rows of persons, at least."""
CLOSER = 3.0
"""Rows of a person are closer to each other by this factor than rows of a frame."""


def parse_frame_ped_xy(data: bytes, where: object) -> tuple[Stamped, None]:
    """The rows of a file, separated by spaces, tabs or commas.

    Raises:
        RecordingError: a row is broken, there are none, or persons and frames are swapped.
    """
    rows = numbers_in(data, 4, "frame person x y", where)
    frame, person = (integers(rows[:, k], what, where) for k, what in enumerate(("frame", "id")))
    at = rows[:, 2:4]
    check_not_swapped(person, frame, at, "`frame person x y`", "--format jupedsim", where)
    return Stamped.of_frames(person, frame, at), None


def numbers_in(
    data: bytes, columns: int, what: str, where: object, hint: str = ""
) -> Float[np.ndarray, "R c"]:
    """The first columns of a text file, without comments after `#`.

    Raises:
        RecordingError: a row has fewer columns or other than numbers, or there is no row.
    """
    lines = data.decode("utf-8-sig", "replace").splitlines()
    body = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    if not body:
        raise RecordingError(where, got="no rows", expected="at least one row", hint=hint)
    delimiter = "," if "," in body[0] else None
    try:
        rows = np.loadtxt(body, ndmin=2, usecols=range(columns), delimiter=delimiter)
    except (ValueError, IndexError) as error:
        expected = f"rows of numbers: {what}"
        raise RecordingError(where, got=str(error), expected=expected, hint=hint) from error
    return np.asarray(rows)


def check_not_swapped(
    person: Int[np.ndarray, " R"],
    frame: Int[np.ndarray, " R"],
    xy: Float[np.ndarray, "R 2"],
    columns: str,
    instead: str,
    where: object,
) -> None:
    """Raise if persons and frames are rather in each other's columns.

    Then rows of a person are at equal intervals and close to each other, but not as they are read.
    `columns` are those that the format has, and `instead` is the option for the other order.
    """
    if len(person) < FEWEST:
        return
    _, way_m = _intervals(person, frame, xy)
    regular, other_m = _intervals(frame, person, xy)
    if regular > REGULAR and other_m * CLOSER < way_m:
        raise RecordingError(
            where,
            got=f"frames and persons in each other's columns: as {columns}, rows of a person are "
            f"{way_m:.3g} apart, in the other order {other_m:.3g}",
            expected=columns,
            hint=f"Use {instead} if the columns are in the other order.",
        )


def _intervals(
    person: Int[np.ndarray, " R"], frame: Int[np.ndarray, " R"], xy: Float[np.ndarray, "R 2"]
) -> tuple[float, float]:
    """Share of the most frequent interval within persons, and the median distance of rows."""
    order = np.lexsort((frame, person))
    same = np.diff(person[order]) == 0
    if not same.any():
        return 0.0, np.inf
    _, counts = np.unique(np.diff(frame[order])[same], return_counts=True)
    way = np.linalg.norm(np.diff(xy[order], axis=0), axis=1)[same]
    return float(counts.max() / same.sum()), float(np.median(way))


def numbered(ids: Sequence[object]) -> Int[np.ndarray, " R"]:
    """Numbers for ids of any kind, in the order in which they first occur."""
    number: dict[object, int] = {}
    return np.array([number.setdefault(each, len(number)) for each in ids], dtype=np.int64)
