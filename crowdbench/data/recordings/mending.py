"""Repairs small faults of recordings: missing rows within a trip, and rows between two frames.

The true positions are unknown there, so such recordings are rejected unless the user chooses how to
repair them. The message names the first affected person and frame. All repairs are listed in the
notes of the imported table.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int, Shaped

from crowdbench.data.table import MAX_FRAMES, Flags, Indices, Trajectories, from_rows, interpolated
from crowdbench.errors import RecordingError

Gaps = Literal["interpolate", "split"]
"""How missing rows are repaired: by linear interpolation, or by splitting the person into two."""

_MISSING = 1.5
"""Intervals of at least this many steps are gaps; shorter ones begin or end at a row between two
frames."""
_BESIDE = {"frame": 1e-6, "s": 0.05}
"""A row lies between two frames if it is further than this from a frame, in steps. Frame numbers
are exact, times are not."""
_SHOWN = 3
LONGEST_GAP_S = 2.0
"""Longest gap that is interpolated. In longer ones people may do anything, and trackers that lose a
person give the number to another one."""
_MOST_FILLED = 0.2
"""Largest number of rows that are interpolated, as a share of the real ones."""
_FEW_FILLED = 10
"""So many rows may be interpolated in any recording."""
FEW = (
    "If only a few rows are affected, use --gaps interpolate to fill them in linearly, or --gaps "
    "split to split a person into two where rows are missing."
)


@dataclass(frozen=True, eq=False)
class Stamped:
    """Rows as in a file, in any order, with time stamps that are frame numbers or times."""

    person: Int[np.ndarray, " R"]
    values: Shaped[np.ndarray, " R"]
    """Time stamp of each row: video frame number or seconds."""
    xy: Float[np.ndarray, "R 2"]
    unit: Literal["frame", "s"]
    step: float
    """Interval from one row of a person to the next, in `unit`."""
    origin: float = 0.0
    """Value at the first frame of the scene, in `unit`."""

    @classmethod
    def of_frames(
        cls,
        person: Int[np.ndarray, " R"],
        frame: Int[np.ndarray, " R"],
        xy: Float[np.ndarray, "R 2"],
        origin: float = 0.0,
    ) -> "Stamped":
        """Rows with frame numbers whose step is the most frequent one within a person."""
        order = np.lexsort((frame, person))
        steps = np.diff(frame[order])[np.diff(person[order]) == 0]
        counts = np.bincount(np.minimum(steps[steps > 0], 10**6), minlength=2)
        return cls(person, frame, xy, "frame", float(counts.argmax() or 1), origin)

    def ticks(self) -> Float[np.ndarray, " R"]:
        """Time of each row in steps since the first frame of the scene."""
        return (self.values - self.origin) / self.step

    def stamp(self, row: int | np.integer) -> str:
        """The time stamp of a row as text, such as `frame 12` or `4.8 s`."""
        value = self.values[row]
        return f"frame {value:.0f}" if self.unit == "frame" else f"{round(value, 4):.14g} s"

    def named(self, row: int | np.integer, at: str = "at") -> str:
        """A row as text, such as `person 3 at frame 12`."""
        return f"person {self.person[row]} {at} {self.stamp(row)}"

    def long(self, steps: float) -> str:
        """A duration in steps as text, such as `10 frames` or `0.4 s`."""
        length = f"{steps * self.step:.10g}"
        return f"{length} s" if self.unit == "s" else f"{length} frame{'s' * (length != '1')}"


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows on the frames of a scene, one per person and frame, none missing within a trip."""

    person: Int[np.ndarray, " R"]
    frame: Int[np.ndarray, " R"]
    xy: Float[np.ndarray, "R 2"]
    source: Int[np.ndarray, " R"]
    """Index of an input row of the same person."""
    continued: dict[int, int]
    """Persons who were split, and the new number under which each goes on."""
    notes: dict[str, str]
    """The repairs, as text for a table."""

    def crowd(
        self,
        *,
        scene: str,
        dt_s: float,
        where: object,
        columns: Mapping[str, np.ndarray] | None = None,
    ) -> Trajectories:
        """The `Trajectories` of these rows.

        `columns` are columns of persons by name, with one value per input row. A person that was
        split into two has neither left nor entered at the gap.

        Raises:
            RecordingError: see `from_rows`.
        """
        persons = {name: np.asarray(of)[self.source] for name, of in (columns or {}).items()}
        for name in {"spawn_s", "requested_s"} & set(persons):
            persons[name] = persons[name].astype(np.float64)
            for new in self.continued.values():
                mine = self.person == new
                persons[name][mine] = self.frame[mine].min(initial=MAX_FRAMES) * dt_s
        crowd = from_rows(
            scene=scene,
            dt_s=dt_s,
            person_id=self.person,
            frame=self.frame,
            xy=self.xy,
            persons=persons,
            provenance={"notes": self.notes} if self.notes else {},
            where=where,
        )
        return replace(
            crowd,
            entered=crowd.entered & ~np.isin(crowd.person_id, [*self.continued.values()]),
            left=crowd.left & ~np.isin(crowd.person_id, [*self.continued]),
        )


