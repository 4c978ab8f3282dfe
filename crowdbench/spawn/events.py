"""The output of spawn models (`SpawnEvents`) and the data they are fitted to (`Arrivals`)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.data.storage import rounded_s
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, SettingError
from crowdbench.files import replacing
from crowdbench.scene import Scene


@dataclass(frozen=True, eq=False, kw_only=True)
class SpawnEvents:
    """The entries of `E` persons into a simulation, in order of time."""

    time_s: Float[np.ndarray, " E"]
    """Requested entry time, seconds; the person enters at the first frame at or after it."""
    start: Float32[np.ndarray, "E 2"]
    """Position at entry, metres."""
    goal: Float32[np.ndarray, "E 2"]
    """Position of the goal, metres."""
    spawn_area: Int[np.ndarray, " E"]
    goal_area: Int[np.ndarray, " E"]
    speed: Float32[np.ndarray, " E"]
    """Preferred walking speed, m/s; policies may use it."""
    velocity: Float32[np.ndarray, "E 2"]
    """Velocity at entry, m/s."""
    entered: Bool[np.ndarray, " E"]
    """False for people who are present when observation begins; they never wait for free space."""
    leave_frame: Int[np.ndarray, " E"]
    """Frame at whose end the person is removed, wherever it is; −1 for never."""
    scripted: Bool[np.ndarray, " E"]
    """True for people who leave only at `leave_frame` and never wait for free space."""
    censored: Bool[np.ndarray, " E"]
    """True for people who were not seen to leave: whatever ends their trip does not count as
    leaving."""
    group: Int[np.ndarray, " E"]
    """Index of the group that the person walks with; −1 if alone."""
    via: Float32[np.ndarray, "E 2"]
    """Point that the person visits before the goal, metres; NaN for none."""
    wait_s: Float[np.ndarray, " E"]
    """Time that the person stays at `via`, seconds; 0 without one."""

    def __len__(self) -> int:
        return len(self.time_s)

    def shifted(self, by_s: float) -> "SpawnEvents":
        """The same events, `by_s` seconds later."""
        return replace(self, time_s=self.time_s + by_s)

    def __getitem__(self, chosen: object) -> "SpawnEvents":
        return SpawnEvents(**{name: getattr(self, name)[chosen] for name in COLUMNS})


COLUMNS = tuple(field.name for field in fields(SpawnEvents))
POINTS = ("start", "goal", "velocity", "via")
"""Columns with two coordinates."""


def entering(
    *,
    time_s: Float[np.ndarray, " E"],
    start: Float[np.ndarray, "E 2"],
    goal: Float[np.ndarray, "E 2"],
    spawn_area: Int[np.ndarray, " E"],
    goal_area: Int[np.ndarray, " E"],
    speed: Float[np.ndarray, " E"],
    group: Int[np.ndarray, " E"] | None = None,
    via: Float[np.ndarray, "E 2"] | None = None,
    wait_s: Float[np.ndarray, " E"] | None = None,
) -> SpawnEvents:
    """Events of people who enter while walking towards their targets, sorted by time.

    Without `group` everyone is alone, without `via` and `wait_s` everyone walks directly to the
    goal.
    """
    order = np.argsort(time_s, kind="stable")
    size = len(time_s)
    group = np.full(size, -1) if group is None else group
    via = np.full((size, 2), np.nan) if via is None else via
    wait_s = np.zeros(size) if wait_s is None else wait_s
    way = (np.where(np.isnan(via), goal, via) - start)[order]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    heading = np.divide(way, length, out=np.zeros_like(way), where=length > 0)
    return SpawnEvents(
        time_s=time_s[order],
        start=start[order].astype(np.float32),
        goal=goal[order].astype(np.float32),
        spawn_area=spawn_area[order].astype(np.int32),
        goal_area=goal_area[order].astype(np.int32),
        speed=speed[order].astype(np.float32),
        velocity=(heading * speed[order, None]).astype(np.float32),
        entered=np.ones(size, dtype=bool),
        leave_frame=np.full(size, -1, dtype=np.int64),
        scripted=np.zeros(size, dtype=bool),
        censored=np.zeros(size, dtype=bool),
        group=group[order].astype(np.int32),
        via=via[order].astype(np.float32),
        wait_s=wait_s[order].astype(np.float64),
    )


def check_events(events: object, model: str) -> SpawnEvents:
    """Check the events that a spawn model sampled, and return them.

    Raises:
        SettingError: they are not `SpawnEvents`, their arrays differ in length or hold values that
            are not finite, the times are not ascending, or a wait is negative or has no `via`.
    """
    where = f"events of the spawn model {model}"
    if not isinstance(events, SpawnEvents):
        hint = "Create them with crowdbench.spawn.events.entering."
        raise SettingError(where, got=type(events).__name__, expected="SpawnEvents", hint=hint)
    for name in COLUMNS:
        values = np.asarray(getattr(events, name))
        shape = (len(events), 2) if name in POINTS else (len(events),)
        if values.shape != shape:
            raise SettingError(
                where, got=f"{name} of shape {values.shape}", expected=f"shape {shape}"
            )
        finite = np.isfinite(values)
        if name == "via":  # people without one have NaN in both coordinates
            finite |= np.isnan(values).all(axis=1)[:, None]
        if not finite.all():
            got = f"{int((~finite).sum())} values of {name} that are not finite"
            raise SettingError(where, got=got, expected="finite numbers")
    without = np.isnan(events.via).any(axis=1)
    if (events.wait_s < 0).any() or (events.wait_s[without] > 0).any():
        got = "a negative wait_s, or one of a person without via"
        raise SettingError(where, got=got, expected="wait_s of 0 or more, and 0 where via is NaN")
    if (np.diff(events.time_s) < 0).any():
        raise SettingError(
            where, got="time_s that is not sorted", expected="time_s in ascending order"
        )
    return events


def joined(parts: Sequence[SpawnEvents]) -> SpawnEvents:
    """The events of all parts, sorted by time, then by spawn area.

    Groups of different parts remain different groups.
    """
    parts = [no_events(), *parts]
    columns = {name: np.concatenate([getattr(p, name) for p in parts]) for name in COLUMNS}
    groups = np.cumsum([0, *(int(p.group.max(initial=-1)) + 1 for p in parts[:-1])])
    first = np.repeat(groups.astype(np.int32), [len(p) for p in parts])
    columns["group"] = np.where(columns["group"] < 0, -1, columns["group"] + first)
    return SpawnEvents(**columns)[np.lexsort((columns["spawn_area"], columns["time_s"]))]


def no_events() -> SpawnEvents:
    """Events without any person."""
    none, points, areas = np.empty(0), np.empty((0, 2)), np.empty(0, dtype=np.int32)
    return entering(
        time_s=none, start=points, goal=points, spawn_area=areas, goal_area=areas, speed=none
    )


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
    for name in COLUMNS:
        values = np.asarray(getattr(events, name))
        if name in POINTS:
            columns |= {f"{name}_x": values[:, 0], f"{name}_y": values[:, 1]}
        else:
            columns[name] = rounded_s(values) if name.endswith("_s") else values
    table = pa.table({k: pa.array(v, from_pandas=True) for k, v in columns.items()})
    with replacing(path) as temporary:
        writers[path.suffix](table, temporary)


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Arrivals as a point process: `n` persons, each with an area and a point of a time grid."""

    tick: Int[np.ndarray, " n"]
    """Grid point of each arrival, ascending."""
    area: Int[np.ndarray, " n"]
    windows: Int[np.ndarray, "B 2"]
    """Stretches [start, stop) of grid points in which all arrivals are known, ascending."""
    areas: int
    """K, the number of spawn areas."""
    grid_s: float
    """Step of the time grid, seconds."""

    def counts(self) -> Int[np.ndarray, "T K"]:
        """Number of persons at each grid point of the windows, in their order, and each area."""
        base = np.concatenate([[0], np.cumsum(np.diff(self.windows, axis=1)[:, 0])])
        window = np.searchsorted(self.windows[:, 0], self.tick, side="right") - 1
        at = base[window] + self.tick - self.windows[window, 0]
        flat = np.bincount(at * self.areas + self.area, minlength=base[-1] * self.areas)
        return flat.reshape(-1, self.areas)

    def by_window(self) -> list[Int[np.ndarray, "t K"]]:
        """The counts of each window."""
        return np.split(self.counts(), np.diff(self.windows, axis=1)[:, 0].cumsum()[:-1])

    def exposure_s(self) -> float:
        """Total length of the windows, seconds."""
        return float(np.diff(self.windows, axis=1).sum() * self.grid_s)


