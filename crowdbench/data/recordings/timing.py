"""Conversion of a recording from any rate to the frames of a scene.

The frames of a scene are about 0.4 s apart: shorter intervals increase computing time and the
effect of camera jitter. Of a recording with a higher rate, every k-th frame is kept, but entry
times keep the resolution of the recording.

Annotators pause. If people vanish or appear in the middle of the scene at the edges of a run of
empty frames, the annotation paused there. Such a gap is *unobserved*: the crowd is unknown, and the
people at its edges have neither left nor entered.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from crowdbench.data.table import Flags, Points, Trajectories, from_rows
from crowdbench.errors import RecordingError

USUAL_DT_S = 0.4
LONGEST_DT_S = 1.0
FINEST_GRID_S = 0.1
"""Smallest step of the annotation grid, seconds. On a finer grid, people who enter together would
have different arrival times."""
NEIGHBOURHOOD_M = 1.0
USUAL_SHARE = 0.1


def checked_dt_s(where: object, stated_s: float | None, asked_s: float | None) -> float:
    """Time between consecutive rows of a person, seconds, from the file or from the user.

    `stated_s` is the value that the file states, `asked_s` that of the option `--dt-s`.

    Raises:
        RecordingError: the two differ, neither is known, or the time is not positive or too long
            to follow people.
    """
    dt_s = stated_s if stated_s is not None else asked_s
    if dt_s is None:
        got = "a file that does not state the time between rows"
        hint = "It is the time between consecutive rows of a person."
        raise RecordingError(where, got=got, expected="--dt-s SECONDS", hint=hint)
    if stated_s is not None and asked_s is not None and not np.isclose(stated_s, asked_s, 0.05):
        got = f"rows every {stated_s:.4g} s according to the file"
        expected = f"rows every {asked_s:g} s, as set by --dt-s"
        hint = "Correct --dt-s, or the file if it is wrong."
        raise RecordingError(where, got=got, expected=expected, hint=hint)
    if not 0 < dt_s <= LONGEST_DT_S:
        expected = f"an interval of more than 0 and at most {LONGEST_DT_S:g} s"
        hint = "If rows are further apart, the paths between them are unknown."
        raise RecordingError(where, got=f"rows every {dt_s:g} s", expected=expected, hint=hint)
    return dt_s


def plain_positions(crowd: Trajectories) -> list[list[float]]:
    """Positions (R rows of x, y) as numbers with the fewest digits that identify each float32."""
    return crowd.xy.astype(str).astype(np.float64).tolist()


def at_scene_frames(crowd: Trajectories, *, pauses: bool, where: object) -> Trajectories:
    """Convert a recording to the frames of a scene, which are about 0.4 s apart.

    The result begins with the first row and ends with the last. Every k-th frame is kept, with k
    such that the interval is as close to 0.4 s as possible. `spawn_s` is unchanged; the annotation
    grid is that of the rows, or that of the frames if rows are less than 0.1 s apart. People who
    have no row in a kept frame are left out. With `pauses`, pauses of the annotation become
    unobserved; see `observed_intervals`.

    Raises:
        RecordingError: no row is in a kept frame.
    """
    every = max(1, round(USUAL_DT_S / crowd.dt_s))
    begin, person = crowd.first.min(), crowd.row_person()
    frame = crowd.row_frame() - begin
    kept = frame % every == 0
    if not kept.any():
        raise RecordingError(
            where, got="no row in any frame of the scene", expected="at least one row in a frame"
        )
    dt_s = crowd.dt_s * every
    grid_s = crowd.grid_s if every == 1 or crowd.grid_s >= FINEST_GRID_S else dt_s
    persons = {
        "spawn_s": np.maximum(0.0, crowd.spawn_s - begin * crowd.dt_s),
        "entered": crowd.entered,
        "left": crowd.left,
        "group": crowd.group,
    }
    notes = dict(crowd.provenance.get("notes", {}))
    if every > 1:
        notes["rows"] = f"every {crowd.dt_s:.4g} s, of which 1 in {every} is kept"
        if lost := len(crowd) - len(np.unique(person[kept])):
            notes["left out"] = f"{lost} persons who are present only between two kept rows"
    thinned = from_rows(
        scene=crowd.scene,
        dt_s=dt_s,
        grid_s=grid_s,
        person_id=crowd.person_id[person[kept]],
        frame=frame[kept] // every,
        xy=crowd.xy[kept].astype(np.float64),
        persons={name: values[person[kept]] for name, values in persons.items()},
        provenance={**crowd.provenance, "notes": notes},
        where=where,
    )
    return with_pauses(thinned) if pauses else thinned


def with_pauses(crowd: Trajectories) -> Trajectories:
    """The recording with its pauses unobserved, and people at their edges neither left nor entered.

    Whom the recording itself states as not `entered` or not `left` remains so.
    """
    known = crowd.observed_in(observed_intervals(crowd))
    return replace(known, entered=known.entered & crowd.entered, left=known.left & crowd.left)


def observed_intervals(crowd: Trajectories) -> Int[np.ndarray, "I 2"]:
    """Find the observed intervals [start, stop), in frames, of a recording.

    A run of empty frames is unobserved if a track ends mid-scene in the frame before it, or starts
    mid-scene in the frame after it. A place is *mid-scene* if people pass there but rarely start
    (end) there: of the persons who come within 1 m of it, fewer than 10 % start (end) there.
    Starts (ends) at the edges of a pause are not counted.
    """
    present = crowd.present() > 0
    edges = np.flatnonzero(np.diff(present.astype(np.int8)))
    before, after = edges[::2], edges[1::2] + 1  # last frame before and first after each pause
    starts_at_edge = np.isin(crowd.first, np.r_[0, after])
    ends_at_edge = np.isin(crowd.last, np.r_[before, crowd.frames - 1])
    born_mid = starts_at_edge & _unusual(crowd.start, ~starts_at_edge, crowd)
    died_mid = ends_at_edge & _unusual(crowd.end, ~ends_at_edge, crowd)

    intervals, start = [], 0
    for last_before, first_after in zip(before, after, strict=True):
        unobserved = died_mid[crowd.last == last_before].any() or (
            born_mid[crowd.first == first_after].any()
        )
        if unobserved:
            intervals.append((start, last_before + 1))
            start = first_after
    intervals.append((start, crowd.frames))
    return np.array(intervals, dtype=np.int64)


def _unusual(points: Points, usual: Flags, crowd: Trajectories) -> Flags:
    """Whether each person's start (end) is a place where people pass but rarely start (end)."""
    person = crowd.row_person()
    result = np.zeros(len(points), dtype=bool)
    for p in np.flatnonzero(~usual):
        close = np.linalg.norm(crowd.xy - points[p], axis=1) <= NEIGHBOURHOOD_M
        passing = len(np.unique(person[close]))
        starting = (np.linalg.norm(points[usual] - points[p], axis=1) <= NEIGHBOURHOOD_M).sum()
        result[p] = starting / passing < USUAL_SHARE
    return result