def on_frames(
    rows: Stamped, *, gaps: Gaps | None, dt_s: float, where: object, hint: str = FEW
) -> Rows:
    """Assign rows to the frames of a scene, and repair faults as `gaps` says.

    Frame numbers are rounded down, because each person may have a different phase (annotators
    shift it at pauses). Times must be multiples of the step.

    With `interpolate`, missing rows are interpolated linearly. With `split`, and in gaps longer
    than 2 s (steps are `dt_s` long), the person ends at the gap and continues as another person
    with a new number. With both, rows between two frames are replaced by positions at the frames,
    interpolated linearly in time. With None, recordings with faults are rejected.

    Raises:
        RecordingError: a person has two rows at the same time; or rows are missing or between two
            frames, and `gaps` is None, most rows are affected, or more than 20 % would have to be
            interpolated.
    """
    ticks = rows.ticks()
    if not np.isfinite(ticks).all():
        row = int(np.flatnonzero(~np.isfinite(ticks))[0])
        got = f"person {rows.person[row]} at {ticks[row]}"
        raise RecordingError(where, got=got, expected="finite times", hint=hint)
    order = np.lexsort((ticks, rows.person))
    rows = replace(rows, person=rows.person[order], values=rows.values[order], xy=rows.xy[order])
    ticks, beside = ticks[order], _BESIDE[rows.unit]
    steps, same = np.diff(ticks), np.diff(rows.person) == 0
    twice = np.flatnonzero(same & (steps <= beside)) + 1
    # Where most rows are closer than --dt-s, some are so close by chance, and no duplicates.
    if len(twice) and 0 < np.median(steps[same]) < 0.5:
        _refuse_close(rows, steps[same], where)
    if len(twice):
        raise RecordingError(
            where,
            got=f"person {rows.person[twice[0]]} twice at {rows.stamp(twice[0])} ({len(twice)} "
            "such rows)",
            expected="one row per person and frame",
            hint="Remove the duplicates, or give each person a separate id.",
        )
    if rows.unit == "s":
        astray = np.abs(ticks - np.round(ticks)) >= beside
        wrong = same & ((np.round(steps) != 1) | astray[1:] | astray[:-1])
    else:
        astray = np.zeros(len(ticks), dtype=bool)
        wrong = same & (np.abs(steps - 1) > beside)
    if not (wrong.any() or astray.any()):
        return _as_they_are(rows, order)
    _refuse_most(rows, steps[same], astray, where)
    if gaps is None:
        got = f"{wrong.sum()} of {same.sum()} intervals differ from {rows.long(1.0)}"
        if astray.any():
            first = f"{rows.named(int(astray.argmax()))}, between two frames"
            got = f"{astray.sum()} of {len(astray)} rows are between two frames"
        else:
            k = int(wrong.argmax())
            first = f"{rows.named(k + 1)}, {rows.long(float(steps[k]))} after its previous row"
        expected = f"a row of each person every {rows.long(1.0)}"
        raise RecordingError(where, got=f"{first} ({got})", expected=expected, hint=hint)
    if ticks.max() - ticks.min() > MAX_FRAMES:  # `from_rows` rejects this
        return _as_they_are(rows, order)
    faulty = np.isin(rows.person, np.r_[rows.person[1:][wrong], rows.person[astray]])
    return _mended(rows, order, faulty, gaps, LONGEST_GAP_S / dt_s, where)


def _as_they_are(rows: Stamped, order: Int[np.ndarray, " R"]) -> Rows:
    frame = np.round(rows.ticks()) if rows.unit == "s" else np.floor(rows.ticks())
    return Rows(rows.person, frame.astype(np.int64), rows.xy, order, {}, {})


def _refuse_close(rows: Stamped, steps: Float[np.ndarray, " S"], where: object) -> None:
    apart = float(np.median(steps))
    raise RecordingError(
        where,
        got=f"rows of a person mostly {rows.long(float(f'{apart:.2g}'))} apart, at irregular times",
        expected=rows.long(1.0),
        hint=f"Use --resample {rows.step:g} to interpolate positions every {rows.long(1.0)}."
        if rows.unit == "s"
        else "Correct the frame numbers.",
    )


