"""Logs a scene, and a crowd over time as columns: people, trails, counts and outcomes."""

from collections.abc import Sequence

import numpy as np
import pyarrow as pa
import rerun as rr
from jaxtyping import Bool, Int, UInt16

from crowdbench.colours import goal_colour
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.registry.map_images import DARK, MapImage, map_of
from crowdbench.scene import Scene
from crowdbench.viewer import place
from crowdbench.viewer.picture import trails

WINDOW = 10
"""Number of frames per count of spawns, as in the metric `spawns_per_10_frames`."""
_SIMULATED, _COMPARED = (230, 159, 0), (150, 150, 150)  # lines in the plots
_BATCH = 500  # frames per message; the viewer shows the first ones while it loads the others
_DISC_ORDER, _TRAIL_ORDER, _PLACE_ORDER, _MAP_ORDER = 2.0, 1.0, -1.0, -2.0
_DIM = "#5A5A5A"
_ENDS = {
    "unknown": "was last seen after",
    "goal": "reached the goal after",
    "exit": "left the scene after",
    "timeout": "was removed without reaching the goal, after",
    "recorded": "left at the end of the recorded path, after",
    "horizon": "was still present at the end, after",
}


def log_place(stream: rr.RecordingStream, scene: Scene) -> None:
    """Log the scene's walls, bounds and areas, and the colours and labels of goal areas."""
    # rerun's 2D views always have y pointing downwards. A single flip at the root keeps all logged
    # coordinates, and those shown at the cursor, in metres.
    stream.log(place.WORLD, rr.Transform3D(scale=[1.0, -1.0, 1.0]), static=True)
    areas = place.areas_of(scene)
    spawns = place.dashed_areas(scene, areas) if areas else []
    goals = [areas.goal.outline(k) for k in range(len(areas.goal))] if areas else []
    classes = [(place.UNKNOWN, "goal area unknown", place.rgb(place.GREY))]
    classes += [(k, f"to goal area {k}", place.rgb(goal_colour(k))) for k in range(len(goals))]
    stream.log("/", rr.AnnotationContext(classes), static=True)

    def lines(name: str, strips: Sequence[np.ndarray], width: float, *colours: str) -> None:
        drawn = rr.LineStrips2D(
            list(strips),
            # In screen points, so that line widths do not depend on the size of the scene.
            radii=rr.Radius.ui_points(width / 2),
            colors=[place.rgb(c) for c in colours],
            draw_order=_PLACE_ORDER,
        )
        stream.log(f"{place.WORLD}/place/{name}", drawn, static=True)

    image = map_of(scene)
    if image is not None:
        _log_map(stream, image)
    lines("bounds", [_closed(place.corners(scene))], 1.0, _DIM)
    lines("walls", [_closed(wall.corners_m) for wall in scene.walls], 1.5, place.GREY)
    lines("walls/hatching", place.hatching(scene), 1.0, _DIM)
    lines("spawn_areas", spawns, 1.0, "#CCCCCC")
    lines("goal_areas", goals, 2.0, *map(goal_colour, range(len(goals))))


def _log_map(stream: rr.RecordingStream, image: MapImage) -> None:
    """Log an image of the floor below everything else. Its rows go down, from the greatest y."""
    where, b, (along, across) = f"{place.WORLD}/place/map", image.bounds, image.metres_per_pixel
    onto = rr.Transform3D(translation=[b.x_min_m, b.y_max_m, 0.0], scale=[along, -across, 1.0])
    stream.log(where, onto, static=True)
    shown = rr.EncodedImage(
        contents=image.jpeg(DARK), media_type="image/jpeg", draw_order=_MAP_ORDER
    )
    stream.log(where, shown, static=True)


def log_crowd(stream: rr.RecordingStream, side: str, crowd: Trajectories, scene: Scene) -> None:
    """Log a crowd's people and trails below `world/<side>`, one row per frame.

    In frames that were not observed, no people are drawn, and a label says so.
    """
    log_looks(stream, side, scene)
    known = crowd.is_observed()
    frame, person = crowd.row_frame(), crowd.row_person()
    rows = np.argsort(frame, kind="stable")
    rows = rows[known[frame[rows]]]
    frame, person = frame[rows], person[rows]
    where = f"{place.WORLD}/{side}"
    for start in range(0, crowd.frames, _BATCH):
        stop = min(start + _BATCH, crowd.frames)
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


