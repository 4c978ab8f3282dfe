"""The formats of JuPedSim and PedPy: text files, and SQLite files of simulations.

A text file states `# framerate: 16.00`, optionally a unit (`x/cm`, by default metres), and has a
row `id frame x y z` per person and frame. An SQLite file has the tables `trajectory_data(frame,
id, pos_x, pos_y, …)` and `metadata(key, value)`, with the key `fps`.
"""

import re
import sqlite3
from pathlib import Path

import numpy as np
from jaxtyping import Float, Shaped

from crowdbench.data.recordings.mending import Stamped
from crowdbench.data.recordings.text_rows import check_not_swapped
from crowdbench.data.recordings.timing import plain_positions
from crowdbench.data.table import Trajectories, integers
from crowdbench.errors import RecordingError
from crowdbench.files import write_text

_SQLITE = b"SQLite format 3\0"
_RATE = re.compile(r"framerate\D*(\d+(?:[.,]\d+)?)")
_HINT = "PedPy's loaders may describe the problem in more detail."


def parse_jupedsim(data: bytes, where: object) -> tuple[Stamped, float | None]:
    """The rows of a text or SQLite file, and seconds from one row of a person to the next.

    The time is None if a text file states no rate. Frame numbers may be the camera's, with fewer
    rows.

    Raises:
        RecordingError: the file is broken or empty.
    """
    rate, rows = (_sqlite if data.startswith(_SQLITE) else _text)(data, where)
    if rate is not None and not 0 < rate < np.inf:
        raise RecordingError(where, got=f"{rate:g} frames per second", expected="a positive rate")
    if not len(rows):
        raise RecordingError(where, got="no rows", expected="at least one row", hint=_HINT)
    person, frame = (integers(rows[:, k], what, where) for k, what in enumerate(("id", "frame")))
    xy = rows[:, 2:4]
    check_not_swapped(person, frame, xy, "`id frame x y z`", "--format frame-ped-xy", where)
    stamped = Stamped.of_frames(person, frame, xy)
    return stamped, None if rate is None else stamped.step / rate


def write_jupedsim(crowd: Trajectories, path: Path) -> None:
    """Write the crowd as a text file with unchanged frame numbers.

    Raises:
        OutputError: `path` cannot be written.
    """
    ids = crowd.person_id[crowd.row_person()]
    rows = zip(ids.tolist(), crowd.row_frame().tolist(), plain_positions(crowd), strict=True)
    lines = [
        f"# framerate: {round(1 / crowd.dt_s, 9)}",
        "# id frame x/m y/m z/m",
        *(f"{p}\t{f}\t{x!r}\t{y!r}\t0.0" for p, f, (x, y) in rows),
        "",
    ]
    write_text(path, "\n".join(lines))


def _text(data: bytes, where: object) -> tuple[float | None, Float[np.ndarray, "R 4"]]:
    """Frames per second, if stated, and the columns id, frame, x and y in metres."""
    lines = data.decode("utf-8-sig", "replace").splitlines()
    header = " ".join(line for line in lines if line.lstrip().startswith("#")).lower()
    body = [line for line in lines if line.strip() and not line.lstrip().startswith("#")]
    stated = _RATE.search(header)
    try:
        rows = np.loadtxt(body, ndmin=2, usecols=(0, 1, 2, 3)) if body else np.empty((0, 4))
    except (ValueError, IndexError) as error:
        raise RecordingError(
            where, got=str(error), expected="rows of numbers: id frame x y z", hint=_HINT
        ) from error
    if "x/cm" in header or "in cm" in header:
        rows[:, 2:] /= 100
    return float(stated[1].replace(",", ".")) if stated else None, rows


def _sqlite(data: bytes, where: object) -> tuple[float, Shaped[np.ndarray, "R 4"]]:
    connection = sqlite3.connect(":memory:")
    try:
        connection.deserialize(data)
        (rate,) = connection.execute("SELECT value FROM metadata WHERE key = 'fps'").fetchone()
        rows = connection.execute("SELECT id, frame, pos_x, pos_y FROM trajectory_data").fetchall()
        return float(rate), np.array(rows, dtype=np.float64).reshape(-1, 4)
    except (sqlite3.Error, TypeError, ValueError) as error:
        expected = "JuPedSim's tables trajectory_data and metadata, the latter with the key fps"
        raise RecordingError(where, got=str(error), expected=expected, hint=_HINT) from error
    finally:
        connection.close()
