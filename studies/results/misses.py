"""The section on what the models miss; all of it is computed from the scorecards."""

from collections.abc import Iterable, Sequence

from crowdbench.metrics import FAMILIES, METRICS, WALK, Metric
from crowdbench.report.text.words import NOTHING, plainly, with_interval
from crowdbench.scoring.power import ENOUGH, PERCENTILE
from crowdbench.scoring.ranking import Row, metric_scores, rows, scale_of
from crowdbench.scoring.score import Score, significant_pairs
from crowdbench.scoring.scorecard import ANCHOR, PairResult, Scorecard, has_recorded_arrivals
from studies.markdown import table
from studies.results.correlations import Lag
from studies.results.tables import competes, pair, with_unit

LOW = 0.5
"""Scored metrics with a lower score are listed."""
MEMORY = ("block-replay", "straight")
"""The memorisation baseline."""
QUANTITIES = {
    "inter_spawn": "mean gap between arrivals",
    "inter_spawn_per_area": "mean gap between arrivals at the same spawn area",
    "spawns_per_10_frames": "mean number of people who enter in ten frames",
    "fano_10_frames": "Fano factor of the number of people who enter in ten frames",
    "fano_60_s": "Fano factor of the number of people who enter in 60 s",
    "agents_over_time": "mean number of people present",
    "agents_sd": "standard deviation of the number of people present",
    "autocorrelation": "autocorrelation of the number of people present",
    "slow_autocorrelation": "autocorrelation of the number of people present at 120 and 300 s",
    "standing_share": "share of the time that people stand",
    "dwell": "mean dwell time",
    "origin_destination": "shares of the pairs of spawn area and goal area",
    "detour": "mean ratio of path length to straight-line distance",
    "goal_share": "share of people who reach their goal",
    "occupancy": "shares of time that people spend in each square metre",
    "nearest_neighbour": "mean distance to the nearest neighbour",
    "start_density": "density of the places where people start",
    "goal_density": "density of the places where people go",
    "companion_share": "share of people with a companion",
    "group_size": "mean size of the group of a person",
    "companion_distance": "mean distance between companions",
    "companion_offset": "mean offset between companions",
    "speed": "mean speed",
    "pace": "mean deviation from a person's mean speed",
    "acceleration": "acceleration along the path",
    "turning": "acceleration across the path",
    "deviation": "mean deviation from the straight way",
    "avoidance": "minus the distance by which strangers keep away from each other",
    "wall_clearance": "mean distance to the nearest wall, up to 2 m",
    "overlap_rate": "share of time in which people overlap",
}
"""The typical value of each metric, or the shares that it compares."""


def best_of(card: Scorecard) -> Row | None:
    """The crowd with the highest crowd score, except replayed recordings; None without scores."""
    known = [row for row in _competing(card) if row.crowd is not None]
    return max(known, key=lambda row: _crowd(row).value, default=None)


def misses(card: Scorecard, lags: Sequence[Lag]) -> str:
    """What the models miss in one protocol, in Markdown; `lags` are those of the best crowd."""
    best = best_of(card)
    if best is None:
        return _no_scores(card)
    parts = [_against_others(card, best), _by_model(card), *_low(card, best)]
    return "\n\n".join([*parts, _variation(best, lags)])


def not_scored(card: Scorecard) -> str:
    """Sentences on the metrics that are not scored on this scene."""
    known = card.entries[0].metrics
    unscored = [m for m in METRICS if m.name in known and m.name not in card.scored]
    scored = {m.family for m in METRICS if m.name in card.scored}
    empty = [f"*{family}*" for family in FAMILIES if family not in scored]
    short = [m for m in METRICS if m.name not in known]
    found = []
    if not card.scored:
        found.append("No metric of this scene is scored yet: it has no power study.")
    elif unscored:
        found.append(
            f"Plain distances only: {_listed(unscored)}. Only metrics that can distinguish the "
            "anchor from the true process are scored: the anchor’s energy score has to exceed the "
            f"{PERCENTILE:.0f}th percentile of the true process’s in at least {100 * ENOUGH:.0f} % "
            "of synthetic recordings (resampled time blocks), and the recording has to contain "
            "more than one value of the metric."
        )
    if card.scored and empty:
        missing = ", ".join(empty)
        found.append(f"Families without a scored metric, left out of all means: {missing}.")
    if short:
        found.append(f"Not computed, because the time blocks are too short: {_listed(short)}.")
    return " ".join(found) or "All metrics are scored."


def _competing(card: Scorecard) -> list[Row]:
    return [row for row in rows(card) if competes(row)]


def _no_scores(card: Scorecard) -> str:
    if not card.scored:
        return "There are no scores: no metric of this scene is scored yet."
    if card.rollouts < 2 * card.fits:
        return (
            f"There are no scores. Rollouts of each crowd: {card.rollouts}. Scores need two "
            f"rollouts of each fit, {2 * card.fits} in all."
        )
    return "There are no crowd scores."


def _crowd(row: Row) -> Score:
    assert row.crowd is not None
    return row.crowd


