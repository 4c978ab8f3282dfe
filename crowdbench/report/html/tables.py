"""The report's tables: scores with intervals, single metrics, and outcomes of trips."""

import inspect
from collections.abc import Iterable, Sequence
from typing import Any

from markupsafe import Markup

from crowdbench.data.table import OUTCOMES
from crowdbench.metrics import FAMILIES, WALK, Metric, all_metrics
from crowdbench.metrics.arrivals import burstiness, memory
from crowdbench.report.display_names import Names
from crowdbench.report.html.render import html
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.report.text.notes import gate_notes, too_few_rollouts
from crowdbench.scoring import ranking
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import PairResult, Scorecard, has_recorded_arrivals
from crowdbench.spawn.names import replays


def score_table(card: Scorecard, table: Sequence[ranking.Row], names: Names) -> Markup:
    """HTML table of scores: crowds and policies under recorded arrivals by rank, baselines.

    Above it is a summary of the ranks, below it an explanation of the columns.
    """
    by, table = ranking.ranked_by(table), ranking.ordered(table)
    entries = [row for row in table if row.kind == "entry"]
    crowds = [row for row in entries if not replays(row.spawn)]
    walkers = [row for row in entries if replays(row.spawn)]
    return html(
        "scores.html.j2",
        card=card,
        names=names,
        families=FAMILIES,
        walk=WALK,
        gate=card.gate,
        walked=has_recorded_arrivals(card),
        steered=any(ranking.steered(entry.spawn) for entry in card.entries),
        by=by,
        competing=ranking.competing_rows(table),
        first=[
            (names.pair(row.spawn, row.policy), getattr(row, by)) for row in table if row.rank == 1
        ],
        parts={
            f"Evaluated crowds{_ordered_by(crowds, by)}": crowds,
            f"Policies under the recorded arrivals{_ordered_by(walkers, by)}": walkers,
            "Baselines (not ranked)": [row for row in table if row.kind == "baseline"],
        },
        too_few_rollouts=too_few_rollouts,
        beyond_gate=gate_notes(card, table, names),
        scale=_Scale(
            score
            for row in table
            for score in (*row.families.values(), row.crowd, row.walk, row.overall)
            if score is not None
        ),
    )


def _ordered_by(rows: Sequence[ranking.Row], by: str) -> str:
    """How a part of the table is sorted, as an addition to its name."""
    if any(row.rank is not None for row in rows):
        return f", by rank ({by})"
    return " (not ranked)" if rows and replays(rows[0].spawn) else ""


class _Scale:
    """The common horizontal scale of all score bars of a table."""

    width = 76  # pixels

    def __init__(self, scores: Iterable[Score]) -> None:
        ends = [end for s in scores for end in (*s.interval, s.value)]
        self.low, self.high = min([-0.25, *ends]) - 0.05, max([1.25, *ends]) + 0.05

    def x(self, value: float) -> str:
        """The position of a score in pixels."""
        return f"{(value - self.low) / (self.high - self.low) * self.width:.1f}"


def metric_tables(card: Scorecard, plot: PlotData, names: Names) -> Markup:
    """HTML tables: all metrics of the crowds; motion and interaction under recorded arrivals."""
    crowds = [e for e in card.entries if not replays(e.spawn)]
    walkers = [e for e in card.entries if replays(e.spawn)]
    first = crowds or walkers
    tables = [_metric_table("Metrics of each crowd", card, first, FAMILIES)]
    if crowds and walkers:
        caption = "Motion and interaction under the recorded arrivals"
        tables.append(_metric_table(caption, card, walkers, WALK))
    return html(
        "metrics.html.j2",
        names=names,
        scored=card.scored,
        tables=tables,
        definition=_definition,
        gaps=_gaps(plot, first),
    )


def _metric_table(
    caption: str, card: Scorecard, entries: Sequence[PairResult], families: Sequence[str]
) -> dict[str, Any]:
    """A table with a column for each entry, and a row for each metric of the families."""
    shown = [metric for metric in all_metrics() if metric.name in entries[0].metrics]
    scale = ranking.scale_of(card)
    return {
        "caption": caption,
        "entries": entries,
        "scores": [ranking.metric_scores(scale, entry) for entry in entries],
        "families": {family: [m for m in shown if m.family == family] for family in families},
    }


def _definition(metric: Metric) -> str:
    first = (inspect.getdoc(type(metric)) or "").split("\n\n")[0]
    return " ".join(first.split()).replace("`", "")


def _gaps(
    plot: PlotData, entries: Sequence[PairResult]
) -> list[tuple[str, str, float, list[float | None]]]:
    """Burstiness and memory of the gaps between arrivals, each with a definition.

    The values are that of the recording and those of the entries, of which some are not drawn.
    """
    (recorded, *groups), support = plot.pooled("inter_spawn")
    by_pair = {(g.spawn, g.policy): sums for g, sums in zip(plot.groups, groups, strict=True)}
    each = [by_pair.get((entry.spawn, entry.policy)) for entry in entries]
    burst = "(σ − μ)/(σ + μ) of the gaps: −1 for regular arrivals, 0 for Poisson, 1 for bursts."
    follow = "Correlation of consecutive gaps; positive if short gaps follow short gaps."
    return [
        (name, what, value(recorded), [None if sums is None else value(sums) for sums in each])
        for name, what, value in (
            ("burstiness", burst, lambda sums: burstiness(sums, support)),
            ("memory", follow, memory),
        )
    ]


def outcome_table(card: Scorecard, names: Names) -> Markup:
    """HTML table of the number of persons in each crowd and the shares of their outcomes."""
    outcomes = [o for o in OUTCOMES if any(o in e.outcomes for e in card.entries)]
    return html("outcomes.html.j2", entries=card.entries, outcomes=outcomes, names=names)
