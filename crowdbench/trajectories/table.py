"""`Trajectories`: the one table that recordings, rollouts and other simulators' crowds share.

Metrics, figures, leaderboard and viewer see only this. Positions stand on the frames of the
scene (one every `dt_s`); within a person the frames have no gap.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.errors import RecordingError

OUTCOMES = ("unknown", "goal", "exit", "timeout", "recorded", "horizon")
"""How a life ended; a person's `outcome` is an index into this tuple."""

PERSON_COLUMNS = {
    "spawn_area": np.int32,
    "goal_area": np.int32,
    "entered": np.bool_,
    "left": np.bool_,
    "requested_s": np.float64,
    "spawn_s": np.float64,
    "outcome": np.int8,
}


MAX_FRAMES = 10_000_000
"""Six weeks of 0.4 s frames: a longer table is a mistake, and would not fit into memory."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectories:
    """A crowd over time: `P` persons, `R` rows (one per person and frame), `I` observed intervals.

    Persons are sorted by first frame, then requested entry, then id; rows by person, then frame.
    """

    scene: str
    """Id of the scene or name of the recording."""
    dt_s: float
    """Seconds from one frame to the next."""
    grid_s: float
    """Seconds of the grid on which arrivals were annotated."""
    frames: int
    """Length in frames; frames count from 0."""
    observed: Int[np.ndarray, "I 2"]
    """Observed intervals [start, stop) in frames. Outside them nothing is known."""
    person_id: Int[np.ndarray, " P"]
    first: Int[np.ndarray, " P"]
    """Frame of each person's first row."""
    offsets: Int[np.ndarray, " P+1"]
    """Rows of person p are `xy[offsets[p]:offsets[p + 1]]`, one a frame from `first[p]` on."""
    xy: Float32[np.ndarray, "R 2"]
    """Positions in metres."""
    spawn_area: Int[np.ndarray, " P"]
    """Index of the area where the person entered, −1 unknown."""
    goal_area: Int[np.ndarray, " P"]
    """Index of the area that the person walks to, −1 unknown."""
    entered: Bool[np.ndarray, " P"]
    """False for those who were there when observation began."""
    left: Bool[np.ndarray, " P"]
    """False for those who were still there when observation ended (right-censored)."""
    requested_s: Float[np.ndarray, " P"]
    """When the spawn model let the person in, seconds from frame 0."""
    spawn_s: Float[np.ndarray, " P"]
    """When the person did enter: `requested_s` plus the time spent waiting for free space."""
    outcome: Int[np.ndarray, " P"]
    """Index into `OUTCOMES`."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Where the table comes from: source and hash, or scene, models and seed."""

    def __len__(self) -> int:
        return len(self.person_id)

    def __repr__(self) -> str:
        return (
            f"Trajectories({self.scene!r}, {len(self)} persons, "
            f"{self.frames} frames of {self.dt_s:g} s)"
        )

    @property
    def last(self) -> Int[np.ndarray, " P"]:
        """Frame of each person's last row."""
        return self.first + np.diff(self.offsets) - 1

    @property
    def duration_s(self) -> float:
        """Length in seconds, unobserved intervals included."""
        return self.frames * self.dt_s

    @property
    def start(self) -> Float32[np.ndarray, "P 2"]:
        """Each person's first position, metres."""
        return self.xy[self.offsets[:-1]]

    @property
    def end(self) -> Float32[np.ndarray, "P 2"]:
        """Each person's last position, metres."""
        return self.xy[self.offsets[1:] - 1]

    def path(self, person: int) -> Float32[np.ndarray, "n 2"]:
        """Positions of the person at index `person`, one a frame from `first[person]` on."""
        return self.xy[self.offsets[person] : self.offsets[person + 1]]

    def row_person(self) -> Int[np.ndarray, " R"]:
        """Index of the person of each row."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    def row_frame(self) -> Int[np.ndarray, " R"]:
        """Frame of each row."""
        within = np.arange(len(self.xy)) - np.repeat(self.offsets[:-1], np.diff(self.offsets))
        return np.repeat(self.first, np.diff(self.offsets)) + within

    def present(self) -> Int[np.ndarray, " frames"]:
        """N(t): the number of persons in each frame, zeros included."""
        return np.bincount(self.row_frame(), minlength=self.frames)

    def observed_in(self, observed: Int[np.ndarray, "I 2"]) -> "Trajectories":
        """The same crowd, known in these intervals only.

        Who is there in the first frame of one has not `entered`, who is there in its last frame
        has not `left`.
        """
        return replace(
            self,
            observed=observed,
            entered=~np.isin(self.first, observed[:, 0]),
            left=~np.isin(self.last, observed[:, 1] - 1),
        )

    def path_lengths(self) -> Float[np.ndarray, " P"]:
        """Metres that each person walks."""
        steps = np.linalg.norm(np.diff(self.xy.astype(np.float64), axis=0), axis=1)
        person = self.row_person()
        same = np.diff(person) == 0
        lengths = np.bincount(person[1:][same], steps[same], minlength=len(self))
        return lengths.astype(np.float64)  # of no step at all numpy makes integers

    def mean_speeds(self) -> Float[np.ndarray, " P"]:
        """Path length over life, m/s; NaN for a life of a single row."""
        with np.errstate(invalid="ignore"):
            return self.path_lengths() / ((self.last - self.first) * self.dt_s)


def from_rows(
    *,
    scene: str,
    dt_s: float,
    person_id: Int[np.ndarray, " R"],
    frame: Int[np.ndarray, " R"],
    xy: Float[np.ndarray, "R 2"],
    where: object,
    grid_s: float | None = None,
    frames: int | None = None,
    observed: Int[np.ndarray, "I 2"] | None = None,
    persons: Mapping[str, np.ndarray] | None = None,
    provenance: Mapping[str, Any] | None = None,
) -> Trajectories:
    """Build the table from one row per person and frame, in any order.

    Frames missing within a person are filled by linear interpolation. Who is there in the first
    frame of an observed interval has not `entered`; who is there in its last has not `left`,
    unless `persons` (columns by name, each of one value per row) says otherwise.

    Raises:
        RecordingError: no rows, values that are not finite, frames outside [0, `frames`), or a
            person twice in one frame. `where` names the place in the message.
    """
    if len(frame) == 0:
        raise RecordingError(where, got="no rows", expected="at least one row")
    finite = (np.abs(xy) < np.finfo(np.float32).max).all(axis=1)  # false for NaN
    if not finite.all():
        row = int(np.flatnonzero(~finite)[0])
        raise RecordingError(
            where,
            got=f"{int((~finite).sum())} rows whose position is not finite, the first at person "
            f"{person_id[row]}, frame {frame[row]}",
            expected="finite x and y in metres",
            hint="Remove these rows or repair them at the source.",
        )
    length = int(frame.max()) + 1 if frames is None else frames
    if length > MAX_FRAMES:
        raise RecordingError(
            where,
            got=f"{length} frames",
            expected=f"{MAX_FRAMES} at most",
            hint="Count frames of the scene from 0 on, not milliseconds or video frames.",
        )
    if frame.min() < 0 or frame.max() >= length:
        raise RecordingError(
            where,
            got=f"frames {frame.min()} to {frame.max()}",
            expected=f"frames from 0 to {length - 1}",
            hint="Count frames from the first one, and cut what runs past the end.",
        )

    order = np.lexsort((frame, person_id))
    ids, frame, xy = person_id[order], frame[order], xy[order].astype(np.float32)
    twice = (np.diff(ids) == 0) & (np.diff(frame) == 0)
    if twice.any():
        row = int(np.flatnonzero(twice)[0])
        raise RecordingError(
            where,
            got=f"person {ids[row]} twice in frame {frame[row]} ({int(twice.sum())} such rows)",
            expected="one position per person and frame",
            hint="Remove the duplicates, or give each person an id of its own.",
        )

    begins = np.flatnonzero(np.r_[True, np.diff(ids) != 0])
    requested_s = frame[begins] * dt_s
    for name in ("spawn_s", "requested_s"):  # who did not wait asked when it entered
        if persons and name in persons:
            requested_s = np.asarray(persons[name])[order[begins]]
    by_entry = np.lexsort((ids[begins], requested_s, frame[begins]))
    counts = np.diff(np.r_[begins, len(ids)])
    first, last = frame[begins], frame[begins + counts - 1]
    pieces, sizes = [], []
    for p in by_entry:
        known = slice(begins[p], begins[p] + counts[p])
        piece = xy[known]
        if counts[p] != last[p] - first[p] + 1:
            every = np.arange(first[p], last[p] + 1)
            piece = np.stack([np.interp(every, frame[known], piece[:, k]) for k in (0, 1)], axis=1)
        pieces.append(piece.astype(np.float32))
        sizes.append(len(piece))
    first, last = first[by_entry], last[by_entry]

    if observed is None:
        observed = np.array([[0, length]])
    grid = dt_s if grid_s is None else grid_s
    columns: dict[str, np.ndarray] = {
        "spawn_area": np.full(len(first), -1),
        "goal_area": np.full(len(first), -1),
        "entered": ~np.isin(first, observed[:, 0]),
        "left": ~np.isin(last, observed[:, 1] - 1),
        "spawn_s": first * dt_s,
        "outcome": np.zeros(len(first)),
    }
    rows_of_persons = order[begins][by_entry]
    for name, values in (persons or {}).items():
        if name in PERSON_COLUMNS:
            columns[name] = np.asarray(values)[rows_of_persons]
    columns.setdefault("requested_s", columns["spawn_s"])
    return Trajectories(
        scene=scene,
        dt_s=dt_s,
        grid_s=grid,
        frames=length,
        observed=observed,
        person_id=ids[begins][by_entry],
        first=first,
        offsets=np.concatenate([[0], np.cumsum(sizes)]),
        xy=np.concatenate(pieces),
        provenance=dict(provenance or {}),
        **{name: columns[name].astype(kind) for name, kind in PERSON_COLUMNS.items()},
    )
