"""What the models miss, in words: nothing is said that no number of the scorecards carries."""

from collections.abc import Iterable, Sequence

from crowdbench.metrics import FAMILIES, METRICS, WALK, Metric
from crowdbench.report.text.words import plainly, with_interval
from crowdbench.scoring.power import ENOUGH, PERCENTILE
from crowdbench.scoring.score import LEVEL, Score, significant_pairs
from crowdbench.scoring.scorecard import (
    ANCHOR,
    WALK_ANCHOR,
    PairResult,
    Row,
    Scorecard,
    metric_scores,
    rows,
    walked,
)
from crowdbench.studies.results.correlations import Lag
from crowdbench.studies.results.tables import competes, pair, with_unit

LOW = 0.5
"""Scored metrics below this are named."""
MEMORY = ("block-replay", "straight")
QUANTITIES = {
    "inter_spawn": "the mean gap between arrivals",
    "inter_spawn_per_area": "the mean gap between arrivals at the same spawn area",
    "spawns_per_10_frames": "the mean number of people who enter in ten frames",
    "fano_10_frames": "the Fano factor of the number of people who enter in ten frames",
    "fano_60_s": "the Fano factor of the number of people who enter in 60 s",
    "agents_over_time": "the mean number of people present",
    "agents_sd": "the standard deviation of the number of people present",
    "autocorrelation": "the autocorrelation of the number of people present",
    "dwell": "the mean dwell time",
    "origin_destination": "the shares of the ways from spawn area to goal area",
    "detour": "the mean ratio of the way walked to the straight way",
    "goal_share": "the share of people who reach their goal",
    "occupancy": "the shares of time that people spend in each square metre",
    "nearest_neighbour": "the mean distance to the nearest neighbour",
    "speed": "the mean speed",
    "acceleration": "the mean acceleration",
    "turning": "the mean angle of turning",
    "closest_approach": "the mean closest approach of strangers",
    "overlap_rate": "the share of time in which people overlap",
    "wall_hits": "the share of time in which people touch a wall",
}
"""What the typical value of a metric is, or what its distributions are of."""


def best_of(card: Scorecard) -> Row | None:
    """The crowd of the highest crowd score, played recordings apart; None without scores."""
    known = [row for row in _competing(card) if row.crowd is not None]
    return max(known, key=lambda row: _crowd(row).value, default=None)


def misses(card: Scorecard, lags: Sequence[Lag]) -> str:
    """What the models miss in one protocol; `lags` are those of the best crowd."""
    best = best_of(card)
    if best is None:
        return _no_scores(card)
    families = "\n".join(
        f"- *{family}*: {' '.join(_of_family(card, best, family, lags))}" for family in FAMILIES
    )
    return (
        f"{_against_others(card, best)}\n\n{_against_memory(card)}\n\n"
        f"Scored metrics in which {pair(best)} gets less than {LOW:g}, family by family:\n\n"
        f"{families}"
    )


def not_scored(card: Scorecard) -> str:
    """The metrics that do not count on this scene, and why."""
    known = card.entries[0].metrics
    unscored = [m for m in METRICS if m.name in known and m.name not in card.scored]
    short = [m for m in METRICS if m.name not in known]
    found = []
    if not card.scored:
        found.append("No metric of this scene counts yet: its power study has not been made.")
    elif unscored:
        found.append(
            f"The power study found too little power in {_and(_plain(m) for m in unscored)}: in "
            f"fewer than {100 * ENOUGH:.0f} % of synthetic recordings, made of resampled time "
            "blocks, the anchor is farther from the recording than the true process is in "
            f"{PERCENTILE:.0f} % of cases, or the recording knows only one value of the metric. "
            "Where even the anchor is not reliably told from the truth, a score would tell "
            "little: these metrics have plain distances only."
        )
        scored = {m.family for m in METRICS if m.name in card.scored}
        empty = [family for family in FAMILIES if family not in scored]
        if empty:
            one = len(empty) == 1
            found.append(
                f"The {'family' if one else 'families'} {_and(f'*{f}*' for f in empty)} "
                f"{'has' if one else 'have'} no scored metric and {'counts' if one else 'count'} "
                "in no mean."
            )
    if short:
        found.append(
            f"The time blocks are too short for {_and(_plain(m) for m in short)}, which "
            f"{'is' if len(short) == 1 else 'are'} not computed."
        )
    return " ".join(found) or "All metrics are scored."


