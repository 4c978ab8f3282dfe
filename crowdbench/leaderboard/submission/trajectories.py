"""Read untrusted tables of trajectories, and check them against the rules for listing.

The size of a table is checked before it is decoded.

Only the trajectories themselves are known, so they must be plausible: the scene's time step and
length, one person per trip and no gaps in it, few positions in walls, few jumps, trips that end
where people leave, and rollouts that differ.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import shapely
from jaxtyping import Bool, Float

from crowdbench.data.storage import columns_of, of_table
from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS, Trajectories
from crowdbench.errors import RecordingError
from crowdbench.files import read_bytes, sha256
from crowdbench.leaderboard.submission import limits
from crowdbench.leaderboard.submission.errors import Problems, RefusedError
from crowdbench.leaderboard.submission.schema import Track
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.areas import Areas, read_areas

if TYPE_CHECKING:
    import pyarrow

IN_WALLS = 0.01
"""Largest share of positions that may be more than `WALL_M` inside walls."""
WALL_M = 0.1
OUTSIDE_M = 10.0
"""Largest distance (m) of positions outside the scene's bounds; no single step is that long."""
TOO_FAST = 0.01
"""Largest share of speeds over 0.8 s that may exceed the scene's maximum."""
SPEED_S = 0.8
DROPPED = 0.02
"""Largest share of trips that may end where nobody leaves; at most 0.8 % in shipped crowds."""
EDGE_M = 1.0
"""A trip may end within this distance (m) of the bounds,"""
GOAL_SD = 4.0
"""or within this many standard deviations of a goal area's centre."""
LAST = 0.9
"""The last row must be later than this share of the scene's duration."""
_COLUMNS = ("person_id", "frame", "time_s", "x", "y", *PERSON_COLUMNS)
_BATCH = 2**16
_HINT = "Write one row per person and frame, with only the columns person_id, frame, x and y."
_LONGEST_HEADER = 10_000  # bytes of the first line of a CSV file


def check_crowds(
    folder: Path, track: Track, crowds: dict[str, list[str]], problems: Problems
) -> None:
    """Read all trajectories and check them against the rules for listing.

    Problems are added to `problems`.
    """
    for scene, names in crowds.items():
        place = load_scene(scene)
        areas = read_areas(place)
        seen: dict[str, str] = {}
        for name in names:
            with problems.collected(folder):
                crowd = _read(folder / name, place)
                problems += broken_rules(name, crowd, track, place, areas)
                content = b"".join(x.tobytes() for x in (crowd.first, crowd.offsets, crowd.xy))
                same = seen.setdefault(sha256(content), name)
                if same != name:
                    got = f"the same crowd as in {same}"
                    hint = "Use a different seed for each rollout."
                    problems.refuse(name, got=got, expected="rollouts that differ", hint=hint)


def _read(path: Path, scene: Scene) -> Trajectories:
    table = read_table(path)
    _check_lives(path, table)
    frames = scene.recording.frames
    return of_table(table, path, scene=scene.id, dt_s=scene.dt_s, frames=frames)


def _check_lives(path: Path, table: "pyarrow.Table") -> None:
    """Reject reused ids, before the reader fills in rows for missing frames."""
    columns = columns_of(table, path)
    time = "frame" if "frame" in columns else "time_s"
    ids, when = columns["person_id"], columns[time].astype(np.float64)
    order = np.lexsort((when, ids))
    ids, when = ids[order], when[order]
    same = ids[1:] == ids[:-1]
    persons = len(ids) - int(same.sum())
    if persons > limits.MOST_PERSONS:
        got = f"{persons} persons"
        hint = "Give each person one id for the whole trip."
        raise RecordingError(path, got=got, expected=f"at most {limits.MOST_PERSONS}", hint=hint)
    steps = np.diff(when)[same]
    # The reader reports repeated frames. The time step is the shortest positive difference.
    step = 1.0 if time == "frame" else float(steps[steps > 0].min(initial=np.inf))
    gap = same.nonzero()[0][steps > 1.5 * step]
    if len(gap):
        raise RecordingError(
            path,
            got=f"person {ids[gap[0]]} without rows between {time} {when[gap[0]]:g} and "
            f"{when[gap[0] + 1]:g} ({len(gap)} such gaps)",
            expected="a row in each frame of a trip, and a different id for each person",
            hint="Do not reuse the id of a person who has left.",
        )


