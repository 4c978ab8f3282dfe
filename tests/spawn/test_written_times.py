"""Tables for other programs have times without rounding errors such as 4.800000000000001."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pyarrow import csv, parquet
from worlds import Person, events

from crowdbench.data.recordings.formats import WRITERS
from crowdbench.data.storage import rounded_s
from crowdbench.registry import recording
from crowdbench.spawn.events import SpawnEvents, write_events

DIRTY = [0.1 + 0.2, 4.800000000000001, 12 * 0.4, 4 / 9]
CLEAN = [0.3, 4.8, 4.8, 0.444444444]


def people() -> SpawnEvents:
    return events(*(Person(time_s=t, wait_s=t) for t in DIRTY))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_arrivals(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"arrivals{suffix}"
    write_events(people(), path)
    table = csv.read_csv(path) if suffix == ".csv" else parquet.read_table(path)
    for column in ("time_s", "wait_s"):
        assert table[column].to_pylist() == CLEAN


def test_trajectories(tmp_path: Path) -> None:
    plaza = recording("plaza")
    dirty = np.resize(DIRTY, len(plaza))
    crowd = replace(plaza, spawn_s=dirty, requested_s=dirty)
    path = tmp_path / "crowd.csv"
    WRITERS["csv"](crowd, path)
    table = csv.read_csv(path)
    for column in ("spawn_s", "requested_s"):
        assert set(table[column].to_pylist()) == set(CLEAN)


def test_the_frames_of_arrivals_do_not_change() -> None:
    for dt_s in (0.4, 4 / 9):
        exact = np.arange(100_000) * dt_s
        ticks = [np.ceil(t / dt_s - 1e-6) for t in (exact, rounded_s(exact))]
        assert np.array_equal(*ticks)