def _competing(card: Scorecard) -> list[Row]:
    return [row for row in rows(card) if competes(row)]


def _no_scores(card: Scorecard) -> str:
    if not card.scored:
        return "There are no scores, hence nothing to say: no metric of this scene counts yet."
    if card.rollouts < 2 * card.fits:
        return (
            "There are no scores, hence nothing to say: "
            f"{card.rollouts} rollout{'s' * (card.rollouts != 1)} of each crowd "
            f"with {card.fits} fits. Scores need two rollouts of each fit, {2 * card.fits} in all."
        )
    return "There are no scores, hence nothing to say."


def _crowd(row: Row) -> Score:
    assert row.crowd is not None
    return row.crowd


def _compared(card: Scorecard) -> tuple[list[Row], list[tuple[int, int]]]:
    """The crowds with scores, memory the last of them, and who is better than whom."""
    memory = [r for r in rows(card) if r.kind == "anchor" and (r.spawn, r.policy) == MEMORY]
    known = [row for row in (*_competing(card), *memory) if row.crowd is not None]
    return known, significant_pairs([_crowd(row) for row in known])


def _against_others(card: Scorecard, best: Row) -> str:
    """The best crowd, and which of the others it is told apart from."""
    known, apart = _compared(card)
    names = [pair(row) for row in known]
    at = names.index(pair(best))
    others = [k for k, row in enumerate(known) if k != at and (row.spawn, row.policy) != MEMORY]
    first = f"The highest crowd score is that of **{pair(best)}**, {with_interval(_crowd(best))}."
    if not others:
        return first
    level = f"{100 * LEVEL:.0f} % by Holm’s procedure over all pairs of {len(known)} crowds"
    worse = [names[k] for k in others if (at, k) in apart]
    equal = [names[k] for k in others if (at, k) not in apart]
    if not worse:
        return f"{first} It is not told apart from any of the other crowds ({level})."
    if not equal:
        return f"{first} It is told apart from all others ({level})."
    return f"{first} It is told apart from {_and(worse)}, but not from {_and(equal)} ({level})."


def _against_memory(card: Scorecard) -> str:
    """Each model with the anchor's walkers against the anchor and against memory."""
    known, apart = _compared(card)
    at = {(row.spawn, row.policy): k for k, row in enumerate(known)}
    lines = []
    for k, row in enumerate(known):
        if row.policy != ANCHOR[1] or (row.spawn, row.policy) == MEMORY:
            continue
        name = f"**{row.spawn}**{', the anchor,' if (row.spawn, row.policy) == ANCHOR else ''}"
        against = [
            _verdict(known, apart, k, at[other], what)
            for other, what in ((ANCHOR, "the anchor"), (MEMORY, "memory"))
            if other in at and at[other] != k
        ]
        if against:
            lines.append(f"- {name} is {' and '.join(against)}.")
    if not lines:
        return "No crowd with straight walkers can be compared with the anchor or with memory."
    return f"By crowd score, with {ANCHOR[1]} walkers:\n\n" + "\n".join(lines)


def _verdict(
    known: Sequence[Row], apart: Sequence[tuple[int, int]], one: int, other: int, what: str
) -> str:
    """How one crowd stands to another, `what`, and their difference with its interval."""
    better, worse = (one, other) in apart, (other, one) in apart
    a, b = _crowd(known[other if worse else one]), _crowd(known[one if worse else other])
    by = with_interval(Score(a.value - b.value, a.resampled - b.resampled))
    if better or worse:
        return f"{'better' if better else 'worse'} than {what} by {by}"
    return f"not told apart from {what} (difference {by})"


