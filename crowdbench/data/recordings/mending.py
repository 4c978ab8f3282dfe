"""Repairs small faults of recordings: missing rows within a trip, and rows between two frames.

The true positions are unknown there, so such recordings are rejected unless the user chooses how to
repair them. The message names the first affected person and frame. All repairs are listed in the
notes of the imported table.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.table import MAX_FRAMES, Trajectories, from_rows
from crowdbench.errors import RecordingError

Gaps = Literal["interpolate", "split"]
GAPS: tuple[Gaps, ...] = ("interpolate", "split")
"""How missing rows are repaired: by linear interpolation, or by splitting the person into two."""

_MISSING = 1.5
"""Intervals of at least this many steps are gaps; shorter ones begin or end at a row between two
frames."""
_BESIDE = {"frame": 1e-6, "s": 0.05}
"""A row lies between two frames if it is further than this from a frame, in steps. Frame numbers
are exact, times are not."""
_SHOWN = 3
FEW = (
    "If only a few rows are affected, use --gaps interpolate to fill them in linearly, or --gaps "
    "split to split a person into two where rows are missing."
)


@dataclass(frozen=True)
class Stamps:
    """The time stamp of each row, as frame number or time."""

    values: np.ndarray
    """(R,), video frame numbers or seconds, as in the file."""
    unit: Literal["frame", "s"]
    step: float
    """Interval from one row of a person to the next, in `unit`."""
    origin: float = 0.0
    """Value at the first frame of the scene, in `unit`."""

    def ticks(self) -> Float[np.ndarray, " R"]:
        """Time of each row in steps since the first frame of the scene."""
        return (self.values - self.origin) / self.step

    def of(self, row: int | np.integer) -> str:
        """The time stamp of a row as text, such as `frame 12` or `4.8 s`."""
        value = self.values[row]
        return f"frame {value:.0f}" if self.unit == "frame" else f"{value:.10g} s"

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
    cut_before: Bool[np.ndarray, " R"]
    """True if the person was split before these rows, so it entered earlier."""
    cut_after: Bool[np.ndarray, " R"]
    """True if the person was split after these rows, so it left later."""
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
        if self.cut_before.any() or self.cut_after.any():
            number, index = np.unique(self.person, return_inverse=True)
            first = np.full(len(number), MAX_FRAMES)
            np.minimum.at(first, index, self.frame)
            for name in {"spawn_s", "requested_s"} & set(persons):
                persons[name] = np.where(self.cut_before, first[index] * dt_s, persons[name])
            there = {
                "entered": first[index] > 0,
                "left": ~np.isin(self.person, self.person[self.frame == self.frame.max()]),
            }
            persons["entered"] = persons.get("entered", there["entered"]) & ~self.cut_before
            persons["left"] = persons.get("left", there["left"]) & ~self.cut_after
        return from_rows(
            scene=scene,
            dt_s=dt_s,
            person_id=self.person,
            frame=self.frame,
            xy=self.xy,
            persons=persons,
            provenance={"notes": self.notes} if self.notes else {},
            where=where,
        )


def on_frames(
    person: Int[np.ndarray, " R"],
    stamps: Stamps,
    xy: Float[np.ndarray, "R 2"],
    *,
    gaps: Gaps | None,
    where: object,
    hint: str = FEW,
) -> Rows:
    """Assign rows to the frames of a scene, and repair faults as `gaps` says.

    Frame numbers are rounded down, because each person may have a different phase (annotators
    shift it at pauses). Times must be multiples of the step.

    With `interpolate`, missing rows are interpolated linearly. With `split`, the person ends at the
    gap and continues as another person with a new number. With both, rows between two frames are
    replaced by positions at the frames, interpolated linearly in time. With None, recordings with
    faults are rejected.

    Raises:
        RecordingError: a person has two rows at the same time; or rows are missing or between two
            frames, and `gaps` is None or most rows are affected.
    """
    ticks = stamps.ticks()
    if not np.isfinite(ticks).all():
        row = int(np.flatnonzero(~np.isfinite(ticks))[0])
        raise RecordingError(
            where, got=f"person {person[row]} at {ticks[row]}", expected="finite times", hint=hint
        )
    beside = _BESIDE[stamps.unit]
    order = np.lexsort((ticks, person))
    same = np.diff(person[order]) == 0
    steps = np.where(same, np.diff(ticks[order]), 1.0)
    if (steps <= beside).any():
        rows = order[1:][steps <= beside]
        raise RecordingError(
            where,
            got=f"person {person[rows[0]]} twice at {stamps.of(rows[0])} ({len(rows)} such rows)",
            expected="one row per person and frame",
            hint="Remove the duplicates, or give each person a separate id.",
        )
    if stamps.unit == "s":
        astray = np.abs(ticks - np.round(ticks)) >= beside
        wrong = (np.round(steps) != 1) | astray[order[1:]] | astray[order[:-1]]
    else:
        astray = np.zeros(len(ticks), dtype=bool)
        wrong = np.abs(steps - 1) > beside
    wrong &= same
    if not (wrong.any() or astray.any()):
        return _as_they_are(person, stamps, xy)
    _refuse_most(person, stamps, steps[same], astray, where)
    if gaps is None:
        raise _refused(person, stamps, order, steps, wrong, astray, where, hint)
    if ticks.max() - ticks.min() > MAX_FRAMES:  # `from_rows` rejects this
        return _as_they_are(person, stamps, xy)
    faulty = np.isin(person, np.r_[person[order[1:][wrong]], person[astray]])
    return _mended(person, stamps, xy, order[faulty[order]], gaps)


def _as_they_are(
    person: Int[np.ndarray, " R"], stamps: Stamps, xy: Float[np.ndarray, "R 2"]
) -> Rows:
    no = np.zeros(len(person), dtype=bool)
    ticks = stamps.ticks()
    frame = np.round(ticks) if stamps.unit == "s" else np.floor(ticks)
    return Rows(person, frame.astype(np.int64), xy, np.arange(len(person)), no, no, {})


def _refuse_most(
    person: Int[np.ndarray, " R"],
    stamps: Stamps,
    steps: Float[np.ndarray, " S"],
    astray: Bool[np.ndarray, " R"],
    where: object,
) -> None:
    """Raise if most rows have the same fault, because then an option or the file is wrong."""
    if astray.mean() > 0.5:
        row = int(np.flatnonzero(astray)[0])
        late = _usual_phase(stamps.ticks())
        by = "" if late is None else f", most of them {late * stamps.step:.4g} s after a frame"
        raise RecordingError(
            where,
            got=f"person {person[row]} at {stamps.of(row)} ({astray.sum()} of {len(astray)} rows "
            f"between two frames{by})",
            expected=f"times in multiples of {stamps.long(1.0)}",
            hint=_other_step(stamps, steps)
            or f"Correct --dt-s, or resample the trajectories to {stamps.long(1.0)}."
            if late is None
            else f"Use --offset-s {late * stamps.step + stamps.origin:.4g} to start the frames at "
            "that time.",
        )
    whole = np.clip(np.round(steps), 0, 10**6).astype(np.int64)
    usual = int(np.bincount(whole, minlength=1).argmax())
    if usual > 1:
        numbers = "" if stamps.unit == "s" else "the frame numbers, or "
        raise RecordingError(
            where,
            got=f"rows of a person mostly {stamps.long(float(usual))} apart",
            expected=stamps.long(1.0),
            hint=_other_step(stamps, steps) or f"Correct {numbers}--dt-s.",
        )


def _other_step(stamps: Stamps, steps: Float[np.ndarray, " S"]) -> str:
    """A hint that names the time between most rows if it is not the step; else empty."""
    values, counts = np.unique(np.round(steps * stamps.step, 3), return_counts=True)
    if stamps.unit == "frame" or not len(values) or counts.max() <= len(steps) / 2:
        return ""
    found_s = float(values[counts.argmax()])
    if abs(found_s / stamps.step - 1) < _BESIDE["s"]:
        return ""
    return (
        f"Rows of a person are mostly {found_s:g} s apart. Use --dt-s {found_s:g} if that is "
        f"right, or resample the trajectories to {stamps.long(1.0)}."
    )


def _usual_phase(ticks: Float[np.ndarray, " R"]) -> float | None:
    """The offset from a frame, in steps, that most rows share; None if there is none."""
    usual = _phase(ticks, digits=3)
    apart = ticks - usual
    most = (np.abs(apart - np.round(apart)) < _BESIDE["s"]).mean() > 0.5
    return usual if most else None


def _refused(
    person: Int[np.ndarray, " R"],
    stamps: Stamps,
    order: Int[np.ndarray, " R"],
    steps: Float[np.ndarray, " S"],
    wrong: Bool[np.ndarray, " S"],
    astray: Bool[np.ndarray, " R"],
    where: object,
    hint: str,
) -> RecordingError:
    """The error for a recording with faults; it names the first and counts the others."""
    within = int((np.diff(person[order]) == 0).sum())
    counted = f"{wrong.sum()} of {within} intervals differ from {stamps.long(1.0)}"
    if astray.any():
        row = int(np.flatnonzero(astray)[0])
        first = f"person {person[row]} at {stamps.of(row)}, between two frames"
        counted = f"{astray.sum()} of {len(astray)} rows are between two frames"
    else:
        k = int(np.flatnonzero(wrong)[0])
        first = (
            f"person {person[order[k]]} at {stamps.of(order[k + 1])}, "
            f"{stamps.long(float(steps[k]))} after its previous row"
        )
    return RecordingError(
        where,
        got=f"{first} ({counted})",
        expected=f"a row of each person every {stamps.long(1.0)}",
        hint=_other_step(stamps, steps[np.diff(person[order]) == 0]) or hint,
    )


def _mended(
    person: Int[np.ndarray, " R"],
    stamps: Stamps,
    xy: Float[np.ndarray, "R 2"],
    faulty: Int[np.ndarray, " F"],
    gaps: Gaps,
) -> Rows:
    """Repair the rows `faulty`, which are all rows of the affected persons, by person and time."""
    rest = np.setdiff1d(np.arange(len(person)), faulty)
    whole = _as_they_are(person, stamps, xy)
    pieces = [
        (person[rest], whole.frame[rest], xy[rest], rest, whole.cut_before[rest],
         whole.cut_after[rest])
    ]  # fmt: skip
    ticks, free = stamps.ticks(), int(person.max()) + 1
    filled: list[str] = []
    moved: list[str] = []
    split: list[str] = []
    lost: list[str] = []
    put_in = off = 0
    for rows in np.split(faulty, np.flatnonzero(np.diff(person[faulty])) + 1):
        number = int(person[rows[0]])
        at = ticks[rows] - (_phase(ticks[rows]) if stamps.unit == "frame" else 0.0)
        astray = np.abs(at - np.round(at)) > _BESIDE[stamps.unit]
        at[~astray] = np.round(at[~astray])
        off += int(astray.sum())
        moved += [f"person {number} at {stamps.of(row)}" for row in rows[astray]]
        ends = np.flatnonzero(np.diff(at) >= _MISSING)
        words = [f"person {number} after {stamps.of(rows[k])}" for k in ends]
        if gaps == "interpolate":
            put_in += int((np.round(np.diff(at)[ends]) - 1).sum())
            filled += words
            ends = ends[:0]
        for piece, part in enumerate(np.split(np.arange(len(rows)), ends + 1)):
            frame = np.arange(np.ceil(at[part[0]]), np.floor(at[part[-1]]) + 1)
            known = xy[rows[part]]
            own = number if piece == 0 else free
            if piece:
                free += 1
                split.append(f"{words[piece - 1]}, now person {own}")
            if len(frame) == 0:
                lost += [f"person {own} at {stamps.of(row)}" for row in rows[part]]
                continue
            pieces.append(
                (
                    np.full(len(frame), own),
                    frame.astype(np.int64),
                    np.stack([np.interp(frame, at[part], known[:, k]) for k in (0, 1)], axis=1),
                    np.full(len(frame), rows[0]),
                    np.full(len(frame), piece > 0),
                    np.full(len(frame), part[-1] + 1 < len(rows)),
                )
            )
    told = [
        _counted(put_in, "row", "interpolated", filled),
        _counted(off, "row", "moved to frames", moved),
        _counted(len(split), "gap", "where a person was split into two", split),
        _counted(len(lost), "row", "between two frames left out", lost),
    ]
    notes = {"mended": "; ".join(part for part in told if part)}
    a, b, c, d, e, f = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return Rows(a, b, c, d, e, f, notes)


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