def arrivals_in(events: SpawnEvents, horizon_s: float, grid_s: float, areas: int) -> Arrivals:
    """The events in [0, `horizon_s`) as arrivals, with times rounded down to the grid."""
    tick = np.floor(events.time_s / grid_s + 1e-6).astype(np.int64)
    stop = int(np.ceil(horizon_s / grid_s - 1e-6))
    return Arrivals(
        tick=tick,
        area=events.spawn_area.astype(np.int64),
        windows=np.array([[0, stop]]),
        areas=areas,
        grid_s=grid_s,
    )


def blocks_of(recording: Trajectories, scene: Scene) -> TimeBlocks:
    """The time blocks of a recording, as defined by the scene's protocol."""
    block_s = scene.protocol.block_s
    return cut(recording.observed, block_s=block_s, dt_s=scene.dt_s, grid_s=scene.grid_s)


def arrivals_of(crowd: Trajectories, blocks: TimeBlocks, areas: int) -> Arrivals:
    """The arrivals of people who enter in the blocks; people without an area are left out.

    Adjacent blocks form one window, so that a window is as long as the observed interval.
    """
    persons, _, tick = blocks.of_arrivals(crowd)  # in order of the ticks
    known = crowd.spawn_area[persons] >= 0
    ticks = np.ceil(blocks.arrival_s / blocks.grid_s - 1e-6).astype(np.int64)
    apart = ticks[1:, 0] != ticks[:-1, 1]
    return Arrivals(
        tick=tick[known],
        area=crowd.spawn_area[persons[known]].astype(np.int64),
        windows=np.stack([ticks[np.r_[True, apart], 0], ticks[np.r_[apart, True], 1]], axis=1),
        areas=areas,
        grid_s=blocks.grid_s,
    )
