"""How the command line prints a scorecard: as much in one table as there is room for."""

import math
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, TypeAlias

from crowdbench.cli.printing import new_console, new_table, print_fitting, print_note

if TYPE_CHECKING:
    from rich.table import Table

    from crowdbench.metrics import MetricResult
    from crowdbench.report.display_names import Names
    from crowdbench.scene import Scene
    from crowdbench.scoring.scorecard import PairResult, Row, Scorecard

    Column: TypeAlias = tuple[str, Callable[[Row], str]]

_NAME = 16  # characters that a name is folded to at the least


def print_card(card: "Scorecard", scene: "Scene") -> None:
    """Print scores and plain distances of all crowds, and what they mean."""
    from crowdbench.report.display_names import names_of
    from crowdbench.scoring.scorecard import rows

    table = rows(card)
    names = names_of([(row.spawn, row.policy) for row in table], scene)
    in_folds = " in each fold" if card.protocol == "heldout" else ""
    print()
    print_note(
        f"{card.scene}, protocol {card.protocol}: {card.horizon_s:.0f} s, {card.blocks} time "
        f"blocks, {_rollouts(card.rollouts)} of each pair{in_folds}."
    )
    print_fitting(_score_tables(table, names), new_console())
    for note in _notes(card, scene):
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
        "Plain distances to the recording; 0 is equal, – not defined here. A single crowd gets no "
        "score: a score needs several rollouts."
    )


def _rollouts(number: int) -> str:
    return f"{number} rollout{'s' * (number != 1)}"


def _score_tables(table: "Sequence[Row]", names: "Names") -> "Iterator[Sequence[Table]]":
    """Layouts, the widest first: all in one table, means before families, only one interval."""
    from crowdbench.metrics import FAMILIES, WALK
    from crowdbench.report.text.words import interval, number

    def family(name: str) -> "Column":
        return name, lambda row: number(row.families.get(name))

    def mean(name: str, *, whole: bool = True) -> "Column":
        return name, lambda row: (interval if whole else number)(getattr(row, name))

    crowds = [family(name) for name in FAMILIES if name not in WALK]
    walks = [family(name) for name in WALK]
    rank: Column = ("rank", lambda row: "" if row.rank is None else f"{row.rank}")
    ranked = "overall" if any(row.overall for row in table if row.kind == "entry") else "crowd"
    three = ("crowd", "walk", "overall")
    joint = [*crowds, mean("crowd"), *walks, mean("walk"), mean("overall"), rank]
    means = [*map(mean, three), rank]
    short = [*(mean(name, whole=name == ranked) for name in three), rank]
    families = [*crowds, *walks]
    for layout in ([joint], [means, families], [short, families]):
        yield [_score_table(columns, table, names) for columns in layout]


def _score_table(columns: "Sequence[Column]", table: "Sequence[Row]", names: "Names") -> "Table":
    made = new_table("spawn × policy", *(head for head, _ in columns))
    made.columns[0].min_width = _NAME
    for k, row in enumerate(table):
        if row.kind == "anchor" and table[k - 1].kind == "entry":
            made.add_section()
        made.add_row(names.pair(row.spawn, row.policy), *(cell(row) for _, cell in columns))
    return made


def _notes(card: "Scorecard", scene: "Scene") -> list[str]:
    """What the scores mean, and why some are missing."""
    from crowdbench.recordings.catalogue import SOURCES
    from crowdbench.report.text.words import STEERED
    from crowdbench.scoring.scorecard import ANCHOR, steered, walked

    notes = [
        f"Scores: 0 is the anchor ({' × '.join(ANCHOR)}; in motion and interaction straight "
        "walkers under the recorded arrivals), 1 what the true process gets on average; in "
        "brackets 95 % intervals. crowd is the mean of arrivals, presence, lives and space, walk "
        "that of motion and interaction, overall that of all six (– where nothing is scored). "
        "Equal ranks cannot be told apart (5 %, Holm). The last lines are anchors, for comparison: "
        "replay has the recording by heart, block-replay pieces of it."
    ]
    if not card.scored:
        notes.append(
            "No scores: no metric of this scene is scored yet. Run "
            f"`crowdbench power {scene.asked} --write`."
        )
    elif card.rollouts < 2 * card.fits:
        in_folds = " in each fold" if card.protocol == "heldout" else ""
        notes.append(
            f"No scores of your crowds: a score needs at least two rollouts of each of the "
            f"{card.fits} fits, {2 * card.fits} of each pair{in_folds}; "
            f"{card.rollouts} {'was' if card.rollouts == 1 else 'were'} made."
        )
    if not walked(card):
        name = scene.recording.name
        how = "fetch" if name in SOURCES else "import"
        notes.append(f"Motion and interaction need the recording: `crowdbench data {how} {name}`.")
    notes += missing_notes(scene)
    if any(steered(entry.spawn) for entry in card.entries):
        notes.append(STEERED)
    return notes


def missing_notes(scene: "Scene") -> list[str]:
    """What to say of metrics of others that could not be computed: nothing, or one note."""
    from crowdbench.metrics import METRICS, all_metrics

    if len(all_metrics()) == len(METRICS):
        return []
    from crowdbench.evaluation.references import missing
    from crowdbench.recordings.catalogue import SOURCES

    absent, name = missing(scene), scene.recording.name
    if not absent:
        return []
    how = "fetch" if name in SOURCES else "import"
    return [
        f"Without the recording {', '.join(absent)} cannot be computed: "
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
    print_note("Plain distances to the recording, means over the rollouts; 0 is equal. Crowds:")
    for k, entry in numbered:
        print(f"{k:4d}  {names.pair(entry.spawn, entry.policy)}")
    print()


def _distance_table(card: "Scorecard", numbered: "Sequence[tuple[int, PairResult]]") -> "Table":
    from crowdbench.metrics import all_metrics

    table = new_table("distance", "", "recorded", *(f"{k}" for k, _ in numbered))
    known = numbered[0][1].metrics
    for name, first in ((m.name, known[m.name]) for m in all_metrics() if m.name in known):
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
    """Scorecards hold None for NaN, which JSON does not have."""
    return value is None or math.isnan(value)
