"""Scores as JSON for other programs: one row per crowd, with its scores and plain distances."""

from typing import Any

from crowdbench.scoring.ranking import ranked_by
from crowdbench.scoring.score import Score
from crowdbench.scoring.scorecard import Row, Scorecard, rows


def score_rows(card: Scorecard) -> dict[str, Any]:
    """The rows of a scorecard's table: the crowds in their order, then the unranked baselines.

    Spawn models and policies have the names that they were given. Scores and distances that are
    not defined are None. `ranked_by` names the score that the ranks compare.
    """
    table = rows(card)
    return {"ranked_by": ranked_by(table), "rows": [_row(row, card) for row in table]}


def _row(row: Row, card: Scorecard) -> dict[str, Any]:
    return {
        "spawn": row.spawn,
        "policy": row.policy,
        "protocol": card.protocol,
        "kind": row.kind,
        "families": {family: _score(score) for family, score in row.families.items()},
        "crowd": _score(row.crowd),
        "walk": _score(row.walk),
        "overall": _score(row.overall),
        "rank": row.rank,
        "rollouts": len(row.entry.seeds),
        "distances": {name: metric.distance for name, metric in row.entry.metrics.items()},
        "mean_speed_mps": row.entry.speed_mps,
        "at_goal": row.entry.at_goal,
        "gate": list(row.fails),
    }


def _score(score: Score | None) -> dict[str, Any] | None:
    return None if score is None else {"score": score.value, "interval": score.interval}