def log_looks(stream: rr.RecordingStream, side: str, scene: Scene) -> None:
    """Log the style of a side's people, of their trails, and of its lines in the plots."""
    radius_m = scene.motion.person_radius_m
    disc = rr.Points2D.from_fields(radii=radius_m, show_labels=False, draw_order=_DISC_ORDER)
    stream.log(f"{place.WORLD}/{side}/people", disc, static=True)
    trail = rr.LineStrips2D.from_fields(
        radii=radius_m / 4, show_labels=False, draw_order=_TRAIL_ORDER
    )
    stream.log(f"{place.WORLD}/{side}/trails", trail, static=True)
    colour = _SIMULATED if side == place.SIMULATION else _COMPARED
    modes = rr.components.InterpolationMode
    for name, mode in (("agents", modes.Linear), ("spawns", modes.StepAfter)):
        look = rr.SeriesLines(names=side, colors=colour, widths=1.5, interpolation_mode=mode)
        stream.log(f"{name}/{side}", look, static=True)


def log_counts(stream: rr.RecordingStream, side: str, crowd: Trajectories) -> None:
    """Log agents over time and spawns per ten frames, with gaps in unobserved frames."""
    known, frame = crowd.is_observed(), np.arange(crowd.frames)
    windows = frame[::WINDOW]
    entered = np.bincount(crowd.first[crowd.entered] // WINDOW, minlength=len(windows))
    whole = np.logical_and.reduceat(known, windows)
    for name, at, values, seen in (
        ("agents", frame, crowd.present(), known),
        ("spawns", windows, entered, whole),
    ):
        # A row without a value interrupts the line.
        column = rr.Scalars.columns(scalars=values[seen].astype(np.float64))
        times = time_columns(at, crowd.dt_s)
        stream.send_columns(f"{name}/{side}", times, column.partition(seen.astype(np.int64)))


def log_outcomes(stream: rr.RecordingStream, crowd: Trajectories) -> None:
    """Log the outcome of each trip, as a line of text in its last frame."""
    order = np.argsort(crowd.last, kind="stable")
    of_trips = (crowd.person_id, crowd.outcome, crowd.first * crowd.dt_s, crowd.last * crowd.dt_s)
    trips = zip(*(values[order].tolist() for values in of_trips), strict=True)
    texts, levels = zip(*(ending(*trip) for trip in trips), strict=True)
    log = rr.TextLog.columns(text=texts, level=levels)
    stream.send_columns("outcomes", time_columns(crowd.last[order], crowd.dt_s), log)


def ending(person_id: int, outcome: int, from_s: float, to_s: float) -> tuple[str, str]:
    """Log line for the end of a trip, and its level: a warning if it ended by a timeout."""
    how = OUTCOMES[outcome]
    text = f"{to_s:.1f} s: person {person_id} {_ENDS[how]} {to_s - from_s:.1f} s"
    return text, "WARN" if how == "timeout" else "INFO"


def class_of(goal_area: Int[np.ndarray, " n"]) -> UInt16[np.ndarray, " n"]:
    """Class of people with these goal areas, which determines their colour and label."""
    return np.where(goal_area < 0, place.UNKNOWN, goal_area).astype(np.uint16)


def ids(person_id: Int[np.ndarray, " n"]) -> pa.Array:
    """Ids for `rerun.AnyValues`; typed, because no type can be inferred from no ids."""
    return pa.array(person_id, pa.int64())


def time_columns(frame: Int[np.ndarray, " n"], dt_s: float) -> list[rr.TimeColumn]:
    """The two time lines of these frames: `time` in seconds, and `frame`."""
    return [rr.TimeColumn("time", duration=frame * dt_s), rr.TimeColumn("frame", sequence=frame)]


def _log_unobserved(
    stream: rr.RecordingStream, where: str, known: Bool[np.ndarray, " n"], scene: Scene, dt_s: float
) -> None:
    """Log a label in the middle of the scene for frames that were not observed."""
    turns = np.flatnonzero(np.diff(known, prepend=not known[0]))
    shown = (~known[turns]).astype(np.int64)
    middle = np.tile(np.mean(place.corners(scene), axis=0), (shown.sum(), 1))
    note = rr.Points2D.columns(positions=middle, labels=["not observed"] * len(middle))
    stream.send_columns(where, time_columns(turns, dt_s), note.partition(shown))
    look = rr.Points2D.from_fields(radii=0.0, colors=[[255, 255, 255]], show_labels=True)
    stream.log(where, look, static=True)


def _closed(polygon: Sequence[tuple[float, float]]) -> np.ndarray:
    return np.array([*polygon, polygon[0]])
