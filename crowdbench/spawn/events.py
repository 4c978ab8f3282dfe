"""What a spawn model makes (`SpawnEvents`) and what it is fitted to (`Arrivals`)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.trajectories.blocks import TimeBlocks, cut
from crowdbench.trajectories.table import Trajectories


@dataclass(frozen=True, eq=False, kw_only=True)
class SpawnEvents:
    """`E` persons who are to enter, by ascending time; a simulation lets them in."""

    time_s: Float[np.ndarray, " E"]
    """When each is to enter; it does at the first frame at or after this time."""
    start: Float32[np.ndarray, "E 2"]
    """Where each enters, metres."""
    goal: Float32[np.ndarray, "E 2"]
    """Where each walks to, metres."""
    spawn_area: Int[np.ndarray, " E"]
    goal_area: Int[np.ndarray, " E"]
    speed: Float32[np.ndarray, " E"]
    """The speed each prefers to walk at, m/s; policies may use it."""
    velocity: Float32[np.ndarray, "E 2"]
    """Velocity at entry, m/s."""
    entered: Bool[np.ndarray, " E"]
    """False for those who are there when observation begins; they never wait for free space."""
    leave_frame: Int[np.ndarray, " E"]
    """Frame at whose end the person is taken away wherever it is; −1 for never."""
    scripted: Bool[np.ndarray, " E"]
    """True for those who leave at `leave_frame` and for no other reason, and never wait."""
    censored: Bool[np.ndarray, " E"]
    """True for those whom nobody saw leave: being taken away does not count as leaving."""

    def __len__(self) -> int:
        return len(self.time_s)

    def shifted(self, by_s: float) -> "SpawnEvents":
        """The same events, `by_s` seconds later."""
        return replace(self, time_s=self.time_s + by_s)

    def __getitem__(self, chosen: object) -> "SpawnEvents":
        return SpawnEvents(**{f.name: getattr(self, f.name)[chosen] for f in fields(self)})


def entering(
    *,
    time_s: Float[np.ndarray, " E"],
    start: Float[np.ndarray, "E 2"],
    goal: Float[np.ndarray, "E 2"],
    spawn_area: Int[np.ndarray, " E"],
    goal_area: Int[np.ndarray, " E"],
    speed: Float[np.ndarray, " E"],
) -> SpawnEvents:
    """Events of people who come walking in from outside towards their goals, sorted by time."""
    order = np.argsort(time_s, kind="stable")
    size = len(time_s)
    way = (goal - start)[order]
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
    )


def check_events(events: object, model: str) -> SpawnEvents:
    """What a spawn model sampled, if a simulation can let it in.

    Raises:
        SettingError: it is no `SpawnEvents`, its arrays differ in length, hold what is not
            finite, or its times do not ascend.
    """
    where = f"events of the spawn model {model}"
    if not isinstance(events, SpawnEvents):
        raise SettingError(
            where,
            got=type(events).__name__,
            expected="SpawnEvents",
            hint="Make them with crowdbench.spawn.events.entering.",
        )
    for f in fields(events):
        values = np.asarray(getattr(events, f.name))
        shape = (len(events), 2) if f.name in ("start", "goal", "velocity") else (len(events),)
        if values.shape != shape:
            raise SettingError(
                where, got=f"{f.name} of shape {values.shape}", expected=f"shape {shape}"
            )
        if not np.isfinite(values).all():
            bad = int((~np.isfinite(values)).sum())
            raise SettingError(
                where, got=f"{bad} values of {f.name} that are not finite", expected="numbers"
            )
    if (np.diff(events.time_s) < 0).any():
        raise SettingError(where, got="times in disorder", expected="ascending time_s")
    return events


def joined(parts: Sequence[SpawnEvents]) -> SpawnEvents:
    """The events of all parts by ascending time, at the same time by spawn area as models do."""
    parts = [no_events(), *parts]
    columns = {
        f.name: np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(parts[0])
    }
    return SpawnEvents(**columns)[np.lexsort((columns["spawn_area"], columns["time_s"]))]


def no_events() -> SpawnEvents:
    """Nobody ever enters."""
    none, pairs = np.empty(0), np.empty((0, 2))
    return entering(
        time_s=none,
        start=pairs,
        goal=pairs,
        spawn_area=none.astype(np.int32),
        goal_area=none.astype(np.int32),
        speed=none,
    )


@dataclass(frozen=True, eq=False)
class Arrivals:
    """Arrivals as a point process: `n` persons, each at an area and a point of a time grid."""

    tick: Int[np.ndarray, " n"]
    """Grid point of each arrival, ascending."""
    area: Int[np.ndarray, " n"]
    windows: Int[np.ndarray, "B 2"]
    """Stretches [start, stop) of grid points in which every arrival is known, ascending."""
    areas: int
    """K, the number of spawn areas."""
    grid_s: float

    def counts(self) -> Int[np.ndarray, "T K"]:
        """Persons per grid point of the windows (in their order) and area."""
        base = np.concatenate([[0], np.cumsum(np.diff(self.windows, axis=1)[:, 0])])
        window = np.searchsorted(self.windows[:, 0], self.tick, side="right") - 1
        at = base[window] + self.tick - self.windows[window, 0]
        flat = np.bincount(at * self.areas + self.area, minlength=base[-1] * self.areas)
        return flat.reshape(-1, self.areas)

    def exposure_s(self) -> float:
        """Seconds in all windows together."""
        return float(np.diff(self.windows, axis=1).sum() * self.grid_s)


def arrivals_in(events: SpawnEvents, horizon_s: float, grid_s: float, areas: int) -> Arrivals:
    """What a spawn model sampled in [0, `horizon_s`) as arrivals, each at the grid point before."""
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
    """The time blocks of a recording by the scene's protocol."""
    return cut(
        recording.observed,
        block_s=scene.protocol.block_s,
        dt_s=scene.dt_s,
        grid_s=scene.grid_s,
    )


def arrivals_of(crowd: Trajectories, blocks: TimeBlocks, areas: int) -> Arrivals:
    """The arrivals of those who enter in the blocks; who has no area is left out.

    Neighbouring blocks are one stretch, so that a window is as long as observation was.
    """
    persons, _, tick = blocks.of_arrivals(crowd)
    known = crowd.spawn_area[persons] >= 0
    persons, tick = persons[known], tick[known]
    ticks = np.ceil(blocks.arrival_s / blocks.grid_s - 1e-6).astype(np.int64)
    joined = [list(ticks[0])]
    for start, stop in ticks[1:]:
        if start == joined[-1][1]:
            joined[-1][1] = stop
        else:
            joined.append([start, stop])
    order = np.argsort(tick, kind="stable")
    return Arrivals(
        tick=tick[order],
        area=crowd.spawn_area[persons][order].astype(np.int64),
        windows=np.array(joined),
        areas=areas,
        grid_s=blocks.grid_s,
    )
