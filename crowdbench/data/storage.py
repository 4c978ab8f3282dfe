"""Reading and writing `Trajectories` as Parquet and CSV files.

A file holds one flat table with a row per person and frame. The columns of a person are repeated
in each row, so that any tool can read the file without a join; Parquet compresses the repetition.
"""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from jaxtyping import Float

from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS, Trajectories, from_rows
from crowdbench.errors import RecordingError
from crowdbench.files import read_bytes, replacing

if TYPE_CHECKING:
    import pyarrow

SCHEMA = 1
_KEY = b"crowdbench"
_COLUMNS = ("person_id", "frame", "time_s", "x", "y", *PERSON_COLUMNS)
_HINT = (
    "Use a file written by crowdbench, or a table with the columns person_id, frame (or time_s), "
    "x, y."
)


class Metadata(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a file states about its table, besides the columns."""

    schema: int
    scene: str
    dt_s: float
    grid_s: float
    frames: int
    observed: list[tuple[int, int]]
    provenance: dict[str, Any]


def write_parquet(trajectories: Trajectories, path: str | Path) -> None:
    """Write the table to `path` atomically; equal tables give equal bytes.

    Raises:
        OutputError: `path` cannot be written.
    """
    from pyarrow import parquet

    t = trajectories
    metadata = Metadata(
        schema=SCHEMA,
        scene=t.scene,
        dt_s=t.dt_s,
        grid_s=t.grid_s,
        frames=t.frames,
        observed=[(int(a), int(b)) for a, b in t.observed],
        provenance=dict(t.provenance),
    )
    table = _flat(t).replace_schema_metadata(
        {_KEY: msgspec.json.encode(metadata, order="deterministic")}
    )
    with replacing(Path(path)) as temporary:
        parquet.write_table(table, temporary, compression="zstd")


def write_csv(trajectories: Trajectories, path: str | Path) -> None:
    """Write the table to `path` for other programs; the file does not state its time step.

    Raises:
        OutputError: `path` cannot be written.
    """
    from pyarrow import csv

    t = trajectories
    t = replace(t, spawn_s=rounded_s(t.spawn_s), requested_s=rounded_s(t.requested_s))
    with replacing(Path(path)) as temporary:
        csv.write_csv(_flat(t), temporary)


def rounded_s(times_s: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Times in seconds for other programs, without rounding errors such as 4.800000000000001.

    1e-9 s is far below the tolerance within which times are assigned to frames, 1e-6 frames.
    """
    rounded: np.ndarray = np.round(times_s, 9)
    return rounded


def _flat(t: Trajectories) -> "pyarrow.Table":
    import pyarrow as pa

    per_row = np.diff(t.offsets)
    columns: dict[str, np.ndarray] = {
        "person_id": np.repeat(t.person_id, per_row).astype(np.int64),
        "frame": t.row_frame().astype(np.int32),
        "x": t.xy[:, 0],
        "y": t.xy[:, 1],
    }
    for name in PERSON_COLUMNS:
        columns[name] = np.repeat(getattr(t, name), per_row)
    return pa.table(columns)


def read(path: str | Path, *, scene: str, dt_s: float, frames: int | None = None) -> Trajectories:
    """Read a Parquet or CSV table of trajectories from crowdbench or another simulator.

    Required columns are `person_id`, `x`, `y` (metres) and `frame` or `time_s` (seconds, on the
    frames of the scene); columns of `PERSON_COLUMNS` are optional. A file that crowdbench wrote
    states its scene, `dt_s` and length; scene and `dt_s` must equal the arguments. For other files
    `frames` is the length, by default up to the last row.

    Raises:
        RecordingError: the file is missing, is not a table, lacks a column, holds values that
            are not finite, or belongs to another scene or time step.
    """
    path = Path(path)
    return of_table(read_table(path), path, scene=scene, dt_s=dt_s, frames=frames)


def of_table(
    table: "pyarrow.Table", path: Path, *, scene: str, dt_s: float, frames: int | None = None
) -> Trajectories:
    """Convert a table that was read from `path` to `Trajectories`; see `read`."""
    metadata = own_metadata(table, path)
    if metadata is not None:
        for name, got, expected in (
            ("scene", metadata.scene, scene),
            ("time step", metadata.dt_s, dt_s),
        ):
            if got != expected:
                raise RecordingError(
                    path, got=f"{name} {got}", expected=f"{name} {expected}", hint=_HINT
                )
    columns = columns_of(table, path)
    return from_rows(
        scene=scene,
        dt_s=dt_s,
        grid_s=metadata.grid_s if metadata else None,
        frames=metadata.frames if metadata else frames,
        observed=np.array(metadata.observed) if metadata else None,
        person_id=columns["person_id"],
        frame=_frames(path, columns, dt_s),
        xy=np.stack([columns["x"], columns["y"]], axis=1).astype(np.float64),
        persons=columns,
        provenance=metadata.provenance if metadata else {"file": path.name},
        where=path,
    )


def columns_of(table: "pyarrow.Table", path: Path) -> dict[str, np.ndarray]:
    """The columns of a table that `read` understands, by name, with one value per row.

    `person_id` and `frame` are integers.

    Raises:
        RecordingError: the table lacks a column, or holds values that are not numbers.
    """
    named = table.column_names
    for name in ("person_id", "x", "y"):
        if name not in named:
            raise _missing(path, name, table)
    if "frame" not in named and "time_s" not in named:
        raise _missing(path, "frame (or time_s)", table)
    if ("goal_x" in named) != ("goal_y" in named):
        raise _missing(path, "goal_y" if "goal_x" in named else "goal_x", table)
    if len(table) == 0:
        raise RecordingError(path, got="no rows", expected="at least one row", hint=_HINT)
    columns = {name: _numbers(path, table, name) for name in _COLUMNS if name in named}
    for name in {"person_id", "frame"} & set(columns):
        columns[name] = _integers(path, name, columns[name])
    outcome = columns.get("outcome", np.zeros(1))
    if not ((outcome >= 0) & (outcome < len(OUTCOMES))).all():
        raise RecordingError(
            path,
            got=f"outcomes {np.unique(outcome)[:5]}",
            expected=f"outcomes from 0 to {len(OUTCOMES) - 1}",
        )
    return columns


def _frames(path: Path, columns: dict[str, np.ndarray], dt_s: float) -> np.ndarray:
    """The frame of each row from `frame` or `time_s`; if both columns exist, they must agree."""
    frame = columns.get("frame")
    if "time_s" in columns:
        ticks = columns["time_s"] / dt_s
        expected = np.round(ticks) if frame is None else frame
        wrong = ~(np.abs(ticks - expected) < 0.05)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise RecordingError(
                path,
                got=f"person {columns['person_id'][row]} at {columns['time_s'][row]:.10g} s "
                f"({wrong.sum()} of {len(wrong)} times are not on the scene's frames)",
                expected=f"time_s in multiples of {dt_s:g} s"
                + ("" if frame is None else f", equal to frame × {dt_s:g} s"),
                hint="Resample the trajectories to the scene's time step.",
            )
        frame = expected.astype(np.int64)
    assert frame is not None
    return frame


def read_own(path: str | Path) -> Trajectories:
    """Read a Parquet file that crowdbench wrote, whatever its scene.

    Raises:
        RecordingError: the file is missing, broken, or was not written by crowdbench.
    """
    path = Path(path)
    return own_table(read_table(path), path)


def own_table(table: "pyarrow.Table", path: Path) -> Trajectories:
    """Convert a table that was read from `path` to `Trajectories`; see `read_own`."""
    metadata = own_metadata(table, path)
    if metadata is None:
        raise RecordingError(
            path,
            got="a table without crowdbench's metadata",
            expected="a file that crowdbench wrote",
            hint="Tables of other programs do not state their scene; name it, as in `crowdbench "
            "view --scene eth-v0`, `crowdbench score eth-v0`, or "
            '`crowdbench.read(path, "eth-v0")`.',
        )
    return of_table(table, path, scene=metadata.scene, dt_s=metadata.dt_s)


def read_table(path: Path) -> "pyarrow.Table":
    """The table in a Parquet or CSV file, as it is.

    Raises:
        RecordingError: the file is missing, or is not a table.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    data = pa.BufferReader(read_bytes(path, RecordingError, _HINT))
    readers = {".parquet": parquet.read_table, ".csv": csv.read_csv}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise RecordingError(
            path,
            got=f"a {path.suffix} file" if path.suffix else "a file without a suffix",
            expected=".parquet or .csv",
            hint=_HINT,
        )
    try:
        table = readers[suffix](data)
    except (pa.ArrowException, OSError) as error:
        raise RecordingError(
            path, got=str(error).splitlines()[0], expected="a readable table", hint=_HINT
        ) from error
    named = table.rename_columns([name.strip() for name in table.column_names])
    return named.replace_schema_metadata(table.schema.metadata)


def own_metadata(table: "pyarrow.Table", path: Path) -> Metadata | None:
    """What crowdbench wrote about a table that was read from `path`; None if it did not write it.

    Raises:
        RecordingError: it is invalid.
    """
    raw = (table.schema.metadata or {}).get(_KEY)
    if raw is None:
        return None
    try:
        metadata = msgspec.json.decode(raw, type=Metadata)
    except (msgspec.DecodeError, RecursionError) as error:
        raise RecordingError(
            path, got=f"invalid metadata ({error})", expected="crowdbench's metadata"
        ) from error
    edges = np.array(metadata.observed).ravel()
    if len(edges) == 0 or (np.diff(edges) < 0).any() or edges[0] < 0 or edges[-1] > metadata.frames:
        raise RecordingError(
            path,
            got=f"observed intervals {metadata.observed[:3]} of {metadata.frames} frames",
            expected="disjoint intervals within the frames, in ascending order",
        )
    if metadata.schema != SCHEMA:
        raise RecordingError(
            path,
            got=f"schema version {metadata.schema}",
            expected=f"schema version {SCHEMA}",
            hint="Read it with the crowdbench version that wrote it.",
        )
    return metadata


def _numbers(path: Path, table: "pyarrow.Table", name: str) -> np.ndarray:
    if table.column_names.count(name) > 1:
        raise RecordingError(
            path, got=f"more than one column {name}", expected="only one", hint=_HINT
        )
    values = table.column(name)
    if values.null_count:
        first = int(np.flatnonzero(values.is_null().to_numpy())[0]) + 1
        raise RecordingError(
            path,
            got=f"an empty or NaN value in {values.null_count} rows of column {name}, first in "
            f"row {first}",
            expected="a value in each row",
            hint="Remove these rows or correct them in the source.",
        )
    column: np.ndarray = values.to_numpy()
    if column.dtype.kind not in "biuf":
        kind = "text" if column.dtype == object else f"{values.type} values"
        raise RecordingError(
            path, got=f"{kind} in column {name}", expected="numbers in each row", hint=_HINT
        )
    if np.issubdtype(PERSON_COLUMNS.get(name, np.bool_), np.integer):
        return _integers(path, name, column, PERSON_COLUMNS[name])
    if name in PERSON_COLUMNS and not np.isfinite(column).all():
        bad = column[~np.isfinite(column)][0]
        raise RecordingError(
            path, got=f"{name} {bad}", expected=f"finite numbers in column {name}", hint=_HINT
        )
    return column


def _integers(path: Path, name: str, values: np.ndarray, kind: type = np.int64) -> np.ndarray:
    limit = 2.0 ** (np.iinfo(kind).bits - 1)
    whole = (np.abs(values) < limit) & (values == np.floor(values))  # false for NaN
    if not whole.all():
        bad = values[~whole][0]
        raise RecordingError(
            path,
            got=f"{name} {bad}",
            expected=f"integers of {np.iinfo(kind).bits} bits in column {name}",
            hint=_HINT,
        )
    return values.astype(kind)


def _missing(path: Path, name: str, table: "pyarrow.Table") -> RecordingError:
    return RecordingError(
        path,
        got=f"columns {', '.join(table.column_names)}",
        expected=f"a column {name}",
        hint=_HINT,
    )
