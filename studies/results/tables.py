"""The tables of the results page in Markdown: scores, and plain distances by metric."""

from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench.metrics import FAMILIES, WALK, all_metrics, paper_first
from crowdbench.report.text.words import NOTHING, digits, interval, number, share, speed
from crowdbench.scoring.ranking import Row, may_rank
from crowdbench.scoring.scorecard import MetricCard, PairResult, Scorecard
from studies.markdown import table


def score_table(rows: Sequence[Row]) -> str:
    """Markdown table with the scores of all rows, in their order; baselines are in italics."""
    crowd, walk = [f for f in FAMILIES if f not in WALK], list(WALK)
    gate = ["speed, m/s", "at goal"]
    head = ["spawn × policy", *crowd, "crowd", *walk, "walk", *gate, "overall", "rank"]
    lines = []
    for row in rows:
        name = pair(row)
        lines.append(
            [
                name if competes(row) else f"*{name}*",
                *(number(row.families.get(family)) for family in crowd),
                interval(row.crowd),
                *(number(row.families.get(family)) for family in walk),
                interval(row.walk),
                gated(row, "speed", speed(row.entry.speed_mps)),
                gated(row, "arrivals", share(row.entry.at_goal)),
                interval(row.overall),
                NOTHING if row.rank is None else f"{row.rank}",
            ]
        )
    return table(head, lines)


def gated(row: Row, limit: str, value: str) -> str:
    """A value of the gate, bold and marked where the policy exceeds the limit."""
    return f"**{value} !**" if limit in row.fails else value


def distance_table(
    card: Scorecard,
    families: Sequence[str] = FAMILIES,
    names: Mapping[str, str] | None = None,
) -> str:
    """Markdown table of plain distances: mean ± standard deviation over the rollouts.

    Columns are named after the pairs, or after the policies if `names` gives their display names.
    """
    first = card.entries[0].metrics
    names = {} if names is None else names
    columns = [names.get(entry.policy, pair(entry)) for entry in card.entries]
    lines = []
    for metric in paper_first(all_metrics()):
        if metric.name in first and metric.family in families:
            lines.append(
                [
                    metric.family,
                    metric.name.replace("_", " "),
                    "scored" if metric.name in card.scored else "",
                    with_unit(first[metric.name].recorded, metric.unit) or NOTHING,
                    *(_distance(entry.metrics[metric.name]) for entry in card.entries),
                ]
            )
    return table(["family", "metric", "", "recorded", *columns], lines, text=3)


def with_unit(value: float | None, unit: str) -> str:
    """A typical value with its unit; empty if the value is None."""
    return "" if value is None else f"{digits(value)} {unit}".rstrip()


def competes(row: Row) -> bool:
    """Whether the row is an evaluated crowd that may be ranked (not a replay)."""
    return row.kind == "entry" and may_rank(row.spawn)


def pair(crowd: Row | PairResult) -> str:
    """Name of a pair: `spawn × policy`."""
    return f"{crowd.spawn} × {crowd.policy}"


def _distance(card: MetricCard) -> str:
    """A distance ± its standard deviation, which is left out for a single rollout."""
    if card.distance is None:
        return NOTHING
    known = [d for d in card.distances if d is not None]
    spread = f" ± {np.std(known, ddof=1):.3f}" if len(known) > 1 else ""
    return f"{card.distance:.3f}{spread}"
