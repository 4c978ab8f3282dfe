"""The tables of a track: ranked entries and references, and listed entries."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from crowdbench.leaderboard.scores import View
from crowdbench.report.text.words import NOTHING, share
from studies.site.standings import Line, Standing

OVERALL = View()
GATE = ("speed", "at goal")
COPIED = ("arrivals", "trips")


@dataclass(frozen=True, eq=False)
class Table:
    """A table of a track, with a column of ranks or without; the template draws it."""

    standing: Standing
    ranked: bool
    lines: list[Line]
    places: dict[View, dict[str, int]]
    """In each view, the place of each entry's row by the entry's id, if the table has ranks."""
    edges: set[str]
    """Ids of the entries with a rule above their row."""

    @property
    def walks(self) -> bool:
        """Whether policies are ranked, so that scores under the recorded arrivals have a column."""
        return self.standing.track != "spawn"

    @property
    def examined(self) -> bool:
        """Whether the table has a column of the exam."""
        return any_examined(self.lines)

    @property
    def copied(self) -> tuple[str, ...]:
        """The parts of the copy index that have a column."""
        return copied(self.standing)


def ranked_table(standing: Standing) -> Table:
    """The table of ranks and scores, for every view; the page shows one at a time."""
    order = {view: standing.ordered(view) for view in standing.views}
    places = {view: {o.entry.id: k for k, o in enumerate(order[view])} for view in order}
    edges = _edges(order[OVERALL], standing.ranks[OVERALL])
    return Table(standing, True, order[OVERALL], places, edges)


def listed_table(standing: Standing) -> Table:
    """The table of listed entries, without ranks."""
    best = sorted(standing.listed, key=lambda line: line.worth(OVERALL))
    return Table(standing, False, best, {}, {line.entry.id for line in best})


def _edges(lines: Sequence[Line], ranks: Mapping[str, int]) -> set[str]:
    """Ids of the entries that begin a new tie group."""
    competing = [line.entry.id for line in lines if line.entry.id in ranks]
    return {b for a, b in pairwise(competing) if ranks[a] != ranks[b]}


def copied(standing: Standing) -> tuple[str, ...]:
    """The shown parts of the copy index; arrivals on track walk are always the recorded ones."""
    return ("trips",) if standing.track == "walk" else COPIED


def any_examined(lines: Sequence[Line]) -> bool:
    """Whether a table has a column of the exam."""
    return any(line.entry.exam is not None for line in lines)


def examined(line: Line) -> str:
    """How many tests of the exam the policy passes, as text."""
    exam = line.entry.exam
    return NOTHING if exam is None else f"{len(exam.passed)} of {len(exam.passed + exam.failed)}"


def gated(line: Line) -> tuple[str, str]:
    """Speed and share of arrivals as text, marked where they exceed limits on any scene."""
    gate = line.gate()
    marks = [" !" if limit in gate.fails else "" for limit in ("speed", "arrivals")]
    speed = NOTHING if gate.speed is None else f"{100 * gate.speed:.0f} %"
    return speed + marks[0], share(gate.at_goal) + marks[1]
