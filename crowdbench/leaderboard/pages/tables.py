"""The tables of a track: who is ranked with the references between them, and who is listed."""

from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise

from crowdbench.leaderboard.entry import Entry
from crowdbench.leaderboard.pages import axis
from crowdbench.leaderboard.pages.standings import Line, Standing, View
from crowdbench.leaderboard.pages.text import short
from crowdbench.report.words import NOTHING, plainly
from crowdbench.scoring import Score

OVERALL = View()
_SCORES = (
    "Scores with 95&nbsp;% intervals; 0 is the anchor, 1 (dashed) what the true process gets on "
    "average."
)
_RANKS = " Equal ranks (=) cannot be told apart. In italics: references."


def ranked_table(standing: Standing) -> str:
    """Ranks and scores in every view; the page shows one at a time."""
    order = {view: standing.ordered(view) for view in standing.views}
    places = {view: {o.entry.id: k for k, o in enumerate(order[view])} for view in order}

    def ranks(line: Line) -> str:
        cells = "".join(
            f'<span data-family="{view.family}" data-scene="{view.scene}" '
            f'data-value="{places[view][line.entry.id]}"{_hidden(view == OVERALL)}>'
            f"{standing.rank(line, view)}</span>"
            for view in standing.views
        )
        return f'<td class="rank">{cells}</td>'

    return _table(standing, order[OVERALL], f"Track {standing.track}", ranks)


def listed_table(standing: Standing) -> str:
    """Scores alone."""
    best = sorted(standing.listed, key=lambda line: line.worth(OVERALL))
    return _table(standing, best, f"Track {standing.track}, listed", None)


def _table(
    standing: Standing,
    lines: Sequence[Line],
    caption: str,
    ranks: Callable[[Line], str] | None,
) -> str:
    arrivals = standing.track != "walk"
    chosen = "".join(
        f'<span data-scene="{scene}" data-value=""{_hidden(not scene)}>{scene or "overall"}</span>'
        for scene in ("", *standing.scenes)
    )
    heads = f'<th scope="col" class="score" data-sort="down"><span>{chosen}</span></th>'
    heads += f'<th scope="col" class="plot" aria-label="drawn">{axis.ticks(axis.WIDE)}</th>'
    for scene in standing.scenes:
        heads += f'<th scope="col" class="scene" data-sort="down" data-column="{scene}">'
        heads += f"<span>{scene}</span></th>"
    for what in ["arrivals"] * arrivals + ["lives"]:
        heads += '<th scope="col" class="copy" data-sort="down">'
        heads += f"<span>copy of&nbsp;{what}</span></th>"
    rank = '<th scope="col" class="rank" data-sort="up" aria-sort="ascending">'
    rank += "<span>rank</span></th>"
    edges = _edges(lines, standing.ranks[OVERALL]) if ranks else {line.entry.id for line in lines}
    rows = "".join(
        _row(
            line,
            standing,
            arrivals=arrivals,
            first="" if ranks is None else ranks(line),
            edge=line.entry.id in edges,
        )
        for line in lines
    )
    return f"""<div class="scroll" role="region" aria-label="{caption}" tabindex="0">
<table class="standing{"" if ranks is None else " ranked"}">
<caption>{_SCORES}{_RANKS if ranks else ""}</caption>
<thead><tr>{"" if ranks is None else rank}<th scope="col" class="name" data-sort="up">\
<span>entry</span></th>{heads}</tr></thead>
<tbody>
{rows}</tbody>
</table>
</div>"""


def _edges(lines: Sequence[Line], ranks: Mapping[str, int]) -> set[str]:
    """Before whom a tie group ends."""
    competing = [line.entry.id for line in lines if line.entry.id in ranks]
    return {b for a, b in pairwise(competing) if ranks[a] != ranks[b]}


def _row(line: Line, standing: Standing, *, arrivals: bool, first: str, edge: bool) -> str:
    entry = line.entry
    kind = entry.declared.kind if entry.status != "reference" else "reference"
    cells = _chosen(line, standing) + "".join(
        f'<td class="scene" data-column="{scene}">{_families(line, standing, scene)}</td>'
        for scene in standing.scenes
    )
    copies = _copies(line, standing, 0) if arrivals else ""
    return (
        f'<tr class="{entry.status}{" edge" * edge}" data-kind="{kind}" '
        f'data-scenes="{" ".join(entry.scenes)}">'
        f'{first}<th scope="row" class="name">{_name(entry)}</th>{cells}{copies}'
        f"{_copies(line, standing, 1)}</tr>\n"
    )


def _hidden(shown: bool) -> str:
    return "" if shown else " hidden"


def _chosen(line: Line, standing: Standing) -> str:
    """The score in every view, and its bar in a cell of its own."""
    numbers, bars = "", ""
    for view in standing.views:
        score = line.scores.get(view)
        which = f'data-family="{view.family}" data-scene="{view.scene}" {_value(score)}'
        which += _hidden(view == OVERALL)
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


def _copies(line: Line, standing: Standing, which: int) -> str:
    found = ""
    for scene in ("", *standing.scenes):
        value = line.copied(scene)[which]
        number = "" if value is None else f"{value:.6f}"
        found += (
            f'<span data-scene="{scene}" data-value="{number}"{_hidden(not scene)}>'
            f"{(correlation, share)[which](value)}</span>"
        )
    return f'<td class="copy">{found}</td>'


def correlation(value: float | None) -> str:
    """Two decimals."""
    return NOTHING if value is None else plainly(value)


def share(value: float | None) -> str:
    """In per cent."""
    return NOTHING if value is None else f"{100 * value:.1f}\u00a0%"


def _name(entry: Entry) -> str:
    declared = entry.declared
    what = "reference" if entry.status == "reference" else declared.kind
    more = " et al." if len(declared.authors) > 1 else ""
    flags = ", ".join(dict.fromkeys(flag.what for flag in entry.flags))
    flagged = f'<small class="flagged">flagged: {flags}</small>' if flags else ""
    return (
        f'<a href="pages/{entry.id}.html">{short(declared.name)}</a>'
        f"<small>{what} · {short(declared.authors[0])}{more}</small>{flagged}"
    )
