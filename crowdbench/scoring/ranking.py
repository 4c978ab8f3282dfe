"""Ranks of a scorecard's table: who competes, by which score, and the order of the rows."""

from collections.abc import Sequence
from typing import Literal, Protocol, TypeVar, runtime_checkable

from crowdbench.scoring.score import Score, ranks
from crowdbench.spawn.steering.scenario import split_scenario

RankedBy = Literal["walk", "overall", "crowd"]
"""The score that the ranks of a table compare; also the name of its field in `Row`."""
RECORDED_POLICIES = ("replay", "recorded-paths")
"""Policies that follow recorded paths. They need recorded arrivals and are not ranked."""


@runtime_checkable  # tests check annotations at run time
class _Row(Protocol):
    """What ranks depend on in a row of the table, see `crowdbench.scoring.scorecard.Row`."""

    @property
    def kind(self) -> Literal["entry", "baseline"]: ...
    @property
    def spawn(self) -> str: ...
    @property
    def policy(self) -> str: ...
    @property
    def walk(self) -> Score | None: ...
    @property
    def crowd(self) -> Score | None: ...
    @property
    def overall(self) -> Score | None: ...
    @property
    def rank(self) -> int | None: ...


AnyRow = TypeVar("AnyRow", bound=_Row)


def steered(spawn: str) -> bool:
    """Whether a spawn model's name includes a scenario."""
    return split_scenario(spawn)[1] is not None


def may_rank(spawn: str) -> bool:
    """Whether entries with this spawn model are ranked.

    Replayed recordings are not ranked, because they memorise the recording. Models under a
    scenario are not ranked, because they are meant to differ from it.
    """
    return spawn not in ("replay", "block-replay") and not steered(spawn)


def competing_rows(table: Sequence[AnyRow]) -> list[AnyRow]:
    """The rows of a table that are ranked, if all of them have scores."""
    entries = [row for row in table if row.kind == "entry"]
    if all(row.spawn == "replay" for row in entries):  # only policies are compared
        return [row for row in entries if row.policy not in RECORDED_POLICIES]
    return [row for row in entries if may_rank(row.spawn)]


def ranked_by(table: Sequence[_Row]) -> RankedBy:
    """The score by which a table is ranked and sorted.

    It is `walk` if only policies are compared (all entries have the spawn model `replay`),
    otherwise `overall` if every competing entry has one, otherwise `crowd`.
    """
    entries = [row for row in table if row.kind == "entry"]
    if all(row.spawn == "replay" for row in entries):
        return "walk"
    competing = competing_rows(table) or entries
    return "overall" if all(row.overall is not None for row in competing) else "crowd"


def ordered(table: Sequence[AnyRow]) -> list[AnyRow]:
    """The table sorted: entries by rank, then by the score that `ranked_by` names; baselines last.

    Entries without a rank follow those with one, and entries without a score follow those with one.
    """
    by = ranked_by(table)

    def place(row: _Row) -> tuple[bool, int, float]:
        score: Score | None = getattr(row, by)
        worth = float("inf") if score is None else -score.value
        return row.rank is None, row.rank or 0, worth

    entries = [row for row in table if row.kind == "entry"]
    return [*sorted(entries, key=place), *(row for row in table if row.kind == "baseline")]


def ranks_of(entries: Sequence[_Row]) -> list[int | None]:
    """Rank of each row, None for those that do not compete.

    Nobody has a rank if a competing row has no score.
    """
    competing, by = competing_rows(entries), ranked_by(entries)
    scores: list[Score | None] = [getattr(row, by) for row in competing]
    known = [score for score in scores if score is not None]
    if len(known) < len(competing) or not competing:
        return [None] * len(entries)
    rank = dict(zip(map(id, competing), ranks(known), strict=True))
    return [rank.get(id(row)) for row in entries]
