"""The report's tables: scores with their intervals, metric by metric, how lives ended."""

import inspect
from collections.abc import Iterable, Sequence
from html import escape

from crowdbench.metrics import FAMILIES, WALK, Metric, all_metrics
from crowdbench.metrics.arrivals import burstiness, memory
from crowdbench.report.display_names import Names
from crowdbench.report.plots import PlotData
from crowdbench.report.text.words import NOTHING, digits, plainly
from crowdbench.scoring.score import LOWEST, Score
from crowdbench.scoring.scorecard import PairResult, Row, Scorecard, metric_scores, walked
from crowdbench.trajectories.table import OUTCOMES

_BAR = 76.0  # pixels


def score_table(card: Scorecard, table: Sequence[Row], names: Names) -> str:
    """All crowds by rank, those under the recorded arrivals, and the anchors."""
    crowds = by_rank(row for row in table if row.kind == "entry" and row.spawn != "replay")
    parts = {
        "Evaluated crowds, by rank" if any(r.rank for r in crowds) else "Evaluated crowds": crowds,
        "Policies under the recorded arrivals (not ranked)": [
            row for row in table if row.kind == "entry" and row.spawn == "replay"
        ],
        "Anchors, for comparison": [row for row in table if row.kind == "anchor"],
    }
    scale = _Scale([s for row in table for s in _scores(row)])
    bodies = []
    for name, of_part in parts.items():
        if not of_part:
            continue
        ranks = [row.rank for row in of_part]
        kind = of_part[0].kind
        lines = [
            _score_row(
                row,
                scale,
                names,
                tie=row.rank is not None and ranks.count(row.rank) > 1,
                edge=k > 0 and row.rank != ranks[k - 1],
                walk=kind == "anchor" or walked(card),
            )
            for k, row in enumerate(of_part)
        ]
        bodies.append(
            f'<tbody class="{kind}"><tr class="part"><th colspan="11" scope="rowgroup">'
            f"<span>{name}</span></th></tr>{''.join(lines)}</tbody>"
        )
    families = "".join(f'<th scope="col">{family}</th>' for family in FAMILIES)
    return f"""<div class="scroll" role="region" aria-label="Table of scores" tabindex="0">
<table class="scores">
<caption>Scores with 95 % intervals. {scale.key()}</caption>
<thead>
<tr><td colspan="2"></td><th colspan="4" scope="colgroup">how people come and go</th>
<th colspan="2" scope="colgroup">how they walk</th><th colspan="3" scope="colgroup">means</th></tr>
<tr><th scope="col">rank</th><th scope="col" class="name">spawn × policy</th>{families}
<th scope="col">crowd</th><th scope="col">walk</th><th scope="col">overall</th></tr>
</thead>
{"".join(bodies)}
</table>
</div>"""


def by_rank(crowds: Iterable[Row]) -> list[Row]:
    """The best first, also among those of equal rank."""
    return sorted(crowds, key=lambda row: (row.rank or 0, -_value(row.overall or row.crowd)))


def _scores(row: Row) -> list[Score]:
    every = [*row.families.values(), row.crowd, row.walk, row.overall]
    return [score for score in every if score is not None]


def _value(score: Score | None) -> float:
    return LOWEST if score is None else score.value


def _score_row(
    row: Row, scale: "_Scale", names: Names, *, tie: bool, edge: bool, walk: bool
) -> str:
    rank = "" if row.rank is None else f"{row.rank}"
    if tie:
        rank += '<span class="tie" title="cannot be told apart from crowds of the same rank">'
        rank += "&#8239;=</span>"
    missing = '<td class="missing">needs recording</td>'
    cells = [
        scale.cell(row.families.get(family)) if walk or family not in WALK else missing
        for family in FAMILIES
    ]
    cells += [scale.cell(row.crowd), scale.cell(row.walk) if walk else missing]
    cells += [scale.cell(row.overall) if walk else missing]
    return (
        f'<tr{" class=edge" if edge else ""}><td class="rank">{rank}</td>'
        f'<th scope="row" class="name">{_pair(row, names)}</th>{"".join(cells)}</tr>\n'
    )


def _pair(crowd: Row | PairResult, names: Names) -> str:
    spawn, policy = names.spawn[crowd.spawn], names.policy[crowd.policy]
    return f"<span>{escape(spawn)}</span> <span>× {escape(policy)}</span>"


