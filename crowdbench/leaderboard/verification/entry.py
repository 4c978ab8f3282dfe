"""Entries: the results of verification, sufficient to build every page and to compute the ranks.

An entry contains each family's score with its resamples. Scores over families and scenes are means
of these, and entries are compared on the resamples that they share. Nothing in an entry depends on
the machine or the time (`ID.run.json` has those): the same submission gives the same bytes.
"""

from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Annotated, Final, Literal, TypeAlias

import msgspec
from msgspec import Meta

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import OutputError, SettingError, WeightsError, did_you_mean
from crowdbench.files import read_struct
from crowdbench.leaderboard.submission.errors import plain
from crowdbench.leaderboard.submission.limits import MOST_FILES
from crowdbench.leaderboard.submission.schema import Declared
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import Limit, Resamples, pack, unpack

SCHEMA: Final = 2
SCORER = 6
"""Version of the scoring. Any change that alters the scores of an entry increases it; then
`python -m studies rescore` scores the entries again."""

SUFFIX = ".json.gz"
"""Ending of an entry's file; `crowdbench leaderboard show` prints it as text."""
POINTS = 100
"""Largest number of values of a curve."""
HINT = "Create it with `crowdbench leaderboard verify`."
LARGEST = 1e12
"""Limit of all numbers in an entry; the number of learned parameters comes closest to it."""
Number: TypeAlias = Annotated[float, Meta(ge=-LARGEST, le=LARGEST)]
Count: TypeAlias = Annotated[int, Meta(ge=0, le=10**12)]
Split: TypeAlias = Annotated[str, Meta(pattern=rf"\A({'|'.join(SPLITS)})\Z")]
Values: TypeAlias = Annotated[list[Number], Meta(min_length=1, max_length=POINTS)]
Status = Literal["ranked", "listed", "external", "reference"]
"""`ranked`: models that crowdbench rolled out and scored on held-out data; `listed`: trajectories,
or models trained on the recordings that they are scored on; `external`: models of other simulators,
rolled out by crowdbench and scored on held-out data; `reference`: shown for comparison (the anchor,
the recording itself, a memorisation baseline, random walkers)."""
What = Literal["too good", "too even", "copied arrivals", "copied trips"]