def _refuse_most(
    rows: Stamped, steps: Float[np.ndarray, " S"], astray: Bool[np.ndarray, " R"], where: object
) -> None:
    """Raise if most rows have the same fault, because then an option or the file is wrong."""
    values, counts = np.unique(np.round(steps * rows.step, 3), return_counts=True)
    usual = float(values[counts.argmax()]) if len(values) else rows.step
    usually = counts.max(initial=0) > len(steps) / 3
    if usually and abs(usual / rows.step - 1) >= _BESIDE["s"]:
        raise RecordingError(
            where,
            got=f"rows of a person mostly {rows.long(usual / rows.step)} apart",
            expected=rows.long(1.0),
            hint=f"Use --dt-s {usual:g} if that is right, or --resample {rows.step:g} to "
            f"interpolate positions every {rows.long(1.0)}."
            if rows.unit == "s"
            else "Correct the frame numbers, or --dt-s.",
        )
    if astray.mean() > 0.5:
        late: float | None = _phase(rows.ticks(), digits=3)
        apart = rows.ticks() - late
        if (np.abs(apart - np.round(apart)) < _BESIDE["s"]).mean() <= 0.5:
            late = None  # most rows have no offset in common
        by = "" if late is None else f", most of them {late * rows.step:.4g} s after a frame"
        raise RecordingError(
            where,
            got=f"{rows.named(astray.argmax())} ({astray.sum()} of {len(astray)} rows between "
            f"two frames{by})",
            expected=f"times in multiples of {rows.long(1.0)}",
            hint="Correct --dt-s, or use --resample 0.4 to interpolate positions every 0.4 s."
            if late is None
            else f"Use --offset-s {late * rows.step + rows.origin:.4g} to start the frames at "
            "that time.",
        )


def _mended(
    rows: Stamped, order: Indices, faulty: Flags, gaps: Gaps, longest: float, where: object
) -> Rows:
    """All rows, with those of the `faulty` persons repaired; rows are sorted, see `on_frames`.

    `longest` is the longest gap that is interpolated, in steps.
    """
    right, ticks, free = _as_they_are(rows, order), rows.ticks(), int(rows.person.max()) + 1
    pieces = [tuple(each[~faulty] for each in (right.person, right.frame, right.xy, right.source))]
    continued: dict[int, int] = {}
    filled: list[str] = []
    moved: list[str] = []
    split: list[str] = []
    lost: list[str] = []
    put_in, of_faulty = 0, np.flatnonzero(faulty)
    for mine in np.split(of_faulty, np.flatnonzero(np.diff(rows.person[of_faulty])) + 1):
        at = ticks[mine] - (_phase(ticks[mine]) if rows.unit == "frame" else 0.0)
        astray = np.abs(at - np.round(at)) > _BESIDE[rows.unit]
        at[~astray] = np.round(at[~astray])
        moved += [rows.named(row) for row in mine[astray]]
        ends = np.flatnonzero(np.diff(at) >= _MISSING)
        words = [rows.named(mine[k], "after") for k in ends]
        if gaps == "interpolate":
            short = np.diff(at)[ends] <= longest + _BESIDE["s"]
            put_in += int((np.round(np.diff(at)[ends[short]]) - 1).sum())
            filled += [word for word, is_short in zip(words, short, strict=True) if is_short]
            words = [word for word, is_short in zip(words, short, strict=True) if not is_short]
            ends = ends[~short]
        for piece, part in enumerate(np.split(np.arange(len(mine)), ends + 1)):
            if piece == 0:
                person = int(rows.person[mine[0]])
            else:
                continued[person] = free
                person, free = free, free + 1
                split.append(f"{words[piece - 1]}, now person {person}")
            frame = np.arange(np.ceil(at[part[0]]), np.floor(at[part[-1]]) + 1)
            if len(frame) == 0:
                lost += [f"person {person} at {rows.stamp(row)}" for row in mine[part]]
                continue
            number, source = (np.full(len(frame), value) for value in (person, order[mine[0]]))
            xy = interpolated(frame, at[part], rows.xy[mine[part]])
            pieces.append((number, frame.astype(np.int64), xy, source))
    if put_in > max(_FEW_FILLED, _MOST_FILLED * len(rows.xy)):
        raise RecordingError(
            where,
            got=f"{put_in} missing rows, {100 * put_in / len(rows.xy):.0f} % of the real ones "
            f"({', '.join(filled[:_SHOWN])})",
            expected=f"at most {100 * _MOST_FILLED:.0f} % to interpolate",
            hint="Check the columns and the interval of rows, or use --gaps split.",
        )
    told = [
        _counted(put_in, "row", "interpolated", filled),
        _counted(len(moved), "row", "moved to frames", moved),
        _counted(len(split), "gap", "where a person was split into two", split),
        _counted(len(lost), "row", "between two frames left out", lost),
    ]
    notes = {"mended": "; ".join(part for part in told if part)}
    person_id, frame, xy, source = (np.concatenate(each) for each in zip(*pieces, strict=True))
    return Rows(person_id, frame, xy, source, continued, notes)


def _phase(ticks: Float[np.ndarray, " n"], digits: int = 6) -> float:
    """The most frequent offset of rows from a frame, in steps."""
    values, counts = np.unique(np.round(ticks % 1, digits) % 1, return_counts=True)
    return float(values[counts.argmax()])


def _counted(number: int, what: str, how: str, cases: list[str]) -> str:
    """A count as text, with the first few cases; empty if it is 0."""
    if not number:
        return ""
    rest = f", and {len(cases) - _SHOWN} more" if len(cases) > _SHOWN else ""
    return f"{number} {what}{'s' * (number != 1)} {how} ({', '.join(cases[:_SHOWN])}{rest})"
