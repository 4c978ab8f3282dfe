"""Spawn events as tables for other programs."""

from dataclasses import fields
from pathlib import Path

import numpy as np

from crowdbench.data.storage import rounded_s
from crowdbench.errors import OutputError
from crowdbench.files import replacing
from crowdbench.spawn.events import SpawnEvents

_POINTS = ("start", "goal", "velocity", "via")


def write_events(events: SpawnEvents, path: str | Path) -> None:
    """Write one row per person to a CSV or Parquet file, atomically.

    The columns are those of `SpawnEvents`; points have two columns, such as `goal_x` and `goal_y`.
    People without a via point have empty cells there.

    Raises:
        OutputError: the file is neither `.csv` nor `.parquet`, or cannot be written.
    """
    import pyarrow as pa
    from pyarrow import csv, parquet

    writers = {".csv": csv.write_csv, ".parquet": parquet.write_table}
    path = Path(path)
    if path.suffix not in writers:
        raise OutputError(path, got=f"a file {path.suffix}", expected=".csv or .parquet")
    columns: dict[str, np.ndarray] = {"person": np.arange(len(events))}
    for name in (field.name for field in fields(events)):
        values = np.asarray(getattr(events, name))
        if name in _POINTS:
            columns |= {f"{name}_x": values[:, 0], f"{name}_y": values[:, 1]}
        else:
            columns[name] = rounded_s(values) if name.endswith("_s") else values
    table = pa.table({k: pa.array(v, from_pandas=True) for k, v in columns.items()})
    with replacing(path) as temporary:
        writers[path.suffix](table, temporary)
