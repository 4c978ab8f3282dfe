"""Reading and writing `Trajectories` as Parquet and CSV files.

A file holds one flat table with a row per person and frame. The columns of a person are repeated
in each row, so that any tool can read the file without a join; Parquet compresses the repetition.
"""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import msgspec
import numpy as np
from jaxtyping import Float

from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS, Trajectories, from_rows, integers
from crowdbench.errors import RecordingError, checked, hinting
from crowdbench.files import read_bytes, replacing

if TYPE_CHECKING:
    from types import ModuleType

    import pyarrow

SCHEMA = 1
_KEY = b"crowdbench"
_COLUMNS: dict[str, type] = {
    "person_id": np.int64,
    "frame": np.int64,
    **dict.fromkeys(("time_s", "x", "y"), np.float64),
    **PERSON_COLUMNS,
}
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
    content: str = ""
    """Hash of all else that is stated here and of the columns; older files have none."""

    def __post_init__(self) -> None:
        edges = np.array(self.observed).ravel()
        if self.schema != SCHEMA:
            raise ValueError(f"schema version {self.schema} instead of {SCHEMA}")
        if (np.diff(edges, prepend=0, append=self.frames) < 0).any() or len(edges) == 0:
            raise ValueError(
                f"observed intervals {self.observed[:3]} are not disjoint and ascending within "
                f"{self.frames} frames"
            )


@checked()
def write_parquet(trajectories: Trajectories, path: str | Path) -> None:
    """Write the table to `path` atomically; equal tables give equal bytes.

    Raises:
        OutputError: `path` cannot be written.
    """
    from pyarrow import parquet

    names = (name for name in Metadata.__struct_fields__ if name not in ("schema", "content"))
    stated = {"schema": SCHEMA} | {name: getattr(trajectories, name) for name in names}
    table = _flat(trajectories)
    stated["content"] = _content(stated, table)
    table = table.replace_schema_metadata({_KEY: _encoded(stated)})
    with replacing(Path(path)) as temporary:
        parquet.write_table(table, temporary, compression="zstd")


def _encoded(stated: Mapping[str, object]) -> bytes:
    return msgspec.json.encode(stated, order="deterministic", enc_hook=np.ndarray.tolist)


def _content(stated: Mapping[str, object], table: "pyarrow.Table") -> str:
    """Hash of what a file states and of its columns, by which damage is found."""
    found = hashlib.blake2b(_encoded(stated), digest_size=16)
    for name in table.column_names:
        column = table.column(name).to_numpy()
        found.update(f"{name} {column.dtype.str}".encode())
        found.update(np.ascontiguousarray(column).data)
    return found.hexdigest()


@checked()
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
    return np.asarray(np.round(times_s, 9))


def _flat(t: Trajectories) -> "pyarrow.Table":
    import pyarrow as pa

    per_row = np.diff(t.offsets)
    columns: dict[str, np.ndarray] = {
        "person_id": np.repeat(t.person_id, per_row).astype(np.int64),
        "frame": t.row_frame().astype(np.int32),
        "x": t.xy[:, 0],
        "y": t.xy[:, 1],
        **{name: np.repeat(getattr(t, name), per_row) for name in PERSON_COLUMNS},
    }
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


@checked()
def read_own(path: str | Path) -> Trajectories:
    """Read a Parquet file that crowdbench wrote, whatever its scene.

    Raises:
        RecordingError: the file is missing, broken, or was not written by crowdbench.
    """
    path = Path(path)
    return of_table(read_table(path), path)


