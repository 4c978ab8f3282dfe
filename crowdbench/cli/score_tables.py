"""Printing of scorecards; the layout depends on the width of the console."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

from crowdbench.cli.printing import new_console, new_table, print_fitting, print_note

if TYPE_CHECKING:
    from rich.table import Table
    from rich.text import Text

    from crowdbench.metrics import MetricResult
    from crowdbench.report.display_names import Names
    from crowdbench.scene import Scene
    from crowdbench.scoring.scorecard import PairResult, Row, Scorecard

    Column: TypeAlias = tuple[str, Callable[[Row], str | Text]]

_NAME = 16  # minimum width of the name column, in characters


def print_card(card: "Scorecard", scene: "Scene") -> None:
    """Print the scores and plain distances of all crowds, with explanations."""
    from crowdbench.report.display_names import names_of
    from crowdbench.report.text.notes import made
    from crowdbench.scoring.ranking import ordered, ranked_by
    from crowdbench.scoring.scorecard import rows

    table = ordered(rows(card))
    names = names_of([(row.spawn, row.policy) for row in table], scene)
    ranked = any(row.rank is not None for row in table)
    print()
    print_note(
        f"{card.scene}, protocol {card.protocol}: {card.horizon_s:.0f} s, {card.blocks} time "
        f"blocks, {made(card)}.{f' Ranked by {ranked_by(table)}.' if ranked else ''}"
    )
    print_fitting(_score_tables(table, names), new_console())
    for note in _notes(card, scene, table, names):
        print_note(note)
    print()
    _print_distances(card, names)


def print_results(results: "dict[str, MetricResult]") -> None:
    """Print the plain distances of a single crowd."""
    table = new_table("metric", "distance", "recorded mean", "your mean", "your n")
    for name, r in results.items():
        means = (_typical(r.recorded, r.unit), _typical(r.simulated, r.unit))
        table.add_row(name.replace("_", " "), _distance(r.distance), *means, f"{r.n}")
    new_console().print(table)
    print_note(
        "Plain distances to the recording. 0: equal; –: not defined here. A single crowd has no "
        "score, because a score needs several rollouts."
    )


def _score_tables(table: "Sequence[Row]", names: "Names") -> "Iterator[Sequence[Table]]":
    """Layouts from wide to narrow: one table, two tables, three tables with only one interval."""
    from crowdbench.metrics import FAMILIES, WALK
    from crowdbench.report.text.words import interval, number, share, speed
    from crowdbench.scoring.ranking import ranked_by

    def family(name: str) -> "Column":
        return name, lambda row: number(row.families.get(name))

    def mean(name: str, *, whole: bool = True) -> "Column":
        return name, lambda row: (interval if whole else number)(getattr(row, name))

    crowds = [family(name) for name in FAMILIES if name not in WALK]
    walks = [family(name) for name in WALK]
    rank: Column = ("rank", lambda row: "" if row.rank is None else f"{row.rank}")
    made: Column = ("rollouts", lambda row: f"{len(row.entry.seeds)}")
    ranked = ranked_by(table)
    gate: list[Column] = [
        ("speed", lambda row: _gated(row, "speed", speed(row.entry.speed_mps))),
        ("at goal", lambda row: _gated(row, "arrivals", share(row.entry.at_goal))),
    ]
    three = ("crowd", "walk", "overall")
    joint = [made, *crowds, mean("crowd"), *walks, mean("walk"), *gate, mean("overall"), rank]
    means = [*map(mean, three), *gate, rank]
    short = [*(mean(name, whole=name == ranked) for name in three), rank]
    families = [*crowds, *walks]
    for layout in ([joint], [means, [made, *families]], [short, families, [made, *gate]]):
        yield [_score_table(columns, table, names) for columns in layout]


def _score_table(columns: "Sequence[Column]", table: "Sequence[Row]", names: "Names") -> "Table":
    made = new_table("spawn × policy", *(head for head, _ in columns))
    made.columns[0].min_width = _NAME
    for k, row in enumerate(table):
        if row.kind == "anchor" and table[k - 1].kind == "entry":
            made.add_section()
        made.add_row(names.pair(row.spawn, row.policy), *(cell(row) for _, cell in columns))
    return made


def _gated(row: "Row", limit: str, value: str) -> "Text":
    """A value of the gate, in red with an exclamation mark where the policy exceeds the limit."""
    from rich.text import Text

    return Text(f"{value} !", style="bold red") if limit in row.fails else Text(value)


def _notes(card: "Scorecard", scene: "Scene", table: "Sequence[Row]", names: "Names") -> list[str]:
    """Explanations of the scores, and reasons why scores are missing."""
    from crowdbench.data.recordings.catalogue import SOURCES
    from crowdbench.report.text.notes import gate_notes
    from crowdbench.report.text.words import STEERED
    from crowdbench.scoring.ranking import steered
    from crowdbench.scoring.scorecard import ANCHOR, has_recorded_arrivals

    notes = [
        f"Scores: 0 is the score of the anchor ({' × '.join(ANCHOR)}; for motion and interaction, "
        "straight walkers with the recorded arrivals), 1 the expected score of a perfect model. "
        "Brackets: 95 % intervals. crowd: mean of arrivals, presence, trips and space. walk: the "
        "lesser of motion and interaction. overall: mean of crowd and walk. –: nothing is scored. "
        "Crowds with equal ranks do not differ significantly (5 %, Holm). Unranked baselines "
        "follow: replay repeats the recording, recorded-paths walks it, block-replay repeats "
        "random blocks of it.",
        f"speed: mean of people who walk, m/s. at goal: share of people who reach it. walk is at "
        f"most 0 for policies marked with ! under the recorded arrivals: speed more than "
        f"{card.gate.speed:.0%} off that of recorded-paths, or less than {card.gate.arrivals:.0%} "
        "of its share at the goal.",
        *gate_notes(card, table, names),
    ]
    if not card.scored:
        notes.append(
            "No scores: this scene has no scored metrics yet. Run "
            f"`crowdbench power {scene.asked} --write`."
        )
    elif any(
        (row.walk if row.spawn == "replay" else row.crowd) is None
        for row in table
        if row.kind == "entry"
    ):
        in_folds = " in each fold" if card.protocol == "heldout" else ""
        notes.append(
            f"Scores are missing: a score needs at least two rollouts "
            f"{'' if card.fits == 1 else f'for each of the {card.fits} fits, that is, '}"
            f"{'' if card.fits == 1 else f'{2 * card.fits} '}of each pair{in_folds}; "
            f"there {'is' if card.rollouts == 1 else 'are'} {card.rollouts}."
        )
    if not has_recorded_arrivals(card):
        name = scene.recording.name
        how = "fetch" if name in SOURCES else "import"
        notes.append(
            f"Scores of motion and interaction need the recording: `crowdbench data {how} {name}`."
        )
    notes += missing_notes(scene)
    if any(steered(entry.spawn) for entry in card.entries):
        notes.append(STEERED)
    return notes


def missing_notes(scene: "Scene") -> list[str]:
    """A note on registered metrics that could not be computed; empty if there are none."""
    from crowdbench.metrics import METRICS, all_metrics

    if len(all_metrics()) == len(METRICS):
        return []
    from crowdbench.data.recordings.catalogue import SOURCES
    from crowdbench.run.references import missing

    absent, name = missing(scene), scene.recording.name
    if not absent:
        return []
    how = "fetch" if name in SOURCES else "import"
    return [
        f"{', '.join(absent)} can only be computed with the recording: "
        f"`crowdbench data {how} {name}`."
    ]


def _print_distances(card: "Scorecard", names: "Names") -> None:
    entries = [e for e in card.entries if e.spawn != "replay"] or card.entries
    numbered = list(enumerate(entries, 1))
    layouts = (
        [_distance_table(card, numbered[k : k + size]) for k in range(0, len(numbered), size)]
        for size in range(len(numbered), 0, -1)
    )
    print_fitting(layouts, new_console())
    print_note("Plain distances to the recording, means over rollouts; 0: equal. Crowds:")
    for k, entry in numbered:
        print(f"{k:4d}  {names.pair(entry.spawn, entry.policy)}")
    print()


def _distance_table(card: "Scorecard", numbered: "Sequence[tuple[int, PairResult]]") -> "Table":
    from crowdbench.metrics import all_metrics, paper_first

    table = new_table("distance", "", "recorded", *(f"{k}" for k, _ in numbered))
    known = numbered[0][1].metrics
    for name, first in (
        (m.name, known[m.name]) for m in paper_first(all_metrics()) if m.name in known
    ):
        table.add_row(
            name.replace("_", " "),
            "scored" if name in card.scored else "",
            _typical(first.recorded, first.unit),
            *(_distance(entry.metrics[name].distance) for _, entry in numbered),
        )
    return table


def _typical(value: float | None, unit: str) -> str:
    return "–" if _undefined(value) else f"{value:.2f} {unit}".rstrip()


def _distance(value: float | None) -> str:
    return "–" if _undefined(value) else f"{value:.3f}"


def _undefined(value: float | None) -> bool:
    """Whether a value is NaN; scorecards store NaN as None, because JSON has no NaN."""
    return value is None or math.isnan(value)