def _compared(card: Scorecard) -> tuple[list[Row], list[tuple[int, int]]]:
    """The crowds with scores (the last is the memorisation baseline), and `significant_pairs`."""
    memory = [r for r in rows(card) if r.kind == "baseline" and (r.spawn, r.policy) == MEMORY]
    known = [row for row in (*_competing(card), *memory) if row.crowd is not None]
    return known, significant_pairs([_crowd(row) for row in known])


def _against_others(card: Scorecard, best: Row) -> str:
    """The best crowd, and the others by whether their scores are significantly lower."""
    known, significant = _compared(card)
    names = [pair(row) for row in known]
    at = names.index(pair(best))
    others = [k for k, row in enumerate(known) if k != at and (row.spawn, row.policy) != MEMORY]
    worse = ", ".join(names[k] for k in others if (at, k) in significant)
    equal = ", ".join(names[k] for k in others if (at, k) not in significant)
    return (
        f"The highest crowd score is that of **{pair(best)}**, {with_interval(_crowd(best))}. "
        f"Significantly lower: {worse or 'none'}. No significant difference: {equal or 'none'}."
    )


def _by_model(card: Scorecard) -> str:
    """Table: each model with the anchor's walkers against the anchor and memorisation."""
    known, significant = _compared(card)
    at = {(row.spawn, row.policy): k for k, row in enumerate(known)}
    lines = []
    for k, row in enumerate(known):
        if row.policy == ANCHOR[1] and (row.spawn, row.policy) != MEMORY:
            anchor = " (anchor)" if (row.spawn, row.policy) == ANCHOR else ""
            line = [f"{row.spawn}{anchor}"]
            for other in (ANCHOR, MEMORY):
                line += _difference(known, significant, k, at.get(other, k))
            lines.append(line)
    minus = ("minus the anchor", "minus the memorisation baseline")
    head = ["spawn model", minus[0], "significant", minus[1], "significant"]
    return (
        f"Differences in crowd score between spawn models, all with {ANCHOR[1]} walkers:\n\n"
        f"{table(head, lines)}"
    )


def _difference(
    known: Sequence[Row], significant: Sequence[tuple[int, int]], one: int, other: int
) -> list[str]:
    """Two table cells: a difference with its interval, and whether it is significant."""
    if one == other:
        return [NOTHING, NOTHING]
    a, b = _crowd(known[one]), _crowd(known[other])
    differs = (one, other) in significant or (other, one) in significant
    difference = with_interval(Score(a.value - b.value, a.resampled - b.resampled))
    return [difference, "yes" if differs else "no"]


def _low(card: Scorecard, best: Row) -> list[str]:
    """Table of the best crowd's low scores, then the lowest scores of the other families."""
    lines, lowest, without = [], [], []
    scale = scale_of(card)
    for family in FAMILIES:
        entry = best.entry
        if family in WALK:
            if not has_recorded_arrivals(card):
                continue
            entry = next(e for e in card.entries if (e.spawn, e.policy) == ("replay", best.policy))
        scores = metric_scores(scale, entry)
        metrics = [m for m in METRICS if m.family == family and m.name in card.scored]
        known = [(m, s) for m in metrics if (s := scores.get(m.name)) is not None]
        without += [m for m in metrics if scores.get(m.name) is None]
        low = [(m, s) for m, s in known if s.value < LOW]
        lines += [_low_line(metric, score, entry) for metric, score in low]
        if known and not low:
            metric, score = min(known, key=lambda of: of[1].value)
            lowest.append(f"{_plain(metric)} ({family}) {with_interval(score)}")
    head = ["family", "metric", "typical value", "score", "recorded", "simulated", "distance"]
    found = [f"No scored metric of {pair(best)} is below {LOW:g}."]
    if lines:
        found = [f"Scored metrics of {pair(best)} below {LOW:g}:", table(head, lines, text=3)]
    if lowest:
        found.append(f"Lowest scored metric of each other family: {'; '.join(lowest)}.")
    if without:
        found.append(
            "No score in this protocol, because the anchor is no worse than the noise floor: "
            f"{_listed(without)}."
        )
    return found


def _low_line(metric: Metric, score: Score, entry: PairResult) -> list[str]:
    of = entry.metrics[metric.name]
    return [
        metric.family,
        _plain(metric),
        QUANTITIES.get(metric.name, NOTHING),
        with_interval(score),
        with_unit(of.recorded, metric.unit) or NOTHING,
        with_unit(of.simulated, metric.unit) or NOTHING,
        NOTHING if of.distance is None else f"{of.distance:.3f}",
    ]


def _variation(best: Row, lags: Sequence[Lag]) -> str:
    """Table of the standard deviation and the autocorrelation of N(t)."""
    sd = best.entry.metrics["agents_sd"]
    lines = [
        ["standard deviation", with_unit(sd.recorded, sd.unit), with_unit(sd.simulated, sd.unit)],
        *(
            [f"autocorrelation at {lag.lag_s:g} s", plainly(lag.recorded), plainly(lag.simulated)]
            for lag in lags
        ),
    ]
    return (
        f"Variation over time of the number of people present, with {pair(best)}:\n\n"
        f"{table(['quantity', 'recorded', 'simulated'], lines)}"
    )


def _plain(metric: Metric) -> str:
    return metric.name.replace("_", " ")


def _listed(metrics: Iterable[Metric]) -> str:
    return ", ".join(map(_plain, metrics))