def of_table(
    table: "pyarrow.Table",
    path: Path,
    *,
    scene: str | None = None,
    dt_s: float | None = None,
    frames: int | None = None,
) -> Trajectories:
    """Convert a table that was read from `path`; see `read`, without a scene see `read_own`."""
    metadata = own_metadata(table, path)
    if metadata is not None:
        asked = (("scene", metadata.scene, scene), ("time step", metadata.dt_s, dt_s))
        for name, got, expected in asked:
            if expected not in (None, got):
                raise RecordingError(
                    path, got=f"{name} {got}", expected=f"{name} {expected}", hint=_HINT
                )
        scene, dt_s = metadata.scene, metadata.dt_s
    elif scene is None or dt_s is None:
        raise RecordingError(
            path,
            got="a table without crowdbench's metadata",
            expected="a file that crowdbench wrote",
            hint="Tables of other programs do not state their scene; name it, as in `crowdbench "
            "view --scene eth-v0`, `crowdbench score eth-v0`, or "
            '`crowdbench.read(path, "eth-v0")`.',
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


@hinting(_HINT)
def columns_of(table: "pyarrow.Table", path: Path) -> dict[str, np.ndarray]:
    """The columns of a table that `read` understands, by name, with one value per row.

    `person_id` and `frame` are integers; ids that are text are numbered in the order in which they
    first occur.

    Raises:
        RecordingError: the table lacks a column, or holds values that are not numbers.
    """
    named = table.column_names
    missing = [name for name in ("person_id", "x", "y") if name not in named]
    if not {"frame", "time_s"} & set(named):
        missing.append("frame (or time_s)")
    if len(goal := {"goal_x", "goal_y"} - set(named)) == 1:
        missing += goal
    if missing:
        got = f"columns {', '.join(named)}"
        raise RecordingError(path, got=got, expected=f"a column {' and a column '.join(missing)}")
    if len(table) == 0:
        raise RecordingError(path, got="no rows", expected="at least one row")
    columns = {name: _numbers(path, table, name) for name in _COLUMNS if name in named}
    outcome = columns.get("outcome", np.zeros(1))
    if not ((outcome >= 0) & (outcome < len(OUTCOMES))).all():
        got = f"outcomes {np.unique(outcome)[:5]}"
        raise RecordingError(path, got=got, expected=f"outcomes from 0 to {len(OUTCOMES) - 1}")
    return columns


def _numbers(path: Path, table: "pyarrow.Table", name: str) -> np.ndarray:
    if table.column_names.count(name) > 1:
        raise RecordingError(path, got=f"more than one column {name}", expected="only one")
    values = table.column(name)
    if name == "person_id" and _is_text(values.type):
        values = values.dictionary_encode().combine_chunks().indices
    if values.null_count:
        first = int(values.is_null().to_numpy().argmax()) + 1
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
        raise RecordingError(path, got=f"{kind} in column {name}", expected="numbers in each row")
    if np.issubdtype(_COLUMNS[name], np.integer):
        return integers(column, name, path, _COLUMNS[name])
    if name in PERSON_COLUMNS and not np.isfinite(column).all():
        bad = column[~np.isfinite(column)][0]
        raise RecordingError(path, got=f"{name} {bad}", expected=f"finite numbers in column {name}")
    return column


def _frames(path: Path, columns: dict[str, np.ndarray], dt_s: float) -> np.ndarray:
    """The frame of each row from `frame` or `time_s`; if both columns exist, they must agree."""
    if "time_s" not in columns:
        return columns["frame"]
    ticks = columns["time_s"] / dt_s
    expected: np.ndarray = columns.get("frame", np.round(ticks))
    wrong = ~(np.abs(ticks - expected) < 0.05)
    if wrong.any():
        row = int(wrong.argmax())
        raise RecordingError(
            path,
            got=f"person {columns['person_id'][row]} at {columns['time_s'][row]:.10g} s "
            f"({wrong.sum()} of {len(wrong)} times are not on the scene's frames)",
            expected=f"time_s in multiples of {dt_s:g} s"
            + (f", equal to frame × {dt_s:g} s" if "frame" in columns else ""),
            hint="Resample the trajectories to the scene's time step.",
        )
    return expected.astype(np.int64)


@hinting(_HINT)
def read_table(path: Path) -> "pyarrow.Table":
    """The table in a Parquet or CSV file, as it is.

    Raises:
        RecordingError: the file is missing, or is not a table.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    data = pa.BufferReader(read_bytes(path, RecordingError, _HINT))
    readers = {".parquet": parquet.read_table, ".csv": partial(_read_csv, csv)}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise RecordingError(
            path,
            got=f"a {path.suffix} file" if path.suffix else "a file without a suffix",
            expected=".parquet or .csv",
        )
    try:
        table = readers[suffix](data)
        names = [name.strip() for name in table.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        got = str(error).splitlines()[0]
        raise RecordingError(path, got=got, expected="a readable table") from error
    named = table.rename_columns(names)
    return named.replace_schema_metadata(table.schema.metadata)


def _is_text(kind: "pyarrow.DataType") -> bool:
    import pyarrow as pa

    return pa.types.is_string(kind) or pa.types.is_large_string(kind)


def _read_csv(csv: "ModuleType", data: "pyarrow.BufferReader") -> "pyarrow.Table":
    """A table with commas, semicolons or tabs; with semicolons, decimals may have commas."""
    head, _, rest = data.read(1 << 16).partition(b"\n")
    data.seek(0)
    by = next((c for c in ",;\t" if c.encode() in head), ",")
    point = "," if by != "," and re.search(rb"\d,\d", rest) else "."
    return csv.read_csv(
        data,
        parse_options=csv.ParseOptions(delimiter=by),
        convert_options=csv.ConvertOptions(decimal_point=point),
    )


def own_metadata(table: "pyarrow.Table", path: Path) -> Metadata | None:
    """What crowdbench wrote about a table that was read from `path`; None if it did not write it.

    Raises:
        RecordingError: it is invalid.
    """
    raw = (table.schema.metadata or {}).get(_KEY)
    if raw is None:
        return None
    try:
        found = msgspec.json.decode(raw, type=Metadata)
    except (msgspec.DecodeError, RecursionError) as error:
        got = f"invalid metadata ({error})"
        hint = "Read it with the crowdbench version that wrote it."
        raise RecordingError(path, got=got, expected="crowdbench's metadata", hint=hint) from error
    stated = {name: value for name, value in msgspec.json.decode(raw).items() if name != "content"}
    if found.content and found.content != _content(stated, table):
        raise RecordingError(
            path,
            got="a table or metadata that differ from what was written",
            expected="the file as crowdbench wrote it",
            hint="It is damaged or was edited. Make it again; an edited table is read as CSV.",
        )
    return found
