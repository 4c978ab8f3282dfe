"""Entries: the results of verification, sufficient to build every page and to compute the ranks.

An entry contains each family's score with its resamples. Scores over families and scenes are means
of these, and entries are compared on the resamples that they share. Nothing in an entry depends on
the machine or the time (`ID.run.json` has those): the same submission gives the same bytes.
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
from crowdbench.scoring.scorecard import Limit

SCHEMA = 1
SCORER = 4
"""Version of the scoring. Any change that alters the scores of an entry increases it; then
`crowdbench leaderboard rescore` scores the entries again."""

SUFFIX = ".json.gz"
"""Ending of an entry's file; `crowdbench leaderboard show` prints it as text."""
_HINT = "Create it with `crowdbench leaderboard verify`."
LARGEST = 1e12
"""Limit of all numbers in an entry; the number of learned parameters comes closest to it."""
Status = Literal["ranked", "listed", "reference"]
"""`ranked`: models that crowdbench rolled out and scored on held-out data; `listed`: trajectories,
or models trained on the recordings that they are scored on; `reference`: shown for comparison (the
anchor, the recording itself, a memorisation baseline, random walkers)."""


class ScoreCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A score with its resamples."""

    value: float
    resampled: bytes
    """`scoring.energy.RESAMPLES` float32 values in little-endian order (base64 in JSON)."""

    @classmethod
    def of(cls, score: Score) -> "ScoreCard":
        """The card of a score, with its resamples rounded to float32."""
        return cls(value=score.value, resampled=score.resampled.astype("<f4").tobytes())

    def score(self) -> Score:
        """The score with its resamples."""
        return Score(self.value, np.frombuffer(self.resampled, "<f4").astype(np.float64))


class MetricEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The results of one metric on one scene."""

    distance: float | None
    """Distance to the recording, averaged over rollouts and folds; None if it is undefined."""
    recorded: float | None
    """Typical value in the recording, in `unit`."""
    simulated: float | None
    unit: str
    scored: bool
    """Whether the metric is scored on this scene."""
    score: float | None
    interval: tuple[float, float] | None
    """The central 95 % of the score's resamples."""
    splits: dict[str, list[float | None]]
    """The scores of the fits in order, by split: `fold0`, … or `full`."""


class Copy(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The copy index: how much of a crowd is copied from the recording."""

    arrivals: float | None
    """Median over time windows (60 s or longer) of the correlation of their arrivals with the most
    similar window of the recording; None on track walk, where arrivals are the recorded ones."""
    arrivals_limit: float | None
    """99th percentile of `arrivals` for models that cannot copy."""
    trips: float | None
    """Share of trips that stay within 0.1 m of a recorded trip."""


class Flag(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A warning about an entry's result on one scene."""

    what: Literal["too good", "too even", "copied arrivals", "copied trips"]
    scene: str
    value: float
    limit: float
    text: str
    """What was found and what it is compared with, in plain words."""


class Curve(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One plot: a recorded and a simulated curve over a common axis."""

    x_label: str
    """Label with its unit, as in `dwell time (s)`."""
    y_label: str
    x: list[float]
    """At most 100 values, ascending."""
    recorded: list[float]
    simulated: list[float]


class SceneEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The result on one scene."""

    made_from: str
    """Hash of the scene's rules and files that the scores depend on (`cards.files_of`)."""
    protocol: Literal["full", "heldout"]
    fits: int
    rollouts: int
    """Number of rollouts per split, over all fits."""
    persons: int
    outcomes: dict[str, int]
    speed_mps: float | None
    """Mean speed of people who walk, under the recorded arrivals if the track scores policies."""
    at_goal: float | None
    """Share of people at their goals, of those whose trips ended; None if it is unknown."""
    recorded_speed_mps: float | None
    """The same of recorded people walked under the rules of the simulation."""
    recorded_at_goal: float | None
    fails: list[Limit]
    """The limits of the scene's gate that the policy exceeds; its walk score is at most 0 then."""
    families: dict[str, ScoreCard]
    metrics: dict[str, MetricEntry]
    copy: Copy
    curves: dict[str, Curve]
    """The curves that pages show, by title."""


class Earlier(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The scores by an earlier scorer."""

    scorer: int
    crowdbench: str
    overall: float | None
    scenes: dict[str, float | None]
    reason: str
    """Why the entry was scored again."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The contents of `entries/ID.json.gz`."""

    schema: int
    id: str
    """Name of the file and the page: a-z, 0-9 and single hyphens, at most 60 characters."""
    status: Status
    declared: Declared
    scorer: int
    crowdbench: str
    """Version of crowdbench."""
    artefacts: dict[str, str]
    """SHA-256 of each file of the submission, including `submission.toml`, by its path there; and
    of each file of shipped models, by its path in crowdbench."""
    scenes: dict[str, SceneEntry]
    flags: list[Flag]
    history: list[Earlier]


def entry_path(folder: Path, name: str) -> Path:
    """The file of the entry with the id `name`."""
    return folder / f"{name}{SUFFIX}"


def entry_paths(folder: Path) -> dict[str, Path]:
    """The files of the entries in a folder, by id."""
    return {p.name.removesuffix(SUFFIX): p for p in sorted(folder.glob(f"*{SUFFIX}"))}


def read_entry(path: Path) -> Entry:
    """Read an entry.

    Raises:
        WeightsError: the entry is missing or broken, or has another schema.
    """
    entry = read_struct(path, Entry, WeightsError, _HINT)
    for got, holds, expected in (
        (f"schema {entry.schema}", entry.schema == SCHEMA, f"schema {SCHEMA}"),
        (
            f"the id {entry.id}",
            entry_path(path.parent, entry.id) == path,
            "the id in the file's name",
        ),
    ):
        if not holds:
            raise WeightsError(path, got=got, expected=expected, hint=_HINT)
    check_numbers(entry, path)
    return entry


def check_numbers(entry: Entry, where: object) -> None:
    """Check that an entry's numbers can be compared and drawn.

    Raises:
        WeightsError: a score lacks resamples, or a number is too large or not finite.
    """
    cards = [card for scene in entry.scenes.values() for card in scene.families.values()]
    if any(len(card.resampled) != 4 * RESAMPLES for card in cards):
        raise WeightsError(
            where,
            got="a score with another number of resamples",
            expected=f"{RESAMPLES} resamples",
            hint=_HINT,
        )
    numbers = _numbers(msgspec.to_builtins(entry))
    sound = all(abs(x) <= LARGEST for x in numbers) and all(
        (np.abs(card.score().resampled) <= LARGEST).all() for card in cards
    )
    if not sound:
        raise WeightsError(
            where,
            got="numbers that are too large or not finite",
            expected=f"numbers up to {LARGEST:.0e}",
            hint=_HINT,
        )


def _numbers(value: object) -> Iterator[float]:
    """All numbers in nested lists and dictionaries."""
    if isinstance(value, dict):
        value = list(value.values())
    if isinstance(value, list | tuple):
        for each in value:
            yield from _numbers(each)
    elif isinstance(value, int | float):
        yield value