def broken_rules(
    name: str, crowd: Trajectories, track: Track, scene: Scene, areas: Areas
) -> Iterator[RefusedError]:
    """Yield the rules for listing that a crowd breaks; `name` identifies the crowd in messages."""
    frames = scene.recording.frames
    yield from _wrong_columns(name, crowd, track, areas)
    last = int(crowd.last.max())
    if crowd.frames != frames or crowd.observed.tolist() != [[0, frames]] or last < LAST * frames:
        yield RefusedError(
            name,
            got=f"{crowd.frames} frames, the last person in frame {last}",
            expected=f"{frames} frames, all observed, with people in the last {1 - LAST:.0%}",
            hint=f"Simulate {scene.horizon_s:g} s in steps of {scene.dt_s:.4g} s.",
        )
    xy = crowd.xy.astype(np.float64)
    outside_m = float(-_depth_m(xy, scene).min())
    if outside_m > OUTSIDE_M:
        yield RefusedError(
            name,
            got=f"a position {outside_m:.3g} m outside the scene's bounds",
            expected=f"at most {OUTSIDE_M:g} m",
            hint="People outside the bounds have left. Are x and y in the scene's coordinates (m)?",
        )
    for share, most, got, hint in (
        (
            _in_walls(xy, scene),
            IN_WALLS,
            f"positions more than {WALL_M:g} m inside walls",
            "`crowdbench view` shows the walls.",
        ),
        (
            _too_fast(crowd, xy, scene),
            TOO_FAST,
            f"speeds over {SPEED_S:g} s above {scene.motion.max_speed_mps:g} m/s",
            "Do the frames have the scene's time step, and does each id belong to one person?",
        ),
        (
            float(undeclared_drops(crowd, track, scene, areas).mean()),
            DROPPED,
            "trips ending away from the edge and the goal areas",
            f"Persons removed from the scene must have the outcome {OUTCOMES.index('timeout')} "
            "(timeout).",
        ),
    ):
        if share > most:
            yield RefusedError(
                name, got=f"{share:.2%} of {got}", expected=f"at most {most:.0%}", hint=hint
            )


def _wrong_columns(
    name: str, crowd: Trajectories, track: Track, areas: Areas
) -> Iterator[RefusedError]:
    """Yield columns of persons that contradict the positions; metrics rely on these columns."""
    start_s = crowd.first * crowd.dt_s
    slack_s = 1.01 * crowd.dt_s  # events happen between frames
    late = crowd.entered & (np.abs(crowd.spawn_s - start_s) > slack_s)
    unborn = ~crowd.entered & (crowd.first > 0)
    spawn, goal = len(areas.spawn), len(areas.goal)
    in_spawn = (crowd.spawn_area >= -1) & (crowd.spawn_area < spawn)
    in_goal = (crowd.goal_area >= -1) & (crowd.goal_area < goal)
    for wrong, got, expected in (
        (~in_spawn, "spawn_area", f"−1 to {spawn - 1}"),
        (~in_goal, "goal_area", f"−1 to {goal - 1}"),
        (late, "spawn_s", "the time of the first row"),
        (crowd.requested_s > crowd.spawn_s + slack_s, "requested_s", "spawn_s or earlier"),
        (unborn & (track != "walk"), "entered", "true for people after the first frame"),
    ):
        if wrong.any():
            first = int(np.flatnonzero(wrong)[0])
            column = getattr(crowd, got)
            yield RefusedError(
                name,
                got=f"{got} {column[first]} of person {crowd.person_id[first]} "
                f"({int(wrong.sum())} in all)",
                expected=expected,
                hint="Columns that your program does not know can be left out.",
            )


