"""Small faults of recordings: rows that are missing within a life, and rows beside the frames.

Nobody knows what happened there, so such recordings are refused, with person and frame, unless
the user says how to mend them. What was mended stands in the notes of the imported table.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.errors import RecordingError
from crowdbench.trajectories.table import MAX_FRAMES, Trajectories, from_rows

Gaps = Literal["interpolate", "split"]
GAPS: tuple[Gaps, ...] = ("interpolate", "split")
"""What to do where rows are missing: walk on straight, or make two persons of one."""

_MISSING = 1.5
"""Steps from so many rows on are gaps; shorter ones lead to or from a row beside the frames."""
_BESIDE = {"frame": 1e-6, "s": 0.05}
"""From so much of a step on a row is beside the frames: numbers are exact, times are not."""
_SHOWN = 3
FEW = (
    "If they are few, --gaps interpolate puts them on straight lines between their neighbours, and "
    "--gaps split makes two persons of one where rows are missing."
)


@dataclass(frozen=True)
class Stamps:
    """When each row was seen, in the file's own numbers."""

    values: np.ndarray
    """(R,), frames of a video or seconds."""
    unit: Literal["frame", "s"]
    step: float
    """From one row of a person to the next."""
    origin: float = 0.0
    """That of the scene's first frame."""

    def ticks(self) -> Float[np.ndarray, " R"]:
        """In steps from the first frame on."""
        return (self.values - self.origin) / self.step

    def of(self, row: int | np.integer) -> str:
        """In words."""
        value = self.values[row]
        return f"frame {value:.0f}" if self.unit == "frame" else f"{value:.10g} s"

    def long(self, steps: float) -> str:
        """So many steps in words."""
        length = f"{steps * self.step:.10g}"
        return f"{length} s" if self.unit == "s" else f"{length} frame{'s' * (length != '1')}"


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows on the frames of a scene, one per person and frame, none missing within a life."""

    person: Int[np.ndarray, " R"]
    frame: Int[np.ndarray, " R"]
    xy: Float[np.ndarray, "R 2"]
    source: Int[np.ndarray, " R"]
    """Index of a row of the same person in what was given."""
    cut_before: Bool[np.ndarray, " R"]
    """Of those who were split off: the person had entered before."""
    cut_after: Bool[np.ndarray, " R"]
    """Of those whose rest was split off: the person left later."""
    notes: dict[str, str]
    """What was mended, as text for a table."""

    def crowd(
        self,
        *,
        scene: str,
        dt_s: float,
        where: object,
        columns: Mapping[str, np.ndarray] | None = None,
    ) -> Trajectories:
        """The table of these rows; `columns` of persons are of the rows that were given.

        Nobody has entered or left at a gap.

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
    """Put rows on the frames of a scene, and mend them as `gaps` says; None refuses what is not.

    Of rows with frame numbers each person may have a phase of its own (annotators shift it at
    pauses); frames are rounded down. Times must be multiples of the step.

    `interpolate` fills the steps that are missing; `split` ends the person there, and lets another
    one of a new number go on. With either, rows beside the frames are replaced by the positions
    on the frames between them, linear in time.

    Raises:
        RecordingError: a person has two rows at a time; rows are missing or beside the frames,
            and `gaps` is None or they are most of the rows.
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
            got=f"person {person[rows[0]]} twice in {stamps.of(rows[0])} ({len(rows)} such rows)",
            expected="one row per person and frame",
            hint="Remove the duplicates, or give each person an id of its own.",
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
    if ticks.max() - ticks.min() > MAX_FRAMES:  # which `from_rows` refuses
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
    """Refuse what is no small fault: the same of most rows."""
    if astray.mean() > 0.5:
        row = int(np.flatnonzero(astray)[0])
        late = _usual_phase(stamps.ticks())
        by = "" if late is None else f", most of them {late * stamps.step:.4g} s after a frame"
        raise RecordingError(
            where,
            got=f"person {person[row]} at {stamps.of(row)} ({astray.sum()} of {len(astray)} rows "
            f"beside the frames{by})",
            expected=f"times in multiples of {stamps.long(1.0)}",
            hint="Correct --dt-s, or resample the trajectories to it."
            if late is None
            else f"--offset-s {late * stamps.step + stamps.origin:.4g} lets the frames begin then.",
        )
    whole = np.clip(np.round(steps), 0, 10**6).astype(np.int64)
    usual = int(np.bincount(whole, minlength=1).argmax())
    if usual > 1:
        numbers = "" if stamps.unit == "s" else "the numbers of the frames, or "
        raise RecordingError(
            where,
            got=f"rows of a person mostly {stamps.long(float(usual))} apart",
            expected=stamps.long(1.0),
            hint=f"Correct {numbers}--dt-s.",
        )


def _usual_phase(ticks: Float[np.ndarray, " R"]) -> float | None:
    """Where between two frames most rows stand, in steps; None where they are all over it."""
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
    """Names the first that is wrong, and counts the others."""
    within = int((np.diff(person[order]) == 0).sum())
    counted = f"{wrong.sum()} of {within} steps not {stamps.long(1.0)} long"
    if astray.any():
        row = int(np.flatnonzero(astray)[0])
        first = f"person {person[row]} at {stamps.of(row)}, between two frames"
        counted = f"{astray.sum()} of {len(astray)} rows beside the frames"
    else:
        k = int(np.flatnonzero(wrong)[0])
        first = (
            f"person {person[order[k]]} in {stamps.of(order[k + 1])}, "
            f"{stamps.long(float(steps[k]))} after its row before"
        )
    return RecordingError(
        where,
        got=f"{first} ({counted})",
        expected=f"each person every {stamps.long(1.0)}",
        hint=hint,
    )


def _mended(
    person: Int[np.ndarray, " R"],
    stamps: Stamps,
    xy: Float[np.ndarray, "R 2"],
    faulty: Int[np.ndarray, " F"],
    gaps: Gaps,
) -> Rows:
    """`faulty` are the rows of all persons in need of it, by person and time."""
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
                split.append(f"{words[piece - 1]}, then {own}")
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
        _counted(put_in, "row", "put in", filled),
        _counted(off, "row", "moved onto the frames", moved),
        _counted(len(split), "gap", "where one person became two", split),
        _counted(len(lost), "row", "left out between two frames", lost),
    ]
    notes = {"mended": "; ".join(part for part in told if part)}
    a, b, c, d, e, f = (np.concatenate(column) for column in zip(*pieces, strict=True))
    return Rows(a, b, c, d, e, f, notes)


def _phase(ticks: Float[np.ndarray, " n"], digits: int = 6) -> float:
    """Where between two frames more rows stand than anywhere else, in steps."""
    values, counts = np.unique(np.round(ticks % 1, digits) % 1, return_counts=True)
    return float(values[counts.argmax()])


def _counted(number: int, what: str, how: str, cases: list[str]) -> str:
    """A count, with the first few cases."""
    if not number:
        return ""
    rest = f", and {len(cases) - _SHOWN} more" if len(cases) > _SHOWN else ""
    return f"{number} {what}{'s' * (number != 1)} {how} ({', '.join(cases[:_SHOWN])}{rest})"
