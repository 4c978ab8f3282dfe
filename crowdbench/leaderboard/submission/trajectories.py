"""Checking the trajectories of a submission: may they be listed?

Listed crowds are judged by what they show alone, so what they show must be possible: the scene's
time step and length, whole lives of one person each, few positions in walls, few leaps, lives that
end where people leave, and rollouts that differ.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float

from crowdbench.errors import CrowdbenchError, RecordingError
from crowdbench.files import sha256
from crowdbench.leaderboard.submission.errors import RefusedError, collecting
from crowdbench.leaderboard.submission.limits import MOST_PERSONS
from crowdbench.leaderboard.submission.schema import Track
from crowdbench.leaderboard.submission.untrusted import read_table
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.trajectories.storage import of_table
from crowdbench.trajectories.table import OUTCOMES, Trajectories

if TYPE_CHECKING:
    import pyarrow

IN_WALLS = 0.01
"""Share of positions that may lie in walls, by more than `WALL_M`."""
WALL_M = 0.1
OUTSIDE_M = 10.0
"""How far from the scene's bounds positions may lie, which is more than any step leads."""
TOO_FAST = 0.01
"""Share of speeds over 0.8 s that may exceed the scene's greatest."""
SPEED_S = 0.8
DROPPED = 0.02
"""Share of lives that may end where nobody leaves; 0.8 % of shipped crowds' do at most."""
EDGE_M = 1.0
"""So close to the bounds a life may end,"""
GOAL_SD = 4.0
"""or within so many standard deviations of a goal area."""
LAST = 0.9
"""The last row must lie beyond this share of the scene's length."""


def check_crowds(
    folder: Path, track: Track, crowds: dict[str, list[str]], problems: list[CrowdbenchError]
) -> None:
    """Read all trajectories and hold them against the rules of listing.

    What is wrong is added to `problems`.
    """
    for scene, names in crowds.items():
        place = load_scene(scene)
        areas = read_areas(place)
        seen: dict[str, str] = {}
        for name in names:
            with collecting(problems, folder):
                crowd = _read(folder / name, place)
                problems += broken_rules(name, crowd, track, place, areas)
                same = seen.setdefault(_content(crowd), name)
                if same != name:
                    problems.append(
                        RefusedError(
                            name,
                            got=f"the crowd of {same} again",
                            expected="rollouts that differ",
                            hint="Give each a seed of its own.",
                        )
                    )


def _content(crowd: Trajectories) -> str:
    return sha256(b"".join(x.tobytes() for x in (crowd.first, crowd.offsets, crowd.xy)))


def _read(path: Path, scene: Scene) -> Trajectories:
    table = read_table(path)
    _check_lives(path, table)
    frames = scene.recording.frames
    return of_table(table, path, scene=scene.id, dt_s=scene.dt_s, frames=frames)


def _check_lives(path: Path, table: "pyarrow.Table") -> None:
    """Refuse ids that are used again, before rows are filled in where frames are missing.

    Raises:
        RecordingError: a person has frames without a row between its first and its last.
    """
    time = "frame" if "frame" in table.column_names else "time_s"
    if not {"person_id", time} <= set(table.column_names) or len(table) == 0:
        return  # which the reader of tables tells
    columns = [table.column("person_id"), table.column(time)]
    if any(column.null_count for column in columns):
        return
    ids, when = (column.to_numpy() for column in columns)
    if ids.dtype.kind not in "iuf" or when.dtype.kind not in "iuf":
        return
    order = np.lexsort((when, ids))
    ids, when = ids[order], when[order].astype(np.float64)
    same = ids[1:] == ids[:-1]
    persons = len(ids) - int(same.sum())
    if persons > MOST_PERSONS:
        raise RecordingError(
            path,
            got=f"{persons} persons",
            expected=f"at most {MOST_PERSONS}",
            hint="Give each person one id for its whole life.",
        )
    steps = np.diff(when)[same]
    # Twice in a frame is told by the reader; the usual step is the shortest that is one.
    step = 1.0 if time == "frame" else float(steps[steps > 0].min(initial=np.inf))
    gap = same.nonzero()[0][steps > 1.5 * step]
    if len(gap):
        raise RecordingError(
            path,
            got=f"person {ids[gap[0]]} without rows between {time} {when[gap[0]]:g} and "
            f"{when[gap[0] + 1]:g} ({len(gap)} such gaps)",
            expected="a row in each frame of a life, and an id of its own for each person",
            hint="An id that has left must not be used again.",
        )


