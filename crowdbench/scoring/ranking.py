"""The table of a scorecard: scores of each crowd, the gate, who competes, and ranks."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from crowdbench.metrics import METRICS, WALK
from crowdbench.scoring import scorecard
from crowdbench.scoring.energy import Energy
from crowdbench.scoring.score import (
    Score,
    crowd_score,
    family_scores,
    overall_score,
    ranks,
    score_of,
    walk_score,
)
from crowdbench.spawn.names import replays
from crowdbench.spawn.steering.scenario import split_scenario

RankedBy = Literal["walk", "overall", "crowd"]
"""The score that the ranks of a table compare; also the name of its field in `Row`."""
RECORDED_POLICIES = ("replay", "recorded-paths")
"""Policies that follow recorded paths. They need recorded arrivals and are not ranked."""


@dataclass(frozen=True, eq=False)
class Row:
    """A row of the table of scores."""

    spawn: str
    policy: str
    kind: Literal["entry", "baseline"]
    entry: scorecard.PairResult
    families: dict[str, Score]
    """Score of each family; motion and interaction are scored under the recorded arrivals."""
    crowd: Score | None
    """Mean over arrivals, presence, trips and space; evaluates the spawn model if `policy` is
    `straight`."""
    walk: Score | None
    """The lesser of motion and interaction; None if the recording is needed and not imported."""
    overall: Score | None
    """Mean of crowd and walk."""
    fails: tuple[scorecard.Limit, ...]
    """Why the policy does not pass the scene's gate, `speed` and `arrivals`; empty if it does."""
    rank: int | None = None
    """Rank by the score that `ranked_by` names; None if the row does not compete."""

    @property
    def walk_without_gate(self) -> Score | None:
        """What `walk` would be if the policy passed the scene's gate."""
        return walk_score(self.families, passes=True)


def scale_of(card: scorecard.Scorecard) -> dict[str, tuple[Energy, Energy]]:
    """Noise floor and energy score of the anchor for each scored metric."""
    by_pair = {(e.spawn, e.policy): e for e in card.scale.anchors}
    scale = {}
    for metric in METRICS:
        walks = metric.family in WALK
        anchor = by_pair[scorecard.WALK_ANCHOR if walks else scorecard.ANCHOR].metrics.get(
            metric.name
        )
        floor = card.scale.floor.get(metric.name)
        if metric.name not in card.scored or anchor is None or floor is None:
            continue
        if anchor.energy is not None:
            nothing = Energy(0.0, np.zeros(card.resamples))
            scale[metric.name] = (nothing if walks else floor.energy(), anchor.energy.energy())
    return scale


def metric_scores(
    scale: dict[str, tuple[Energy, Energy]], entry: scorecard.PairResult
) -> dict[str, Score | None]:
    """The score of an entry in each scored metric, on the scale of `scale_of`; None for none."""
    scores: dict[str, Score | None] = {}
    for name, (floor, anchor) in scale.items():
        energy = entry.metrics[name].energy
        scores[name] = score_of(energy.energy(), floor, anchor) if energy is not None else None
    return scores


def rows(card: scorecard.Scorecard) -> list[Row]:
    """The table of a scorecard: its entries in their order, then the baselines.

    The scores of motion and interaction are those of the policy under the recorded arrivals
    (spawn model `replay`), and apply to all crowds with the same policy. Under perturbed arrivals
    they are those of the entry itself.
    """
    scale, recorded = scale_of(card), scorecard.has_recorded_arrivals(card)

    def row(entry: scorecard.PairResult, kind: Literal["entry", "baseline"]) -> Row:
        # The walk scores of baselines are shipped; those of entries need the imported recording.
        walker = walker_of(card, entry.policy) if kind == "baseline" or recorded else None
        walker = entry if replays(entry.spawn) else walker
        scores = metric_scores(scale, entry)
        if walker is not None:
            walked = metric_scores(scale, walker)
            scores |= {
                m.name: walked[m.name] for m in METRICS if m.family in WALK and m.name in scale
            }
        families = family_scores(scores, card.scored)
        fails = () if walker is None else failures(card, walker)
        crowd, walk = crowd_score(families), walk_score(families, passes=not fails)
        whole = overall_score(crowd, walk)
        return Row(entry.spawn, entry.policy, kind, entry, families, crowd, walk, whole, fails)

    pairs = {(e.spawn, e.policy) for e in card.entries}
    others = [e for e in card.scale.anchors if (e.spawn, e.policy) not in pairs]
    entries = _ranked([row(e, "entry") for e in card.entries])
    return [*entries, *(row(e, "baseline") for e in others)]