class _Scale:
    """The common scale of all dots and whiskers of a table."""

    def __init__(self, scores: Sequence[Score]) -> None:
        ends = [end for s in scores for end in (*s.interval, s.value)]
        self.low, self.high = min([-0.25, *ends]) - 0.05, max([1.25, *ends]) + 0.05

    def _x(self, value: float) -> str:
        return f"{(value - self.low) / (self.high - self.low) * _BAR:.1f}"

    def bar(self, score: Score) -> str:
        """A dot with its whiskers between the lines of 0 and 1."""
        zero, one = self._x(0.0), self._x(1.0)
        low, high = map(self._x, score.interval)
        return (
            f'<svg class="bar" viewBox="0 0 {_BAR:g} 12" width="{_BAR:g}" height="12" '
            f'aria-hidden="true"><path class="zero" d="M{zero} 0V12"/>'
            f'<path class="one" d="M{one} 0V12"/><path class="whisker" d="M{low} 6H{high}"/>'
            f'<circle cx="{self._x(score.value)}" cy="6" r="3"/></svg>'
        )

    def cell(self, score: Score | None) -> str:
        """Number, bar and interval."""
        if score is None:
            return f'<td class="missing">{NOTHING}</td>'
        low, high = map(plainly, score.interval)
        return (
            f'<td><span class="n">{plainly(score.value)}</span>{self.bar(score)}'
            f'<span class="i">[{low},&nbsp;{high}]</span></td>'
        )

    def key(self) -> str:
        """What the bars mean."""
        zero, one, low, high = (self._x(v) for v in (0.0, 1.0, 0.3, 0.9))
        return (
            f'<span class="nobreak"><svg class="bar" viewBox="0 0 {_BAR:g} 12" '
            f'width="{_BAR:g}" height="12" aria-hidden="true"><path class="zero" '
            f'd="M{zero} 0V12"/><path class="one" d="M{one} 0V12"/><path class="whisker" '
            f'd="M{low} 6H{high}"/><circle cx="{self._x(0.6)}" cy="6" r="3"/></svg></span> '
            "Dot: score, whiskers: interval, solid line: 0 (anchor), dashed line: 1 (the true "
            "process on average). Crowds marked = share a rank."
        )


def metric_tables(card: Scorecard, plot: PlotData, names: Names) -> str:
    """Every metric of the crowds, then the walking ones of policies under recorded arrivals."""
    crowds = [e for e in card.entries if e.spawn != "replay"]
    walkers = [e for e in card.entries if e.spawn == "replay"]
    if not crowds:
        return _metric_table(card, plot, names, walkers, all_metrics(), "Metrics of each crowd")
    policies = [metric for metric in all_metrics() if metric.family in WALK]
    first = _metric_table(card, plot, names, crowds, all_metrics(), "Metrics of each crowd")
    if not walkers:
        return first
    second = _metric_table(
        card, plot, names, walkers, policies, "Metrics of walking, under the recorded arrivals"
    )
    return f"{first}\n<h3>Walking under the recorded arrivals</h3>\n{second}"


def _metric_table(
    card: Scorecard,
    plot: PlotData,
    names: Names,
    entries: Sequence[PairResult],
    metrics: Sequence[Metric],
    caption: str,
) -> str:
    each = [metric_scores(card, entry) for entry in entries]
    heads = "".join(f'<th scope="col">{_pair(e, names)}</th>' for e in entries)
    bodies = []
    for family in FAMILIES:
        lines = []
        for metric in metrics:
            if metric.family != family or metric.name not in entries[0].metrics:
                continue
            cells = [
                _metric_cell(entry, metric, scores.get(metric.name))
                for entry, scores in zip(entries, each, strict=True)
            ]
            recorded = entries[0].metrics[metric.name].recorded
            mark = '<span class="badge scored">scored</span>' if metric.name in card.scored else ""
            lines.append(
                f'<tr><th scope="row" class="metric">{metric.name.replace("_", " ")}{mark}'
                f"<small>{_definition(metric)}</small></th>"
                f"<td>{_with_unit(recorded, metric.unit)}</td>{''.join(cells)}</tr>\n"
            )
            if metric.name == "inter_spawn":
                lines += _gap_rows(plot, entries)
        if lines:
            bodies.append(
                f'<tbody><tr class="part"><th colspan="{2 + len(entries)}" scope="rowgroup">'
                f"<span>{family}</span></th></tr>{''.join(lines)}</tbody>"
            )
    walking = (
        " Motion and interaction are scored under the recorded arrivals only."
        if any(entry.spawn != "replay" for entry in entries)
        else ""
    )
    return f"""<div class="scroll" role="region" aria-label="{caption}" tabindex="0">
<table class="metrics">
<caption>{caption}: typical value, plain distance d to the recording and, for metrics
that are <span class="s">scored</span>, the <span class="s">score</span> with its interval. A
typical value is a mean, unless the definition says what else; {NOTHING} where there is
none.{walking}</caption>
<thead><tr><th scope="col" class="metric">metric</th><th scope="col">recorded</th>
{heads}</tr></thead>
{"".join(bodies)}
</table>
</div>"""


