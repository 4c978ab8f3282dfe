"""The tables of a track: who is ranked with the references between them, and who is listed."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

from crowdbench.leaderboard.pages import axis
from crowdbench.leaderboard.pages.standings import Line, Standing, View
from crowdbench.leaderboard.pages.text import short
from crowdbench.leaderboard.submission.schema import Track
from crowdbench.report.text.words import NOTHING, plainly
from crowdbench.scoring.score import Score

OVERALL = View()
COPIED = ("arrivals", "lives")
_SCORES: dict[Track, str] = {
    "walk": "Scores with 95&nbsp;% intervals: 0 is what straight walkers get, 1 (dashed) what the "
    "recording itself gets.",
    "spawn": "Scores with 95&nbsp;% intervals: 0 is what poisson-gmm gets, 1 (dashed) what the "
    "process that made the recording would get on average.",
    "crowd": "Scores with 95&nbsp;% intervals: 0 is what poisson-gmm with straight walkers gets, 1 "
    "(dashed) what the process that made the recording would get on average.",
}
_RANKS = " Equal ranks (=) cannot be told apart. In italics: references."


def ranked_table(standing: Standing) -> str:
    """Ranks and scores in every view; the page shows one at a time."""
    order = {view: standing.ordered(view) for view in standing.views}
    places = {view: {o.entry.id: k for k, o in enumerate(order[view])} for view in order}
    edges = _edges(order[OVERALL], standing.ranks[OVERALL])
    rows = ""
    for line in order[OVERALL]:
        ranks = "".join(
            f'<span {_which(view)} data-value="{places[view][line.entry.id]}">'
            f"{standing.rank(line, view)}</span>"
            for view in standing.views
        )
        cells = f'<td class="rank">{ranks}</td>{_cells(line, standing)}'
        rows += _row(line, cells, edge=line.entry.id in edges)
    rank = '<th scope="col" class="rank" data-sort="up" aria-sort="ascending">'
    return _table(standing, f"{rank}<span>rank</span></th>", rows, ranked=True)


def listed_table(standing: Standing) -> str:
    """Scores alone."""
    best = sorted(standing.listed, key=lambda line: line.worth(OVERALL))
    rows = "".join(_row(line, _cells(line, standing), edge=True) for line in best)
    return _table(standing, "", rows, ranked=False)


def _table(standing: Standing, first: str, rows: str, *, ranked: bool) -> str:
    label = f"Track {standing.track}{'' if ranked else ', listed'}"
    return f"""<div class="scroll" role="region" aria-label="{label}" tabindex="0">
<table class="standing{" ranked" * ranked}">
<caption>{_SCORES[standing.track]}{_RANKS * ranked}</caption>
<thead><tr>{first}{_heads(standing)}</tr></thead>
<tbody>
{rows}</tbody>
</table>
</div>"""


def _heads(standing: Standing) -> str:
    """All but the rank's."""
    chosen = "".join(
        f'<span data-scene="{scene}"{_hidden(not scene)}>{scene or "overall"}</span>'
        for scene in ("", *standing.scenes)
    )
    scenes = "".join(
        f'<th scope="col" class="scene" data-sort="down" data-column="{scene}">'
        f"<span>{scene}</span></th>"
        for scene in standing.scenes
    )
    copies = "".join(
        f'<th scope="col" class="copy" data-sort="down"><span>copy of&nbsp;{what}</span></th>'
        for what in copied(standing)
    )
    return f"""<th scope="col" class="name" data-sort="up"><span>entry</span></th>
<th scope="col" class="score" data-sort="down"><span>{chosen}</span></th>
<th scope="col" class="plot" aria-label="drawn">{axis.ticks(axis.WIDE)}</th>
{scenes}{copies}"""


def _edges(lines: Sequence[Line], ranks: Mapping[str, int]) -> set[str]:
    """Before whom a tie group ends."""
    competing = [line.entry.id for line in lines if line.entry.id in ranks]
    return {b for a, b in pairwise(competing) if ranks[a] != ranks[b]}


