"""From rows at any rate to the frames of a scene.

A scene has frames about 0.4 s apart: closer ones cost time and show how a camera jitters. A
recording with more rows a second keeps every k-th of them, and of the others when people came.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from crowdbench.errors import RecordingError
from crowdbench.recordings.gaps import observed_intervals
from crowdbench.trajectories.table import Trajectories, from_rows

USUAL_DT_S = 0.4
LONGEST_DT_S = 1.0
FINEST_GRID_S = 0.1
"""On a finer grid of arrivals people who come together would not come at the same time."""


def usual_step(person: Int[np.ndarray, " R"], frame: Int[np.ndarray, " R"]) -> int:
    """The most frequent interval between two rows of a person, in the numbers of its frames."""
    order = np.lexsort((frame, person))
    steps = np.diff(frame[order])[np.diff(person[order]) == 0]
    steps = steps[steps > 0]
    return int(np.bincount(np.minimum(steps, 10**6)).argmax()) if len(steps) else 1


def checked_dt_s(where: object, stated_s: float | None, asked_s: float | None) -> float:
    """Seconds from row to row: what a file states and what the user says must agree.

    Raises:
        RecordingError: they do not, neither is known, or it is no time that people can be
            followed with.
    """
    dt_s = stated_s if stated_s is not None else asked_s
    if dt_s is None:
        raise RecordingError(
            where,
            got="no word of the time from one row to the next",
            expected="--dt-s SECONDS",
            hint="It is the time from one row of a person to the next.",
        )
    if stated_s is not None and asked_s is not None and not np.isclose(stated_s, asked_s, 0.05):
        raise RecordingError(
            where,
            got=f"rows every {stated_s:.4g} s by the file itself",
            expected=f"every {asked_s:g} s, as asked by --dt-s",
            hint="Correct --dt-s, or the file if it is what is wrong.",
        )
    if not 0 < dt_s <= LONGEST_DT_S:
        raise RecordingError(
            where,
            got=f"rows every {dt_s:g} s",
            expected=f"more than 0 and at most {LONGEST_DT_S:g} s",
            hint="Between rows that far apart nobody knows how people walked.",
        )
    return dt_s


def plain_positions(crowd: Trajectories) -> list[list[float]]:
    """Positions with as few digits as tell float32 numbers apart, to be written as text."""
    return crowd.xy.astype(str).astype(np.float64).tolist()


def at_scene_frames(crowd: Trajectories, *, pauses: bool, where: object) -> Trajectories:
    """A recording as a scene needs it: frames about 0.4 s apart, pauses told from empty scenes.

    It begins with its first row and ends with its last. Every k-th frame is kept, k the whole
    number that comes nearest to 0.4 s; `spawn_s` stays where it was, on a grid of the rows, or
    of the frames where rows are closer than 0.1 s. Who is there between two frames only is left
    out. With `pauses`, empty times are told from unobserved ones; see `gaps.observed_intervals`.

    Raises:
        RecordingError: nobody is left.
    """
    every = max(1, round(USUAL_DT_S / crowd.dt_s))
    begin, person = crowd.first.min(), crowd.row_person()
    frame = crowd.row_frame() - begin
    kept = frame % every == 0
    if not kept.any():
        raise RecordingError(where, got="no row in any frame", expected="people who stay a while")
    dt_s = crowd.dt_s * every
    grid_s = crowd.grid_s if every == 1 or crowd.grid_s >= FINEST_GRID_S else dt_s
    persons = {
        "spawn_s": np.maximum(0.0, crowd.spawn_s - begin * crowd.dt_s),
        "entered": crowd.entered,
        "left": crowd.left,
    }
    thinned = from_rows(
        scene=crowd.scene,
        dt_s=dt_s,
        grid_s=grid_s,
        person_id=crowd.person_id[person[kept]],
        frame=frame[kept] // every,
        xy=crowd.xy[kept].astype(np.float64),
        persons={name: values[person[kept]] for name, values in persons.items()},
        provenance=crowd.provenance,
        where=where,
    )
    known = thinned.observed_in(observed_intervals(thinned)) if pauses else thinned
    entered, left = known.entered & thinned.entered, known.left & thinned.left
    notes = dict(crowd.provenance.get("notes", {}))
    if every > 1:
        notes["rows"] = f"every {crowd.dt_s:.4g} s, of which each {every}th is kept"
        if lost := len(crowd) - len(known):
            notes["left out"] = f"{lost} persons who are there between two kept rows only"
    provenance = {**crowd.provenance, "notes": notes}
    return replace(known, entered=entered, left=left, provenance=provenance)
