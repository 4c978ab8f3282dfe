"""A crowd over time, sent as columns: people, their trails, how many there are, how lives end."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt16

from crowdbench.scene import Scene
from crowdbench.trajectories.table import OUTCOMES, Trajectories
from crowdbench.viewer.place import UNKNOWN, WORLD, corners

if TYPE_CHECKING:
    import pyarrow as pa
    from rerun import RecordingStream, TimeColumn

TRAIL_S = 2.0
WINDOW = 10
"""Frames in which spawns are counted together, as in the metric of that name."""
_BATCH = 500  # frames sent at once: a viewer shows the first while it loads the others
_DISC_ORDER, _TRAIL_ORDER = 2.0, 1.0
_ENDS = {
    "unknown": "was seen last after",
    "goal": "reached its goal after",
    "exit": "walked out of the scene after",
    "timeout": "was taken away, still not at its goal, after",
    "recorded": "left where its record ends, after",
    "horizon": "was still there at the end, after",
}


def log_crowd(stream: "RecordingStream", side: str, crowd: Trajectories, scene: Scene) -> None:
    """Log a crowd's people and their trails below `world/<side>`, one row a frame.

    In frames that nobody observed, nobody is drawn, and it is said.
    """
    import rerun as rr

    log_looks(stream, side, scene)
    known = observed_frames(crowd)
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
        who = rr.AnyValues.columns(person_id=ids(crowd.person_id[here]))
        stream.send_columns(
            f"{where}/people", times, [*people.partition(length), *who.partition(length)]
        )
        strips = trails(crowd, rows[now], crowd.offsets[here])
        lines = rr.LineStrips2D.columns(strips=strips, class_ids=goal)
        stream.send_columns(f"{where}/trails", times, lines.partition(length))
    if not known.all():
        _log_unobserved(stream, f"{where}/unobserved", known, scene, crowd.dt_s)


def log_looks(stream: "RecordingStream", side: str, scene: Scene) -> None:
    """Log how a side's people and trails are drawn, whoever they are."""
    import rerun as rr

    radius_m = scene.motion.person_radius_m
    disc = rr.Points2D.from_fields(radii=radius_m, show_labels=False, draw_order=_DISC_ORDER)
    stream.log(f"{WORLD}/{side}/people", disc, static=True)
    trail = rr.LineStrips2D.from_fields(
        radii=radius_m / 4, show_labels=False, draw_order=_TRAIL_ORDER
    )
    stream.log(f"{WORLD}/{side}/trails", trail, static=True)


def log_counts(stream: "RecordingStream", side: str, crowd: Trajectories) -> None:
    """Log agents over time and spawns per ten frames, with gaps where nobody observed."""
    known = observed_frames(crowd)
    frame = np.arange(crowd.frames)
    _log_scalars(stream, f"agents/{side}", frame, crowd.present(), known, crowd.dt_s)
    windows = frame[::WINDOW]
    entered = np.bincount(crowd.first[crowd.entered] // WINDOW, minlength=len(windows))
    whole = np.logical_and.reduceat(known, windows)
    _log_scalars(stream, f"spawns/{side}", windows, entered, whole, crowd.dt_s)


def log_series(stream: "RecordingStream", side: str, colour: tuple[int, int, int]) -> None:
    """Log how a side's lines in the plots are drawn."""
    import rerun as rr

    modes = {
        "agents": rr.components.InterpolationMode.Linear,
        "spawns": rr.components.InterpolationMode.StepAfter,
    }
    for name, mode in modes.items():
        look = rr.SeriesLines(names=side, colors=colour, widths=1.5, interpolation_mode=mode)
        stream.log(f"{name}/{side}", look, static=True)


def log_outcomes(stream: "RecordingStream", crowd: Trajectories) -> None:
    """Log how each life ended, as a line of text at its last frame."""
    import rerun as rr

    order = np.argsort(crowd.last, kind="stable")
    lives = zip(
        crowd.person_id[order].tolist(),
        crowd.outcome[order].tolist(),
        (crowd.first[order] * crowd.dt_s).tolist(),
        (crowd.last[order] * crowd.dt_s).tolist(),
        strict=True,
    )
    texts, levels = zip(*(ending(*life) for life in lives), strict=True)
    log = rr.TextLog.columns(text=texts, level=levels)
    stream.send_columns("outcomes", time_columns(crowd.last[order], crowd.dt_s), log)


def ending(person_id: int, outcome: int, from_s: float, to_s: float) -> tuple[str, str]:
    """How a life ended, in words, and the level of the log: who never arrived is worth a look."""
    how = OUTCOMES[outcome]
    text = f"{to_s:.1f} s: person {person_id} {_ENDS[how]} {to_s - from_s:.1f} s"
    return text, "WARN" if how == "timeout" else "INFO"


def class_of(goal_area: Int[np.ndarray, " n"]) -> UInt16[np.ndarray, " n"]:
    """Class of people who walk to these goal areas: it gives them colour and label."""
    return np.where(goal_area < 0, UNKNOWN, goal_area).astype(np.uint16)


def ids(person_id: Int[np.ndarray, " n"]) -> "pa.Array":
    """Persons' numbers for `rerun.AnyValues`, which knows no type for none of them by itself."""
    import pyarrow as pa

    return pa.array(person_id, pa.int64())


def trail_steps(dt_s: float) -> int:
    """Steps that a trail is long."""
    return max(1, round(TRAIL_S / dt_s))


def trails(
    crowd: Trajectories, rows: Int[np.ndarray, " n"], first_row: Int[np.ndarray, " n"]
) -> Float32[np.ndarray, "n k 2"]:
    """The positions of the last `TRAIL_S` up to each row.

    Before the first row of the same person stands that row's position.
    """
    back = np.arange(trail_steps(crowd.dt_s), -1, -1)
    return crowd.xy[np.maximum(rows[:, None] - back, first_row[:, None])]


def observed_frames(crowd: Trajectories) -> Bool[np.ndarray, " frames"]:
    """Which frames are known."""
    known = np.zeros(crowd.frames, dtype=bool)
    for start, stop in crowd.observed.tolist():
        known[start:stop] = True
    return known


def time_columns(frame: Int[np.ndarray, " n"], dt_s: float) -> "list[TimeColumn]":
    """The two clocks of these frames: seconds and frames."""
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

    # A row without a value breaks the line.
    column = rr.Scalars.columns(scalars=value[known].astype(np.float64))
    stream.send_columns(where, time_columns(frame, dt_s), column.partition(known.astype(np.int64)))


def _log_unobserved(
    stream: "RecordingStream", where: str, known: Bool[np.ndarray, " n"], scene: Scene, dt_s: float
) -> None:
    """Say in the middle of the place when nobody observed it."""
    import rerun as rr

    turns = np.flatnonzero(np.diff(known, prepend=not known[0]))
    shown = (~known[turns]).astype(np.int64)
    middle = np.tile(np.mean(corners(scene), axis=0), (shown.sum(), 1))
    note = rr.Points2D.columns(positions=middle, labels=["not observed"] * len(middle))
    stream.send_columns(where, time_columns(turns, dt_s), note.partition(shown))
    look = rr.Points2D.from_fields(radii=0.0, colors=[[255, 255, 255]], show_labels=True)
    stream.log(where, look, static=True)
