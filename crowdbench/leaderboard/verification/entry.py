"""Entries: what verification found, complete enough to make every page and to rank again.

An entry keeps each family's score with its resamples: scores over families and scenes are means of
these, and entries are compared on the resamples they share. Nothing in it depends on the machine
or the time (that goes to `run.json`): the same submission gives the same bytes.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import msgspec
import numpy as np

from crowdbench.errors import WeightsError
from crowdbench.files import read_struct
from crowdbench.leaderboard.submission.schema import Declared
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.score import Score

SCHEMA = 1
SCORER = 1
"""Version of how rollouts become scores. It goes up with any change by which an entry's scores
would be others; `crowdbench leaderboard rescore` then makes entries anew."""

_HINT = "Make it with `crowdbench leaderboard verify`."
LARGEST = 1e12
"""No number of an entry is larger; learned parameters come nearest."""
Status = Literal["ranked", "listed", "reference"]
"""`ranked`: weights that crowdbench rolled out, held out; `listed`: trajectories, or weights that
have seen what they are held against; `reference`: a line that others are seen against (what
scores 0 by definition, the recording itself, memory alone, chance)."""


class ScoreCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A score with its resamples."""

    value: float
    resampled: bytes
    """Float32 in little-endian order (base64 in JSON), `scoring.RESAMPLES` of them."""

    @classmethod
    def of(cls, score: Score) -> "ScoreCard":
        """Round the resamples to float32."""
        return cls(value=score.value, resampled=score.resampled.astype("<f4").tobytes())

    def score(self) -> Score:
        """The numbers."""
        return Score(self.value, np.frombuffer(self.resampled, "<f4").astype(np.float64))


class MetricEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One metric on one scene."""

    distance: float | None
    """Plain distance, averaged over rollouts and folds; None where it is undefined."""
    recorded: float | None
    """Typical value of the recording, in `unit`."""
    simulated: float | None
    unit: str
    scored: bool
    """Whether the scene counts it."""
    score: float | None
    interval: tuple[float, float] | None
    """The central 95 % of the score's resamples."""
    parts: dict[str, list[float | None]]
    """Score of each fit (in its order) in each part: `fold0`, … or `full`."""


class Copy(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How much of a crowd is a copy of the recording."""

    arrivals: float | None
    """Median over 60 s windows of the best correlation of their arrivals with the recording's at
    any time; None where arrivals are the recorded ones by rule (track walk)."""
    arrivals_limit: float | None
    """99th percentile of the same of crowds that cannot copy."""
    lives: float | None
    """Share of lives that stay within 0.1 m of a recorded one."""


class Flag(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Something that a reader should know before believing an entry."""

    what: Literal["too good", "too even", "copied arrivals", "copied lives"]
    scene: str
    value: float
    limit: float
    text: str
    """One sentence that says what was found and what it is compared with."""


class Curve(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One picture of the crowd beside the recording: two lines over a common axis."""

    x_label: str
    """With its unit, as in `dwell time (s)`."""
    y_label: str
    x: list[float]
    """At most 100 values, ascending."""
    recorded: list[float]
    simulated: list[float]


class SceneEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One scene's result."""

    made_from: str
    """Hash of the scene's rules and files that scores depend on (`cards.files_of`)."""
    protocol: Literal["full", "heldout"]
    fits: int
    rollouts: int
    """Of each part, all fits together."""
    persons: int
    outcomes: dict[str, int]
    families: dict[str, ScoreCard]
    metrics: dict[str, MetricEntry]
    copy: Copy
    curves: dict[str, Curve]
    """By title, what pages draw."""


class Earlier(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What an earlier scorer found."""

    scorer: int
    crowdbench: str
    overall: float | None
    scenes: dict[str, float | None]
    reason: str
    """Why it was scored anew."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What `entries/ID.json` holds."""

    schema: int
    id: str
    """Name of the file and of the page: a-z, 0-9 and single hyphens, at most 60."""
    status: Status
    declared: Declared
    scorer: int
    crowdbench: str
    """Version."""
    artefacts: dict[str, str]
    """SHA-256 by path in the submission, `submission.toml` included, and by path in crowdbench of
    the files of shipped models."""
    scenes: dict[str, SceneEntry]
    flags: list[Flag]
    history: list[Earlier]


def read_entry(path: Path) -> Entry:
    """Read an entry.

    Raises:
        WeightsError: it is missing or broken, or of another schema.
    """
    entry = read_struct(path, Entry, WeightsError, _HINT)
    for got, holds, expected in (
        (f"schema {entry.schema}", entry.schema == SCHEMA, f"schema {SCHEMA}"),
        (f"the entry {entry.id}", entry.id == path.stem, "the entry that its name says"),
    ):
        if not holds:
            raise WeightsError(path, got=got, expected=expected, hint=_HINT)
    check_numbers(entry, path)
    return entry


def check_numbers(entry: Entry, where: object) -> None:
    """Refuse what cannot be drawn or compared.

    Raises:
        WeightsError: resamples are cut short, or a number is too large or none.
    """
    cards = [card for scene in entry.scenes.values() for card in scene.families.values()]
    if any(len(card.resampled) != 4 * RESAMPLES for card in cards):
        raise WeightsError(
            where, got="resamples cut short", expected=f"{RESAMPLES} of each", hint=_HINT
        )
    numbers = _numbers(msgspec.to_builtins(entry))
    sound = all(abs(x) <= LARGEST for x in numbers) and all(
        (np.abs(card.score().resampled) <= LARGEST).all() for card in cards
    )
    if not sound:
        raise WeightsError(
            where,
            got="numbers that no verification gives",
            expected=f"numbers up to {LARGEST:.0e}",
            hint=_HINT,
        )


def _numbers(value: object) -> Iterator[float]:
    """All that are in lists and dictionaries, however deep."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, int | float):
        yield value
