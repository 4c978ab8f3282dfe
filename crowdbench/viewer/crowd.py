"""Logs a crowd over time as columns: people, trails, counts and outcomes."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt16

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.scene import Scene
from crowdbench.viewer.place import UNKNOWN, WORLD, corners

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun import RecordingStream, TimeColumn

TRAIL_S = 2.0
WINDOW = 10
"""Number of frames per count of spawns, as in the metric `spawns_per_10_frames`."""
_BATCH = 500  # frames per message; the viewer shows the first ones while it loads the others
_DISC_ORDER, _TRAIL_ORDER = 2.0, 1.0
_ENDS = {
    "unknown": "was last seen after",
    "goal": "reached the goal after",
    "exit": "left the scene after",
    "timeout": "was removed without reaching the goal, after",
    "recorded": "left at the end of the recorded path, after",
    "horizon": "was still present at the end, after",
}


def log_crowd(stream: "RecordingStream", side: str, crowd: Trajectories, scene: Scene) -> None:
    """Log a crowd's people and trails below `world/<side>`, one row per frame.

    In frames that were not observed, no people are drawn, and a label says so.
    """
    import rerun as rr

    log_looks(stream, side, scene)
    known = crowd.is_observed()
    frame, person = crowd.row_frame(), crowd.row_person()
    rows = np.argsort(frame, kind="stable")
    rows = rows[known[frame[rows]]]
    frame, person = frame[rows], person[rows]
    where = f"{WORLD}/{side}"
    for start, stop in _batches(crowd.frames):
        now = slice(*np.searchsorted(frame, [start, stop]))
        here = person[now]
        length = np.bincount(frame[now] - start, minlength=stop - start)
        times = time_columns(np.arange(start, stop), crowd.dt_s)
        goal = class_of(crowd.goal_area[here])
        people = rr.Points2D.columns(positions=crowd.xy[rows[now]], class_ids=goal)
        who = rr.AnyValues.columns(
            person_id=ids(crowd.person_id[here]), group=ids(crowd.group[here])
        )
        stream.send_columns(
            f"{where}/people", times, [*people.partition(length), *who.partition(length)]
        )
        strips = trails(crowd, rows[now], crowd.offsets[here])
        lines = rr.LineStrips2D.columns(strips=strips, class_ids=goal)
        stream.send_columns(f"{where}/trails", times, lines.partition(length))
    if not known.all():
        _log_unobserved(stream, f"{where}/unobserved", known, scene, crowd.dt_s)


def log_looks(stream: "RecordingStream", side: str, scene: Scene) -> None:
    """Log the style of a side's people and trails."""
    import rerun as rr

    radius_m = scene.motion.person_radius_m
    disc = rr.Points2D.from_fields(radii=radius_m, show_labels=False, draw_order=_DISC_ORDER)
    stream.log(f"{WORLD}/{side}/people", disc, static=True)
    trail = rr.LineStrips2D.from_fields(
        radii=radius_m / 4, show_labels=False, draw_order=_TRAIL_ORDER
    )
    stream.log(f"{WORLD}/{side}/trails", trail, static=True)


