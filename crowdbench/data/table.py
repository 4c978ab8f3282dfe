"""`Trajectories`: the common table of recordings, rollouts and the output of other simulators.

Metrics, figures, leaderboard and viewer use only this table. Each position belongs to a frame of
the scene (one every `dt_s` seconds); the frames of a person have no gaps.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Shaped

from crowdbench.errors import RecordingError

OUTCOMES = ("unknown", "goal", "exit", "timeout", "recorded", "horizon")
"""How a trip ended; a person's `outcome` is an index into this tuple."""

PERSON_COLUMNS = {
    "spawn_area": np.int32,
    "goal_area": np.int32,
    "group": np.int32,
    "goal_x": np.float32,
    "goal_y": np.float32,
    "entered": np.bool_,
    "left": np.bool_,
    "requested_s": np.float64,
    "spawn_s": np.float64,
    "outcome": np.int8,
}

Numbers = Float[np.ndarray, " n"]
Indices = Int[np.ndarray, " n"]
Flags = Bool[np.ndarray, " n"]
Points = Float[np.ndarray, "n 2"]
"""Kinds of arrays of `n` people or places."""
MAX_FRAMES = 10_000_000
"""Maximum length, about six weeks of 0.4 s frames; longer tables are errors and exceed memory."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Trajectories:
    """A crowd over time: `P` persons, `R` rows (one per person and frame), `I` observed intervals.

    Persons are sorted by first frame, then requested entry time, then id; rows by person, then
    frame.
    """

    scene: str
    """Id of the scene or name of the recording."""
    dt_s: float
    """Seconds from one frame to the next."""
    grid_s: float
    """Step of the grid on which arrivals were annotated, seconds."""
    frames: int
    """Length in frames; frames are numbered from 0."""
    observed: Int[np.ndarray, "I 2"]
    """Observed intervals [start, stop) in frames; the crowd is unknown outside them."""
    person_id: Int[np.ndarray, " P"]
    first: Int[np.ndarray, " P"]
    """Frame of each person's first row."""
    offsets: Int[np.ndarray, " P+1"]
    """Rows of person p are `xy[offsets[p]:offsets[p + 1]]`, one per frame from `first[p]` on."""
    xy: Float32[np.ndarray, "R 2"]
    """Positions in metres."""
    spawn_area: Int[np.ndarray, " P"]
    """Index of the area where the person entered; −1 if unknown."""
    goal_area: Int[np.ndarray, " P"]
    """Index of the area that the person walks to; −1 if unknown."""
    group: Int[np.ndarray, " P"]
    """Index of the group that the person walks with; −1 if alone or unknown. For recordings, see
    `crowdbench.data.companions`."""
    goal_x: Float32[np.ndarray, " P"]
    """x coordinate of the goal, metres; the last position if the goal is unknown."""
    goal_y: Float32[np.ndarray, " P"]
    """y coordinate of the goal, metres."""
    entered: Bool[np.ndarray, " P"]
    """False for people who were already present when observation began."""
    left: Bool[np.ndarray, " P"]
    """False for people who were still present when observation ended (right-censored)."""
    requested_s: Float[np.ndarray, " P"]
    """Entry time that the spawn model requested, seconds from frame 0."""
    spawn_s: Float[np.ndarray, " P"]
    """Actual entry time: `requested_s` plus the time spent waiting for free space, seconds."""
    outcome: Int[np.ndarray, " P"]
    """Index into `OUTCOMES`."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    """Origin of the table: source and hash, or scene, models and seed."""

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

    @property
    def goal(self) -> Float32[np.ndarray, "P 2"]:
        """Where each person walks to, metres."""
        return np.stack([self.goal_x, self.goal_y], axis=1)

    def path(self, person: int) -> Float32[np.ndarray, "n 2"]:
        """Positions of the person at index `person`, one per frame from `first[person]` on."""
        return self.xy[self.offsets[person] : self.offsets[person + 1]]

    def row_person(self) -> Int[np.ndarray, " R"]:
        """Index of the person of each row."""
        return np.repeat(np.arange(len(self)), np.diff(self.offsets))

    def row_frame(self) -> Int[np.ndarray, " R"]:
        """Frame of each row."""
        within = np.arange(len(self.xy)) - np.repeat(self.offsets[:-1], np.diff(self.offsets))
        return np.repeat(self.first, np.diff(self.offsets)) + within

    def present(self) -> Int[np.ndarray, " frames"]:
        """N(t): the number of persons in each frame, including empty frames."""
        came = np.bincount(self.first, minlength=self.frames + 1)
        gone = np.bincount(self.last + 1, minlength=self.frames + 1)
        return np.cumsum(came - gone)[: self.frames]

    def is_observed(self) -> Bool[np.ndarray, " frames"]:
        """Whether each frame was observed."""
        return is_within(self.observed, self.frames)

    def observed_in(self, observed: Int[np.ndarray, "I 2"]) -> "Trajectories":
        """The same crowd with other observed intervals; `entered` and `left` are set accordingly.

        People whose first row is in the first frame of an interval have not `entered`; people
        whose last row is in its last frame have not `left`.
        """
        return replace(
            self,
            observed=observed,
            entered=~np.isin(self.first, observed[:, 0]),
            left=~np.isin(self.last, observed[:, 1] - 1),
        )

    def path_lengths(self) -> Float[np.ndarray, " P"]:
        """Path length of each person, metres."""
        x, y = np.diff(self.xy.astype(np.float64), axis=0).T
        steps = np.sqrt(x * x + y * y)
        person = self.row_person()
        same = np.diff(person) == 0
        lengths = np.bincount(person[1:][same], steps[same], minlength=len(self))
        return lengths.astype(np.float64)  # without any step, bincount returns integers

    def mean_speeds(self) -> Float[np.ndarray, " P"]:
        """Mean speed of each person, m/s: path length over duration; NaN for a single row."""
        with np.errstate(invalid="ignore"):
            return self.path_lengths() / ((self.last - self.first) * self.dt_s)


def is_within(intervals: Int[np.ndarray, "I 2"], frames: int) -> Bool[np.ndarray, " frames"]:
    """Whether each of the first `frames` frames lies in one of the `intervals` [start, stop)."""
    within = np.zeros(frames, dtype=bool)
    for start, stop in intervals.tolist():
        within[start:stop] = True
    return within


def integers(
    values: Shaped[np.ndarray, " R"], column: str, where: object, kind: type = np.int64
) -> Int[np.ndarray, " R"]:
    """A column of a table as integers of the type `kind`.

    Raises:
        RecordingError: a value is no such integer; `where` names the source in the message.
    """
    bits = np.iinfo(kind).bits
    right = (np.abs(values) < 2.0 ** (bits - 1)) & (values == np.floor(values))  # false for NaN
    if not right.all():
        row = int(right.argmin())
        got = f"{column} {values[row]} in row {row + 1}"
        raise RecordingError(where, got=got, expected=f"integers of {bits} bits in column {column}")
    return values.astype(kind)


def interpolated(
    at: Shaped[np.ndarray, " n"], known: Shaped[np.ndarray, " k"], xy: Shaped[np.ndarray, "k 2"]
) -> Float[np.ndarray, "n 2"]:
    """Positions at the times `at`, linear between the positions `xy` at ascending times `known`."""
    return np.stack([np.interp(at, known, xy[:, k]) for k in (0, 1)], axis=1)


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

    Frames missing within a person are filled by linear interpolation. `persons` holds further
    columns by name, each with one value per row. Without the columns `entered` and `left`, people
    in the first frame of an observed interval have not `entered`, and people in its last frame
    have not `left`.

    Raises:
        RecordingError: no rows, values that are not finite, frames outside [0, `frames`), or a
            person twice in one frame. `where` names the source in the message.
    """
    if len(frame) == 0:
        raise RecordingError(where, got="no rows", expected="at least one row")
    finite = (np.abs(xy) < np.finfo(np.float32).max).all(axis=1)  # false for NaN
    if not finite.all():
        row = int(finite.argmin())
        raise RecordingError(
            where,
            got=f"{int((~finite).sum())} rows whose position is not finite, the first for person "
            f"{person_id[row]} in frame {frame[row]}",
            expected="finite x and y in metres",
            hint="Remove these rows or correct them in the source.",
        )
    length = int(frame.max()) + 1 if frames is None else frames
    if length > MAX_FRAMES:
        got = f"{length} frames"
        hint = "Number the frames of the scene from 0, not milliseconds or video frames."
        raise RecordingError(where, got=got, expected=f"at most {MAX_FRAMES}", hint=hint)
    if frame.min() < 0 or frame.max() >= length:
        got = f"frames {frame.min()} to {frame.max()}"
        hint = "Number frames from 0, and remove rows after the end."
        raise RecordingError(where, got=got, expected=f"frames from 0 to {length - 1}", hint=hint)

    order = np.lexsort((frame, person_id))
    ids, frame, xy = person_id[order], frame[order], xy[order].astype(np.float32)
    twice = (np.diff(ids) == 0) & (np.diff(frame) == 0)
    if twice.any():
        row = int(twice.argmax())
        got = f"person {ids[row]} twice in frame {frame[row]} ({int(twice.sum())} such rows)"
        expected = "one position per person and frame"
        hint = "Remove the duplicates, or give each person a separate id."
        raise RecordingError(where, got=got, expected=expected, hint=hint)

    begins = np.flatnonzero(np.r_[True, np.diff(ids) != 0])
    ends = np.r_[begins[1:], len(ids)]
    first, last, goal = frame[begins], frame[ends - 1], xy[ends - 1]
    if observed is None:
        observed = np.array([[0, length]])
    of_person = order[begins]
    given = {k: np.asarray(v)[of_person] for k, v in (persons or {}).items() if k in PERSON_COLUMNS}
    spawn_s = given.get("spawn_s", first * dt_s)
    columns: dict[str, np.ndarray] = {
        **dict.fromkeys(("spawn_area", "goal_area", "group"), np.full(len(first), -1)),
        "goal_x": goal[:, 0],
        "goal_y": goal[:, 1],
        "entered": ~np.isin(first, observed[:, 0]),
        "left": ~np.isin(last, observed[:, 1] - 1),
        "spawn_s": spawn_s,
        "requested_s": spawn_s,  # people who did not wait entered when requested
        "outcome": np.zeros(len(first)),
        **given,
    }
    by_entry = np.lexsort((ids[begins], columns["requested_s"], first))
    pieces = []
    for p in by_entry:
        known, every = slice(begins[p], ends[p]), np.arange(first[p], last[p] + 1)
        piece = xy[known]
        if len(piece) < len(every):
            piece = interpolated(every, frame[known], piece).astype(np.float32)
        pieces.append(piece)
    return Trajectories(
        scene=scene,
        dt_s=dt_s,
        grid_s=dt_s if grid_s is None else grid_s,
        frames=length,
        observed=observed,
        person_id=ids[begins][by_entry],
        first=first[by_entry],
        offsets=np.concatenate([[0], np.cumsum((last - first + 1)[by_entry])]),
        xy=np.concatenate(pieces),
        provenance=dict(provenance or {}),
        **{name: columns[name][by_entry].astype(kind) for name, kind in PERSON_COLUMNS.items()},
    )