def broken_rules(
    name: str, crowd: Trajectories, track: Track, scene: Scene, areas: Areas
) -> Iterator[RefusedError]:
    """The rules of listing that a crowd breaks; `name` says which crowd in their messages."""
    frames = scene.recording.frames
    yield from _columns(name, crowd, track, areas)
    last = int(crowd.last.max())
    if crowd.frames != frames or crowd.observed.tolist() != [[0, frames]] or last < LAST * frames:
        yield RefusedError(
            name,
            got=f"{crowd.frames} frames, the last person in frame {last}",
            expected=f"{frames} frames, people until the last {1 - LAST:.0%}, all of it observed",
            hint=f"Simulate {scene.horizon_s:g} s in steps of {scene.dt_s:.4g} s.",
        )
    xy = crowd.xy.astype(np.float64)
    outside_m = float(-_depth_m(xy, scene).min())
    if outside_m > OUTSIDE_M:
        yield RefusedError(
            name,
            got=f"somebody {outside_m:.3g} m outside the scene's bounds",
            expected=f"at most {OUTSIDE_M:g} m",
            hint="Who walks out of the bounds has left. Are x and y in the scene's metres?",
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
            "Are frames the scene's, and ids those of one person each?",
        ),
        (
            float(undeclared_drops(crowd, track, scene, areas).mean()),
            DROPPED,
            "lives that end where nobody leaves",
            f"Persons taken out of the scene must have the outcome {OUTCOMES.index('timeout')} "
            "(timeout).",
        ),
    ):
        if share > most:
            yield RefusedError(
                name, got=f"{share:.2%} of {got}", expected=f"at most {most:.0%}", hint=hint
            )


def _columns(name: str, crowd: Trajectories, track: Track, areas: Areas) -> Iterator[RefusedError]:
    """What the columns of persons must agree with, since metrics believe them."""
    start_s = crowd.first * crowd.dt_s
    slack_s = 1.01 * crowd.dt_s  # events lie between frames
    late = crowd.entered & (np.abs(crowd.spawn_s - start_s) > slack_s)
    unborn = ~crowd.entered & (crowd.first > 0)
    for wrong, got, expected in (
        (
            (crowd.spawn_area < -1) | (crowd.spawn_area >= len(areas.spawn)),
            "spawn_area",
            f"−1 to {len(areas.spawn) - 1}",
        ),
        (
            (crowd.goal_area < -1) | (crowd.goal_area >= len(areas.goal)),
            "goal_area",
            f"−1 to {len(areas.goal) - 1}",
        ),
        (late, "spawn_s", "the time of the first row"),
        (crowd.requested_s > crowd.spawn_s + slack_s, "requested_s", "spawn_s or earlier"),
        (unborn & (track != "walk"), "entered", "true for who comes after the first frame"),
    ):
        if wrong.any():
            first = int(np.flatnonzero(wrong)[0])
            column = getattr(crowd, got)
            yield RefusedError(
                name,
                got=f"{got} {column[first]} of person {crowd.person_id[first]} "
                f"({int(wrong.sum())} such persons)",
                expected=expected,
                hint="Columns that other programs do not know can be left out.",
            )


def _depth_m(xy: Float[np.ndarray, "n 2"], scene: Scene) -> Float[np.ndarray, " n"]:
    """How far inside the bounds positions lie; negative outside."""
    b = scene.bounds
    sides = (xy[:, 0] - b.x_min_m, b.x_max_m - xy[:, 0], xy[:, 1] - b.y_min_m, b.y_max_m - xy[:, 1])
    return np.min(sides, axis=0)


def _in_walls(xy: Float[np.ndarray, "n 2"], scene: Scene) -> float:
    import shapely

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
    """Who vanishes from the middle of the scene without a word.

    A life ends in one of four ways: with the crowd's last frame; at the scene's edge (within
    `EDGE_M` of the bounds, or outside them); in a goal area (within `GOAL_SD` standard deviations
    of its centre); or because somebody takes the person out, which the outcome `timeout` declares,
    and on track walk `recorded`, for those whom the recording loses sight of. Other outcomes
    declare nothing: who is said to have reached a goal must stand where goals are. Who has not
    `left` before the last frame vanishes too, since that would take a life out of the statistics;
    but for track walk, where annotation cuts do so.
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