def log_counts(stream: "RecordingStream", side: str, crowd: Trajectories) -> None:
    """Log agents over time and spawns per ten frames, with gaps in unobserved frames."""
    known = crowd.is_observed()
    frame = np.arange(crowd.frames)
    _log_scalars(stream, f"agents/{side}", frame, crowd.present(), known, crowd.dt_s)
    windows = frame[::WINDOW]
    entered = np.bincount(crowd.first[crowd.entered] // WINDOW, minlength=len(windows))
    whole = np.logical_and.reduceat(known, windows)
    _log_scalars(stream, f"spawns/{side}", windows, entered, whole, crowd.dt_s)


def log_series(stream: "RecordingStream", side: str, colour: tuple[int, int, int]) -> None:
    """Log the style of a side's lines in the plots."""
    import rerun as rr

    modes = {
        "agents": rr.components.InterpolationMode.Linear,
        "spawns": rr.components.InterpolationMode.StepAfter,
    }
    for name, mode in modes.items():
        look = rr.SeriesLines(names=side, colors=colour, widths=1.5, interpolation_mode=mode)
        stream.log(f"{name}/{side}", look, static=True)


def log_outcomes(stream: "RecordingStream", crowd: Trajectories) -> None:
    """Log the outcome of each trip, as a line of text in its last frame."""
    import rerun as rr

    order = np.argsort(crowd.last, kind="stable")
    trips = zip(
        crowd.person_id[order].tolist(),
        crowd.outcome[order].tolist(),
        (crowd.first[order] * crowd.dt_s).tolist(),
        (crowd.last[order] * crowd.dt_s).tolist(),
        strict=True,
    )
    texts, levels = zip(*(ending(*life) for life in trips), strict=True)
    log = rr.TextLog.columns(text=texts, level=levels)
    stream.send_columns("outcomes", time_columns(crowd.last[order], crowd.dt_s), log)


def ending(person_id: int, outcome: int, from_s: float, to_s: float) -> tuple[str, str]:
    """Log line for the end of a trip, and its level: a warning if it ended by a timeout."""
    how = OUTCOMES[outcome]
    text = f"{to_s:.1f} s: person {person_id} {_ENDS[how]} {to_s - from_s:.1f} s"
    return text, "WARN" if how == "timeout" else "INFO"


def class_of(goal_area: Int[np.ndarray, " n"]) -> UInt16[np.ndarray, " n"]:
    """Class of people with these goal areas, which determines their colour and label."""
    return np.where(goal_area < 0, UNKNOWN, goal_area).astype(np.uint16)


def ids(person_id: Int[np.ndarray, " n"]) -> "pa.Array":
    """Ids for `rerun.AnyValues`; typed, because no type can be inferred from no ids."""
    import pyarrow as pa

    return pa.array(person_id, pa.int64())


def trail_steps(dt_s: float) -> int:
    """Length of a trail in steps."""
    return max(1, round(TRAIL_S / dt_s))


def trails(
    crowd: Trajectories, rows: Int[np.ndarray, " n"], first_row: Int[np.ndarray, " n"]
) -> Float32[np.ndarray, "n k 2"]:
    """Positions in the last `TRAIL_S` seconds up to each row, metres.

    Times before a person's first row have the position of the first row.
    """
    back = np.arange(trail_steps(crowd.dt_s), -1, -1)
    return crowd.xy[np.maximum(rows[:, None] - back, first_row[:, None])]


def time_columns(frame: Int[np.ndarray, " n"], dt_s: float) -> "list[TimeColumn]":
    """The two time lines of these frames: `time` in seconds, and `frame`."""
    import rerun as rr

    return [
        rr.TimeColumn("time", duration=frame * dt_s),
        rr.TimeColumn("frame", sequence=frame),
    ]


def _batches(frames: int) -> Iterator[tuple[int, int]]:
    for start in range(0, frames, _BATCH):
        yield start, min(start + _BATCH, frames)


def _log_scalars(
    stream: "RecordingStream",
    where: str,
    frame: Int[np.ndarray, " n"],
    value: Int[np.ndarray, " n"],
    known: Bool[np.ndarray, " n"],
    dt_s: float,
) -> None:
    import rerun as rr

    # A row without a value interrupts the line.
    column = rr.Scalars.columns(scalars=value[known].astype(np.float64))
    stream.send_columns(where, time_columns(frame, dt_s), column.partition(known.astype(np.int64)))


def _log_unobserved(
    stream: "RecordingStream", where: str, known: Bool[np.ndarray, " n"], scene: Scene, dt_s: float
) -> None:
    """Log a label in the middle of the scene for frames that were not observed."""
    import rerun as rr

    turns = np.flatnonzero(np.diff(known, prepend=not known[0]))
    shown = (~known[turns]).astype(np.int64)
    middle = np.tile(np.mean(corners(scene), axis=0), (shown.sum(), 1))
    note = rr.Points2D.columns(positions=middle, labels=["not observed"] * len(middle))
    stream.send_columns(where, time_columns(turns, dt_s), note.partition(shown))
    look = rr.Points2D.from_fields(radii=0.0, colors=[[255, 255, 255]], show_labels=True)
    stream.log(where, look, static=True)