def _row(line: Line, cells: str, *, edge: bool) -> str:
    entry = line.entry
    kind = entry.declared.kind if entry.status != "reference" else "reference"
    return (
        f'<tr class="{entry.status}{" edge" * edge}" data-kind="{kind}" '
        f'data-scenes="{" ".join(entry.scenes)}">{cells}</tr>\n'
    )


def _cells(line: Line, standing: Standing) -> str:
    """All but the rank's."""
    scenes = "".join(
        f'<td class="scene" data-column="{scene}">{_families(line, standing, scene)}</td>'
        for scene in standing.scenes
    )
    copies = "".join(_copies(line, standing, what) for what in copied(standing))
    name = f'<th scope="row" class="name">{_name(line, standing)}</th>'
    return f"{name}{_chosen(line, standing)}{scenes}{copies}"


def copied(standing: Standing) -> tuple[str, ...]:
    """Of what copies are told; arrivals on track walk are the recorded ones by rule."""
    return ("lives",) if standing.track == "walk" else COPIED


def _hidden(shown: bool) -> str:
    return "" if shown else " hidden"


def _which(view: View) -> str:
    """Marks what is shown in this view alone."""
    hidden = _hidden(view == OVERALL)
    return f'data-family="{view.family}" data-scene="{view.scene}"{hidden}'


def _chosen(line: Line, standing: Standing) -> str:
    """The score in every view, and its bar in a cell of its own."""
    numbers, bars = "", ""
    for view in standing.views:
        score = line.scores.get(view)
        which = f"{_which(view)} {_value(score)}"
        numbers += f"<div {which}>{axis.number(score)}</div>"
        drawn = axis.no_bar(axis.WIDE)
        if score is not None:
            drawn = axis.bar(score.value, score.interval, axis.WIDE)
        bars += f"<div {which}>{drawn}</div>"
    return f'<td class="score">{numbers}</td><td class="plot">{bars}</td>'


def _families(line: Line, standing: Standing, scene: str) -> str:
    """The numbers of one scene: of all families together, and of each."""
    found = ""
    for family in ("", *standing.families):
        score = line.scores.get(View(family, scene))
        found += (
            f'<div data-family="{family}" {_value(score)}{_hidden(not family)}>'
            f"{axis.number(score)}</div>"
        )
    return found


def _value(score: Score | None) -> str:
    return f'data-value="{"" if score is None else f"{score.value:.6f}"}"'


def _copies(line: Line, standing: Standing, what: str) -> str:
    found = ""
    for scene in ("", *standing.scenes):
        arrivals, lives = line.copied(scene)
        value = arrivals if what == "arrivals" else lives
        shown = correlation(value) if what == "arrivals" else share(value)
        number = "" if value is None else f"{value:.6f}"
        found += (
            f'<span data-scene="{scene}" data-value="{number}"{_hidden(not scene)}>{shown}</span>'
        )
    return f'<td class="copy">{found}</td>'


def correlation(value: float | None) -> str:
    """Two decimals."""
    return NOTHING if value is None else plainly(value)


def share(value: float | None) -> str:
    """In per cent."""
    return NOTHING if value is None else f"{100 * value:.1f}\u00a0%"


def _name(line: Line, standing: Standing) -> str:
    entry, declared = line.entry, line.entry.declared
    more = " et al." if len(declared.authors) > 1 else ""
    flags = ", ".join(dict.fromkeys(flag.what for flag in entry.flags))
    flagged = f'<small class="flagged">flagged: {flags}</small>' if flags else ""
    yours = '<span class="yours">yours</span>' if entry.id in (standing.yours or ()) else ""
    return (
        f'<a href="pages/{entry.id}.html">{short(declared.name)}</a>{yours}'
        f"<small>{line.kind} · {short(declared.authors[0])}{more}</small>{flagged}"
    )
