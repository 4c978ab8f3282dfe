"""Printing of scorecards; the layout depends on the width of the console."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TypeAlias

from rich.table import Table
from rich.text import Text

from crowdbench.metrics import FAMILIES, WALK, MetricResult, all_metrics, paper_first
from crowdbench.report.display_names import Names, names_of
from crowdbench.report.text import terminal
from crowdbench.report.text.notes import made, score_notes
from crowdbench.report.text.words import interval, number, share, speed
from crowdbench.scene import Scene
from crowdbench.scoring.ranking import Row, ordered, ranked_by, rows
from crowdbench.scoring.scorecard import PairResult, Scorecard
from crowdbench.spawn.names import replays

Column: TypeAlias = tuple[str, Callable[[Row], str | Text]]

_NAME = 16  # minimum width of the name column, in characters


def print_card(card: Scorecard, scene: Scene) -> None:
    """Print the scores and plain distances of all crowds, with explanations."""
    table = ordered(rows(card))
    names = names_of([(row.spawn, row.policy) for row in table], scene)
    ranked = any(row.rank is not None for row in table)
    print()
    terminal.print_note(
        f"{card.scene}, protocol {card.protocol}: {card.horizon_s:.0f} s, {card.blocks} time "
        f"blocks, {made(card)}.{f' Ranked by {ranked_by(table)}.' if ranked else ''}"
    )
    terminal.print_fitting(_score_tables(table, names), terminal.new_console())
    for note in score_notes(card, scene, table, names):
        terminal.print_note(note)
    print()
    _print_distances(card, names)


def print_results(results: dict[str, MetricResult]) -> None:
    """Print the plain distances of a single crowd."""
    cells = []
    for name, r in results.items():
        means = (_typical(r.recorded, r.unit), _typical(r.simulated, r.unit))
        cells.append((name.replace("_", " "), _distance(r.distance), *means, f"{r.n}"))
    terminal.print_table("metric", "distance", "recorded mean", "your mean", "your n", rows=cells)
    terminal.print_note(
        "Plain distances to the recording. 0: equal; –: not defined here. A single crowd has no "
        "score, because a score needs several rollouts."
    )


def _score_tables(table: Sequence[Row], names: Names) -> Iterator[Sequence[Table]]:
    """Layouts from wide to narrow: one table, two tables, three tables with only one interval."""

    def family(name: str) -> Column:
        return name, lambda row: number(row.families.get(name))

    def mean(name: str, *, whole: bool = True) -> Column:
        return name, lambda row: (interval if whole else number)(getattr(row, name))

    crowds = [family(name) for name in FAMILIES if name not in WALK]
    walks = [family(name) for name in WALK]
    rank: Column = ("rank", lambda row: "" if row.rank is None else f"{row.rank}")
    rollouts: Column = ("rollouts", lambda row: f"{len(row.entry.seeds)}")
    ranked = ranked_by(table)
    gate: list[Column] = [
        ("speed", lambda row: _gated(row, "speed", speed(row.entry.speed_mps))),
        ("at goal", lambda row: _gated(row, "arrivals", share(row.entry.at_goal))),
    ]
    three = ("crowd", "walk", "overall")
    joint = [rollouts, *crowds, mean("crowd"), *walks, mean("walk"), *gate, mean("overall"), rank]
    means = [*map(mean, three), *gate, rank]
    short = [*(mean(name, whole=name == ranked) for name in three), rank]
    families = [*crowds, *walks]
    for layout in ([joint], [means, [rollouts, *families]], [short, families, [rollouts, *gate]]):
        yield [_score_table(columns, table, names) for columns in layout]


def _score_table(columns: Sequence[Column], table: Sequence[Row], names: Names) -> Table:
    grid = terminal.new_table("spawn × policy", *(head for head, _ in columns))
    grid.columns[0].min_width = _NAME
    for k, row in enumerate(table):
        if row.kind == "baseline" and table[k - 1].kind == "entry":
            grid.add_section()
        grid.add_row(names.pair(row.spawn, row.policy), *(cell(row) for _, cell in columns))
    return grid


def _gated(row: Row, limit: str, value: str) -> Text:
    """A value of the gate, in red with an exclamation mark where the policy exceeds the limit."""
    return Text(f"{value} !", style="bold red") if limit in row.fails else Text(value)


def _print_distances(card: Scorecard, names: Names) -> None:
    entries = [e for e in card.entries if not replays(e.spawn)] or card.entries
    numbered = list(enumerate(entries, 1))
    layouts = (
        [_distance_table(card, numbered[k : k + size]) for k in range(0, len(numbered), size)]
        for size in range(len(numbered), 0, -1)
    )
    terminal.print_fitting(layouts, terminal.new_console())
    terminal.print_note("Plain distances to the recording, means over rollouts; 0: equal. Crowds:")
    for k, entry in numbered:
        print(f"{k:4d}  {names.pair(entry.spawn, entry.policy)}")
    print()


def _distance_table(card: Scorecard, numbered: Sequence[tuple[int, PairResult]]) -> Table:
    known = numbered[0][1].metrics
    cells = [
        (
            name.replace("_", " "),
            "scored" if name in card.scored else "",
            _typical(known[name].recorded, known[name].unit),
            *(_distance(entry.metrics[name].distance) for _, entry in numbered),
        )
        for name in (metric.name for metric in paper_first(all_metrics()))
        if name in known
    ]
    return terminal.new_table(
        "distance", "", "recorded", *(f"{k}" for k, _ in numbered), rows=cells
    )


def _typical(value: float | None, unit: str) -> str:
    return "–" if _undefined(value) else f"{value:.2f} {unit}".rstrip()


def _distance(value: float | None) -> str:
    return "–" if _undefined(value) else f"{value:.3f}"


def _undefined(value: float | None) -> bool:
    """Whether a value is NaN; scorecards store NaN as None, because JSON has no NaN."""
    return value is None or math.isnan(value)