def walker_of(card: scorecard.Scorecard, policy: str) -> scorecard.PairResult | None:
    """A policy's result under the recorded arrivals, which the gate judges; None without one."""
    everyone = [*card.entries, *card.scale.anchors]
    return next((e for e in everyone if (e.spawn, e.policy) == ("replay", policy)), None)


def gate_standard(card: scorecard.Scorecard) -> scorecard.PairResult:
    """The result of recorded people walked under the rules of the simulation."""
    return next(e for e in card.scale.anchors if (e.spawn, e.policy) == scorecard.GATE_STANDARD)


def failures(card: scorecard.Scorecard, entry: scorecard.PairResult) -> tuple[scorecard.Limit, ...]:
    """Which limits of the scene's gate a policy exceeds, `speed` or `arrivals`; empty for none.

    `entry` is the policy's result under the recorded arrivals. Its mean walking speed and its share
    of people at their goals are compared with those of recorded people walked. A share that is
    unknown, as for the policy `replay`, is not compared.
    """
    standard = gate_standard(card)
    exceeded: list[scorecard.Limit] = []
    if standard.speed_mps is not None:
        speed = 0.0 if entry.speed_mps is None else entry.speed_mps
        if abs(speed / standard.speed_mps - 1) > card.gate.speed:
            exceeded.append("speed")
    at_goal = 1.0 if entry.at_goal is None else entry.at_goal
    if standard.at_goal is not None and at_goal < card.gate.arrivals * standard.at_goal:
        exceeded.append("arrivals")
    return tuple(exceeded)


def steered(spawn: str) -> bool:
    """Whether a spawn model's name includes a scenario."""
    return split_scenario(spawn)[1] is not None


def may_rank(spawn: str) -> bool:
    """Whether entries with this spawn model are ranked.

    Replayed recordings are not ranked, because they memorise the recording. Models under a
    scenario are not ranked, because they are meant to differ from it.
    """
    return not replays(spawn) and spawn != "block-replay" and not steered(spawn)


def competing_rows(table: Sequence[Row]) -> list[Row]:
    """The rows of a table that are ranked, if all of them have scores."""
    entries = [row for row in table if row.kind == "entry"]
    if all(replays(row.spawn) for row in entries):  # only policies are compared
        return [row for row in entries if row.policy not in RECORDED_POLICIES]
    return [row for row in entries if may_rank(row.spawn)]


def ranked_by(table: Sequence[Row]) -> RankedBy:
    """The score by which a table is ranked and sorted.

    It is `walk` if only policies are compared (recorded people enter in all entries),
    otherwise `overall` if every competing entry has one, otherwise `crowd`.
    """
    entries = [row for row in table if row.kind == "entry"]
    if all(replays(row.spawn) for row in entries):
        return "walk"
    competing = competing_rows(table) or entries
    return "overall" if all(row.overall is not None for row in competing) else "crowd"


def ordered(table: Sequence[Row]) -> list[Row]:
    """The table sorted: entries by rank, then by the score that `ranked_by` names; baselines last.

    Entries without a rank follow those with one, and entries without a score follow those with one.
    """
    by = ranked_by(table)

    def place(row: Row) -> tuple[bool, int, float]:
        score: Score | None = getattr(row, by)
        worth = float("inf") if score is None else -score.value
        return row.rank is None, row.rank or 0, worth

    entries = [row for row in table if row.kind == "entry"]
    return [*sorted(entries, key=place), *(row for row in table if row.kind == "baseline")]


def _ranked(entries: Sequence[Row]) -> list[Row]:
    """The entries with ranks; nobody has one if a competing row has no score."""
    by = ranked_by(entries)
    scores: dict[int, Score | None] = {id(row): getattr(row, by) for row in competing_rows(entries)}
    known = [score for score in scores.values() if score is not None]
    if len(known) < len(scores):
        return list(entries)
    rank = dict(zip(scores, ranks(known), strict=True))
    return [replace(row, rank=rank.get(id(row))) for row in entries]


def score_rows(card: scorecard.Scorecard) -> dict[str, Any]:
    """The rows of a scorecard's table: the crowds in their order, then the unranked baselines.

    Spawn models and policies have the names that they were given. Scores and distances that are
    not defined are None. `ranked_by` names the score that the ranks compare.
    """
    table = rows(card)
    return {"ranked_by": ranked_by(table), "rows": [_row(row, card) for row in table]}


def _row(row: Row, card: scorecard.Scorecard) -> dict[str, Any]:
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
