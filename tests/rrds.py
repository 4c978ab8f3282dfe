"""What a file for the rerun viewer holds, read back row by row."""

import subprocess
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pyarrow as pa
import pytest


def rerun(*arguments: object) -> str:
    """What rerun's own command line answers."""
    command = [sys.executable, "-m", "rerun", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout + done.stderr


def forget_types(monkeypatch: pytest.MonkeyPatch) -> None:
    """Rerun learns a value's type when it is first logged: as if nothing had been logged yet."""
    from rerun.any_batch_value import ANY_VALUE_TYPE_REGISTRY

    monkeypatch.setattr(ANY_VALUE_TYPE_REGISTRY, "_entries", {})


def chunks(path: Path, store: Literal["recording", "blueprint"] = "recording") -> list[Any]:
    """The pieces of the only recording in a file, or of its only layout."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    (found,) = reader.recordings() if store == "recording" else reader.blueprints()
    return reader.stream(store=found).to_chunks()


def columns(chunk: Any) -> list[str]:
    """Names of the columns of a piece."""
    return list(chunk.to_record_batch().schema.names)


def entities(path: Path) -> set[str]:
    """Paths of all that was logged."""
    return {chunk.entity_path for chunk in chunks(path)}


def always(path: Path, entity: str) -> dict[str, Any]:
    """What was logged at an entity for all times: values by component."""
    batches = [c.to_record_batch() for c in chunks(path) if c.entity_path == entity and c.is_static]
    return {name: b.column(name)[0].as_py() for b in batches for name in b.schema.names[1:]}


def rows(path: Path, entity: str, component: str, clock: str = "frame") -> dict[Any, np.ndarray]:
    """What a component of an entity is at each time: an array by frame, or by nanosecond."""
    found = {}
    for chunk in chunks(path):
        if chunk.entity_path == entity and not chunk.is_static:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                times = batch.column(clock)
                at = times if clock == "frame" else times.cast(pa.int64())
                values = batch.column(component).to_pylist()
                found |= {t: np.array(v) for t, v in zip(at.to_pylist(), values, strict=True)}
    return dict(sorted(found.items()))