def _definition(metric: Metric) -> str:
    first = (inspect.getdoc(type(metric)) or "").split("\n\n")[0]
    return escape(" ".join(first.split()).replace("`", ""))


def _with_unit(value: float | None, unit: str) -> str:
    if value is None:
        return NOTHING
    # A column of bare numbers reads more easily than one of persons.
    shown = "" if unit in ("", "persons") else f"&nbsp;{escape(unit)}"
    return f'<span class="nobreak">{escape(digits(value))}{shown}</span>'


def _metric_cell(entry: PairResult, metric: Metric, score: Score | None) -> str:
    card = entry.metrics[metric.name]
    distance = NOTHING if card.distance is None else f"{card.distance:.3f}"
    lines = [
        f'<span class="v">{_with_unit(card.simulated, metric.unit)}</span>',
        f'<span class="d">d&nbsp;{distance}</span>',
    ]
    if score is not None:
        low, high = map(plainly, score.interval)
        lines.append(
            f'<span class="s">{plainly(score.value)} <span class="i">[{low},&nbsp;{high}]</span>'
            "</span>"
        )
    return f"<td>{''.join(lines)}</td>"


def _gap_rows(plot: PlotData, entries: Sequence[PairResult]) -> list[str]:
    """Burstiness and memory of the gaps between arrivals."""
    (recorded, *groups), support = plot.pooled("inter_spawn")
    by_pair = {(g.spawn, g.policy): sums for g, sums in zip(plot.groups, groups, strict=True)}
    found = []
    for name, what, value in (
        (
            "burstiness",
            "Of inter-spawn gaps, (σ − μ)/(σ + μ): −1 is a clock, 0 Poisson, 1 bursts.",
            lambda sums: burstiness(sums, support),
        ),
        (
            "memory",
            "Correlation of consecutive gaps: above 0 short ones follow short ones.",
            memory,
        ),
    ):
        cells = ""
        for entry in entries:
            sums = by_pair.get((entry.spawn, entry.policy))
            cells += f"<td>{NOTHING if sums is None else plainly(value(sums))}</td>"
        found.append(
            f'<tr><th scope="row" class="metric">{name}<small>{what} Over the rollouts that '
            f"pictures show.</small></th>"
            f"<td>{plainly(value(recorded))}</td>{cells}</tr>\n"
        )
    return found


def outcome_table(card: Scorecard, names: Names) -> str:
    """Persons of each crowd, and the shares of their outcomes."""
    outcomes = [o for o in OUTCOMES if any(o in e.outcomes for e in card.entries)]
    lines = []
    for entry in card.entries:
        shares = [entry.outcomes.get(o, 0) / max(1, entry.persons) for o in outcomes]
        cells = "".join(f"<td>{100 * share:.1f}&nbsp;%</td>" for share in shares)
        lines.append(
            f'<tr><th scope="row" class="name">{_pair(entry, names)}</th>'
            f"<td>{len(entry.seeds)}</td><td>{entry.persons:,}</td>{cells}</tr>\n"
        )
    heads = "".join(f'<th scope="col">{outcome}</th>' for outcome in outcomes)
    return f"""<div class="scroll" role="region" aria-label="How lives ended" tabindex="0">
<table class="outcomes">
<caption>Goal: reached it; exit: left the bounds elsewhere; timeout: took too long; horizon: still
there when the rollout ended; recorded: taken out with the recording’s last sight of them.</caption>
<thead><tr><th scope="col" class="name">spawn × policy</th><th scope="col">rollouts</th>
<th scope="col">persons</th>{heads}</tr></thead>
<tbody>{"".join(lines)}</tbody>
</table>
</div>"""