def _of_family(card: Scorecard, best: Row, family: str, lags: Sequence[Lag]) -> list[str]:
    """Sentences about one family."""
    metrics = [m for m in METRICS if m.family == family and m.name in card.scored]
    facts = _presence(card, best, lags) if family == "presence" else []
    if not metrics:
        return ["No metric of this family is scored.", *(fact for _, fact in facts)]
    entry, walks = best.entry, family in WALK
    if walks:
        if not walked(card):
            return ["Not scored, since the recording was not at hand."]
        entry = next(e for e in card.entries if (e.spawn, e.policy) == ("replay", best.policy))
    scores = metric_scores(card, entry)
    known = [(m, s) for m in metrics if (s := scores.get(m.name)) is not None]
    without = [m for m in metrics if scores.get(m.name) is None]
    low = [(m, s) for m, s in known if s.value < LOW]
    found = []
    if walks and (entry.spawn, entry.policy) == WALK_ANCHOR:
        found.append(f"Walkers that go {best.policy} are the anchor here and score 0.")
    if known and not low:
        metric, score = min(known, key=lambda of: of[1].value)
        found.append(
            f"No scored metric is below {LOW:g}; the lowest, {_plain(metric)}, "
            f"has {with_interval(score)}."
        )
    found += [_miss(m, score, entry, lags) for m, score in low]
    if without:
        found.append(
            f"{_and(_plain(m) for m in without).capitalize()} would be scored, but the anchor is "
            "no worse than the floor in this protocol."
        )
    named = {m.name for m, _ in low}
    return [*found, *(fact for name, fact in facts if name not in named)]


def _miss(metric: Metric, score: Score, entry: PairResult, lags: Sequence[Lag]) -> str:
    """One scored metric that is low: its score, and both sides' values."""
    unsure = f", an interval that reaches above {LOW:g}" if score.interval[1] >= LOW else ""
    name = _plain(metric).capitalize()
    return f"{name} gets {with_interval(score)}{unsure}: {_both(metric, entry, lags)}."


def _both(metric: Metric, entry: PairResult, lags: Sequence[Lag]) -> str:
    card = entry.metrics[metric.name]
    what = QUANTITIES.get(metric.name, f"the typical value of {_plain(metric)}")
    distance = "undefined" if card.distance is None else f"{card.distance:.3f}"
    if metric.name == "autocorrelation" and lags:
        return _at_lags(lags)
    if card.recorded is None or card.simulated is None:
        return f"{what} are at a plain distance of {distance} from the recorded ones"
    arrivals = " under the recorded arrivals" if entry.spawn == "replay" else ""
    return (
        f"{what} is {with_unit(card.recorded, metric.unit)} in the recording and "
        f"{with_unit(card.simulated, metric.unit)} in the rollouts{arrivals} (plain distance "
        f"{distance})"
    )


def _presence(card: Scorecard, best: Row, lags: Sequence[Lag]) -> list[tuple[str, str]]:
    """How much and how long the number present moves, whatever the scores."""
    found = []
    for metric in METRICS:
        if metric.name not in ("agents_sd", "autocorrelation"):
            continue
        if metric.name in best.entry.metrics:
            mark = "" if metric.name in card.scored else " (not scored)"
            both = _both(metric, best.entry, lags)
            found.append((metric.name, f"{both[0].upper()}{both[1:]}{mark}."))
    return found


def _at_lags(lags: Sequence[Lag]) -> str:
    each = [
        f"{plainly(lag.recorded)}{' recorded' * (k == 0)} and {plainly(lag.simulated)}"
        f"{' simulated' * (k == 0)} at a lag of {lag.lag_s:g} s"
        for k, lag in enumerate(lags)
    ]
    return f"{QUANTITIES['autocorrelation']} is {', '.join(each)}"


def _plain(metric: Metric) -> str:
    return metric.name.replace("_", " ")


def _and(names: Iterable[str]) -> str:
    *first, last = names
    return f"{', '.join(first)} and {last}" if first else last