def _depth_m(xy: Float[np.ndarray, "n 2"], scene: Scene) -> Float[np.ndarray, " n"]:
    """Distance (m) of each position from the bounds; negative outside."""
    b = scene.bounds
    sides = (xy[:, 0] - b.x_min_m, b.x_max_m - xy[:, 0], xy[:, 1] - b.y_min_m, b.y_max_m - xy[:, 1])
    return np.min(sides, axis=0)


def _in_walls(xy: Float[np.ndarray, "n 2"], scene: Scene) -> float:
    deep = scene.obstacles.buffer(-WALL_M)
    shapely.prepare(deep)
    return float(shapely.intersects_xy(deep, xy[:, 0], xy[:, 1]).mean())


def _too_fast(crowd: Trajectories, xy: Float[np.ndarray, "n 2"], scene: Scene) -> float:
    lag = max(1, round(SPEED_S / scene.dt_s))
    person = crowd.row_person()
    same = person[lag:] == person[:-lag]
    if not same.any():
        return 0.0
    speed = np.linalg.norm(xy[lag:] - xy[:-lag], axis=1)[same] / (lag * scene.dt_s)
    return float((speed > scene.motion.max_speed_mps).mean())


def undeclared_drops(
    crowd: Trajectories, track: Track, scene: Scene, areas: Areas
) -> Bool[np.ndarray, " P"]:
    """Which persons vanish inside the scene without a declared reason.

    A trip can end in four ways: with the crowd's last frame; at the scene's edge (within `EDGE_M`
    of the bounds, or outside them); in a goal area (within `GOAL_SD` standard deviations of its
    centre); or by removal. Removal must be declared by the outcome `timeout`, or on track walk by
    `recorded`, for people whom the recording loses. Other outcomes are not believed: a person who
    is said to have reached a goal must be in a goal area. A person who disappears early without
    having `left` counts as vanished, since the trip would be missing from the statistics. Track
    walk is exempt from this, since the recording's annotation may cut trips.
    """
    end = crowd.end.astype(np.float64)
    early = crowd.last < crowd.frames - 1
    way = end[:, None] - areas.goal.mean[None]
    inverse = np.linalg.inv(areas.goal.covariance)
    at_goal = (np.einsum("pgi,gij,pgj->pg", way, inverse, way) <= GOAL_SD**2).any(axis=1)
    placed = at_goal | (_depth_m(end, scene) <= EDGE_M)
    declares = ("timeout", "recorded") if track == "walk" else ("timeout",)
    declared = np.isin(crowd.outcome, [OUTCOMES.index(how) for how in declares])
    vanished = ~placed & ~declared
    if track != "walk":
        vanished |= ~crowd.left
    return early & vanished


def read_table(path: Path) -> "pyarrow.Table":
    """Return the trajectory columns of a Parquet or CSV file.

    The limits of a Parquet file are checked on its metadata before it is decoded, and again on the
    decoded data, since the metadata may be false.

    Raises:
        RecordingError: the file is missing, broken or too large.
    """
    import pyarrow as pa

    size = path.stat().st_size
    if size > limits.LARGEST_TABLE:
        most = f"at most {limits.LARGEST_TABLE / 1e6:.0f} MB"
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
    size = sum(sizes) if min(sizes, default=0) >= 0 else limits.LARGEST_DECODED + 1
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
    _refuse(path, columns > limits.MOST_COLUMNS, f"{columns} columns", str(limits.MOST_COLUMNS))


def _check_size(path: Path, rows: int, size: int = 0) -> None:
    _refuse(path, rows > limits.MOST_ROWS, f"{rows} rows", str(limits.MOST_ROWS))
    most = f"{limits.LARGEST_DECODED / 1e6:.0f} MB"
    _refuse(path, size > limits.LARGEST_DECODED, "a table that takes more memory", most)