class ScoreCard(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A score with its resamples."""

    value: Number
    resampled: Resamples

    @classmethod
    def of(cls, score: Score) -> "ScoreCard":
        """The card of a score, with its resamples rounded."""
        return cls(value=score.value, resampled=pack(score.value, score.resampled))

    def score(self) -> Score:
        """The score with its resamples."""
        return Score(self.value, unpack(self.value, self.resampled))


class MetricEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The results of one metric on one scene."""

    distance: Number | None
    """Distance to the recording, averaged over rollouts and folds; None if it is undefined."""
    recorded: Number | None
    """Typical value in the recording, in `unit`."""
    simulated: Number | None
    unit: str
    scored: bool
    """Whether the metric is scored on this scene."""
    score: Number | None
    interval: tuple[Number, Number] | None
    """The central 95 % of the score's resamples."""
    splits: dict[Split, list[Number | None]]
    """The scores of the fits in order, by split."""


class CoarseCopy(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The copy index of arrivals that are counted in bins of some seconds."""

    bin_s: Number
    index: Number | None
    limit: Number | None
    """99th percentile of `index` for models that cannot copy."""


class Copy(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The copy index: how much of a crowd is copied from the recording."""

    arrivals: Number | None
    """Median over time windows (60 s or longer) of the correlation of their arrivals with the most
    similar window of the recording; None on track walk, where arrivals are the recorded ones."""
    arrivals_limit: Number | None
    """99th percentile of `arrivals` for models that cannot copy."""
    coarse: list[CoarseCopy] = []
    """The same in longer bins and windows, where arrivals that were moved by seconds still
    correlate."""
    trips: Number | None
    """Share of trips whose course follows the one that the same person walked in the recording
    (`path_copies`), under the recorded arrivals; None if nobody walks under them."""


class Flag(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A warning about an entry's result on one scene."""

    what: What
    scene: str
    value: Number
    limit: Number
    text: str
    """What was found and what it is compared with, in plain words."""


class Curve(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """One plot: a recorded and a simulated curve over a common axis."""

    x_label: str
    """Label with its unit, as in `dwell time (s)`."""
    y_label: str
    x: Values
    """In ascending order."""
    recorded: Values
    simulated: Values


class AsRecorded(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a policy that is ranked under perturbed arrivals gets under the recorded ones."""

    families: dict[str, ScoreCard]
    """Motion and interaction."""
    fails: list[Limit]
    """The limits of the scene's gate that it exceeds there."""
    speed_mps: Number | None
    at_goal: Number | None


class SceneEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The result on one scene."""

    made_from: str
    """Hash of the scene's rules and files that the scores depend on (`cards.files_of`)."""
    protocol: Literal["full", "heldout"]
    fits: Count
    rollouts: Count
    """Number of rollouts per split, over all fits."""
    persons: Count
    outcomes: dict[str, Count]
    speed_mps: Number | None
    """Mean speed of people who walk, under the arrivals that count."""
    at_goal: Number | None
    """Share of people at their goals, of those whose trips ended; None if it is unknown."""
    recorded_speed_mps: Number | None
    """The same of recorded people walked under the rules of the simulation."""
    recorded_at_goal: Number | None
    fails: list[Limit]
    """The limits of the scene's gate that the policy exceeds; its walk score is at most 0 then."""
    families: dict[str, ScoreCard]
    """The scores that count. Ranked policies are scored under perturbed arrivals."""
    as_recorded: AsRecorded | None = None
    """Of a ranked policy, its results under the recorded arrivals, for comparison."""
    metrics: dict[str, MetricEntry]
    copy: Copy
    curves: dict[str, Curve]
    """The curves that pages show, by title."""


TestIds: TypeAlias = Annotated[
    list[Annotated[str, Meta(pattern=r"\A[a-z0-9-]{1,40}\Z")]], Meta(max_length=100)
]


class ExamEntry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The verdicts of `crowdbench exam`, by ids of tests; they do not rank."""

    scene: str
    """The scene whose time step and policy were used."""
    body_radius_m: Number
    passed: TestIds
    failed: TestIds


class Earlier(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The scores by an earlier scorer."""

    scorer: Count
    crowdbench: str
    overall: Number | None
    scenes: dict[str, Number | None]
    reason: str
    """Why the entry was scored again."""


class Entry(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The contents of `entries/ID.json.gz`."""

    schema: Literal[2]
    id: Annotated[str, Meta(pattern=r"\A[a-z0-9]+(-[a-z0-9]+)*\Z", max_length=60)]
    """Name of the file and the page: a-z, 0-9 and single hyphens."""
    status: Status
    declared: Declared
    scorer: Count
    crowdbench: str
    """Version of crowdbench."""
    artefacts: Annotated[dict[str, str], Meta(max_length=MOST_FILES)]
    """SHA-256 of each file of the submission, including `submission.toml`, by its path there; and
    of each file of shipped models, by its path in crowdbench."""
    scenes: dict[str, SceneEntry]
    flags: list[Flag]
    exam: ExamEntry | None = None
    """None if nobody was examined, or if the entry has no policy of its own."""
    key: Annotated[str, Meta(pattern=r"\A[0-9a-f]{0,32}\Z")] = ""
    """Of a ranked policy, the key of the perturbed arrivals (`perturbed-replay:KEY`), which was
    drawn when the entry was verified; otherwise empty."""
    history: list[Earlier]


def shipped_leaderboard() -> Path:
    """The folder of the leaderboard that comes with crowdbench."""
    package = Path(__file__).parents[2]
    installed = package / "_leaderboard"  # in an installed wheel
    return installed if installed.is_dir() else package.parent / "leaderboard"


def entry_path(folder: Path, name: str) -> Path:
    """The file of the entry with the id `name`."""
    return folder / f"{name}{SUFFIX}"


def entry_paths(folder: Path) -> dict[str, Path]:
    """The files of the entries in a folder, by id."""
    return {p.name.removesuffix(SUFFIX): p for p in sorted(folder.glob(f"*{SUFFIX}"))}


def find_entry(name: str, folder: Path, *, otherwise: str = "") -> Path:
    """The file of the entry with the id `name` in a folder.

    Raises:
        SettingError: there is none; `otherwise` says what else was expected.
    """
    known = entry_paths(folder)
    if name not in known:
        raise SettingError(
            "entry",
            got=repr(name),
            expected=f"{otherwise}one of {folder} ({', '.join(known) or 'none yet'})",
            hint=did_you_mean(name, known),
        )
    return known[name]


def read_entry(path: Path) -> Entry:
    """Read an entry.

    Raises:
        WeightsError: the entry is missing or broken, has another schema or id, or a number is too
            large.
    """
    try:
        entry = read_struct(path, Entry, WeightsError, HINT)
    except WeightsError as error:
        if not path.is_file():
            raise
        got = f"a file that is no entry of the leaderboard ({error.got})"
        raise WeightsError(path, got=got, expected=error.expected, hint=error.hint) from error
    if entry_path(path.parent, entry.id) != path:
        raise WeightsError(
            path, got=f"the id {entry.id}", expected="the id in the file's name", hint=HINT
        )
    return entry


def owners_of(out: Path) -> dict[str, Sequence[str]]:
    """Authors of the entries in a folder, by id; a broken entry has none and may be overwritten."""
    found: dict[str, Sequence[str]] = {}
    for path in entry_paths(out).values():
        with suppress(WeightsError):
            entry = read_entry(path)
            found[entry.id] = entry.declared.authors
    return found


def check_unused(
    submission: object,
    name: str,
    authors: Sequence[str],
    owners: Mapping[str, Sequence[str]],
    *,
    replace: bool = False,
) -> None:
    """Check that an entry would not overwrite another one.

    `owners` are the authors of other entries by id. With `replace`, an entry of the same authors
    may be overwritten.

    Raises:
        OutputError: the id belongs to an entry of other authors, or `replace` is needed.
    """
    owner = owners.get(name)
    if owner is None:
        return
    if not replace and list(owner) == list(authors):
        raise OutputError(
            submission,
            got=f"the id {name}, which has an entry already",
            expected="an unused id",
            hint="Choose another output folder, or replace that entry with `--replace`.",
        )
    if list(owner) != list(authors):
        by = f" by {plain(', '.join(owner))}" if owner else ""
        raise OutputError(
            submission,
            got=f"the id {name} of another submission{by}",
            expected="an unused id",
            hint="The id is made from the name: choose another name or another output folder.",
        )
