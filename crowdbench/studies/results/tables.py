"""The page's tables, in Markdown: scores, and plain distances metric by metric."""

from collections.abc import Mapping, Sequence

import numpy as np

from crowdbench.metrics import FAMILIES, WALK, all_metrics
from crowdbench.report.text.markdown import table
from crowdbench.report.text.words import NOTHING, digits, interval, number
from crowdbench.scoring.scorecard import MetricCard, PairResult, Row, Scorecard, may_rank


def score_table(rows: Sequence[Row]) -> str:
    """Scores of all rows, in their order; who does not compete in italics."""
    crowd, walk = [f for f in FAMILIES if f not in WALK], list(WALK)
    head = ["spawn × policy", *crowd, "crowd", *walk, "walk", "overall", "rank"]
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
                interval(row.overall),
                NOTHING if row.rank is None else f"{row.rank}",
            ]
        )
    return table(head, lines)


def distance_table(
    card: Scorecard,
    families: Sequence[str] = FAMILIES,
    names: Mapping[str, str] | None = None,
) -> str:
    """Plain distances by metric and entry: mean ± standard deviation over the rollouts.

    `names` are those of policies, where they are all that tells entries apart.
    """
    first = card.entries[0].metrics
    names = {} if names is None else names
    columns = [names.get(entry.policy, pair(entry)) for entry in card.entries]
    lines = []
    for metric in all_metrics():
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
    """A typical value; empty where there is none."""
    return "" if value is None else f"{digits(value)} {unit}".rstrip()


def competes(row: Row) -> bool:
    """Whether it is a crowd that was evaluated, and no played recording."""
    return row.kind == "entry" and may_rank(row.spawn)


def pair(crowd: Row | PairResult) -> str:
    """Spawn model and policy."""
    return f"{crowd.spawn} × {crowd.policy}"


def _distance(card: MetricCard) -> str:
    """Of a single rollout there is no deviation."""
    if card.distance is None:
        return NOTHING
    known = [d for d in card.distances if d is not None]
    spread = f" ± {np.std(known, ddof=1):.3f}" if len(known) > 1 else ""
    return f"{card.distance:.3f}{spread}"
