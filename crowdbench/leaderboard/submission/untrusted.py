"""Read untrusted tables; their size is checked before they are decoded."""

from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.data.table import PERSON_COLUMNS
from crowdbench.errors import RecordingError
from crowdbench.files import read_bytes
from crowdbench.leaderboard.submission.limits import (
    LARGEST_DECODED,
    LARGEST_TABLE,
    MOST_COLUMNS,
    MOST_ROWS,
)

if TYPE_CHECKING:
    import pyarrow

_COLUMNS = ("person_id", "frame", "time_s", "x", "y", *PERSON_COLUMNS)
_BATCH = 2**16
_HINT = "Write one row per person and frame, with only the columns person_id, frame, x and y."
_LONGEST_HEADER = 10_000  # bytes of the first line of a CSV file


def read_table(path: Path) -> "pyarrow.Table":
    """Return the trajectory columns of a Parquet or CSV file.

    The limits of a Parquet file are checked on its metadata before it is decoded, and again on the
    decoded data, since the metadata may be false.

    Raises:
        RecordingError: the file is missing, broken or too large.
    """
    import pyarrow as pa

    size = path.stat().st_size
    if size > LARGEST_TABLE:
        most = f"at most {LARGEST_TABLE / 1e6:.0f} MB"
        hint = "A Parquet file has a tenth of the size of a CSV file."
        raise RecordingError(path, got=f"{size / 1e6:.1f} MB", expected=most, hint=hint)
    read = _parquet if path.suffix == ".parquet" else _csv
    try:
        table = read(path)
        named = [name.strip() for name in table.column_names]
    except (pa.ArrowException, OSError, MemoryError, UnicodeDecodeError) as error:
        told = (str(error) or type(error).__name__).splitlines()[0]
        raise RecordingError(path, got=told, expected="a readable table", hint=_HINT) from error
    _check_names(path, named)
    return table.rename_columns(named).replace_schema_metadata(table.schema.metadata)


def _refuse(path: Path, wrong: bool, got: str, most: str) -> None:
    if wrong:
        raise RecordingError(path, got=got, expected=f"at most {most}", hint=_HINT)


def _csv(path: Path) -> "pyarrow.Table":
    from pyarrow import BufferReader, csv

    data = read_bytes(path, RecordingError, "")
    header = data[: _LONGEST_HEADER + 1].partition(b"\n")[0]
    _refuse(path, len(header) > _LONGEST_HEADER, "a first line over 10 kB", "10 kB of names")
    _check_columns(path, header.count(b",") + 1)
    table = csv.read_csv(BufferReader(data), csv.ReadOptions(use_threads=False))
    _check_size(path, len(table))
    return table


def _parquet(path: Path) -> "pyarrow.Table":
    import pyarrow as pa
    from pyarrow import parquet

    # The file is read into memory first: a mapped file could change while it is decoded.
    data = pa.BufferReader(read_bytes(path, RecordingError, ""))
    file = parquet.ParquetFile(data)
    told = file.metadata
    _check_columns(path, told.num_columns)
    sizes = [told.row_group(k).total_byte_size for k in range(told.num_row_groups)]
    size = sum(sizes) if min(sizes, default=0) >= 0 else LARGEST_DECODED + 1
    _check_size(path, told.num_rows, size)
    schema = file.schema_arrow
    _check_names(path, schema.names)
    wanted = [name for name in schema.names if name.strip() in _COLUMNS]
    for name in wanted:
        kind = schema.field(name).type
        if not (
            pa.types.is_integer(kind) or pa.types.is_floating(kind) or pa.types.is_boolean(kind)
        ):
            raise RecordingError(
                path, got=f"{kind} in column {name}", expected="numbers", hint=_HINT
            )
    batches, rows, size = [], 0, 0
    for batch in file.iter_batches(_BATCH, columns=wanted, use_threads=False):
        rows, size = rows + batch.num_rows, size + batch.nbytes
        _check_size(path, rows, size)
        batches.append(batch)
    kept = pa.schema([schema.field(name) for name in wanted], schema.metadata)
    table = pa.Table.from_batches(batches) if batches else kept.empty_table()
    return table.replace_schema_metadata(schema.metadata)


def _check_names(path: Path, names: list[str]) -> None:
    _refuse(path, len(set(names)) < len(names), "two columns of the same name", "one")


def _check_columns(path: Path, columns: int) -> None:
    _refuse(path, columns > MOST_COLUMNS, f"{columns} columns", str(MOST_COLUMNS))


def _check_size(path: Path, rows: int, size: int = 0) -> None:
    _refuse(path, rows > MOST_ROWS, f"{rows} rows", str(MOST_ROWS))
    most = f"{LARGEST_DECODED / 1e6:.0f} MB"
    _refuse(path, size > LARGEST_DECODED, "a table that takes more memory", most)
