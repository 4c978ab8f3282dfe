"""Scores computed from energy scores: intervals, means and ranks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import FAMILIES, METRICS, WALK
from crowdbench.scoring.energy import Energy

LOWEST = -1.0
LEVEL = 0.05


@dataclass(frozen=True, eq=False)
class Score:
    """A score with resamples that describe its uncertainty."""

    value: float
    resampled: Float[np.ndarray, " R"]

    @property
    def interval(self) -> tuple[float, float]:
        """The central 95 % interval of the resamples."""
        low, high = np.percentile(self.resampled, [100 * LEVEL / 2, 100 * (1 - LEVEL / 2)])
        return float(low), float(high)

    def __repr__(self) -> str:
        low, high = self.interval
        return f"Score({self.value:.2f} [{low:.2f}, {high:.2f}])"


def score_of(es: Energy, floor_: Energy, anchor: Energy) -> Score | None:
    """S = 1 − (ES − F)/(ES_anchor − F), clipped below at −1 and not clipped above.

    The resamples are computed from the first-order expansion of this ratio. If anchor and noise
    floor are close, their difference nearly vanishes in some resamples and the exact ratio would
    be meaningless there. A score that is clipped has no spread.

    Returns None if the anchor is not worse than the noise floor, because the metric then cannot
    distinguish the anchor from the recording.
    """
    span = anchor.centre - floor_.centre
    if not span > 0:
        return None
    ratio = (es.centre - floor_.centre) / span
    if 1 - ratio <= LOWEST:
        return Score(LOWEST, np.full(len(es.resampled), LOWEST))
    above_floor = es.deviations() - floor_.deviations()
    of_span = anchor.deviations() - floor_.deviations()
    resampled = 1 - ratio - above_floor / span + ratio * of_span / span
    return Score(1 - ratio, np.maximum(LOWEST, resampled))


def combined(scores: Sequence[Score]) -> Score | None:
    """The mean of several scores, resample by resample; None if there are none."""
    if not scores:
        return None
    return Score(
        float(np.mean([s.value for s in scores])), np.mean([s.resampled for s in scores], axis=0)
    )


def family_scores(scores: Mapping[str, Score | None], scored: Sequence[str]) -> dict[str, Score]:
    """Mean score over the scored metrics of each family; families without any are omitted."""
    families: dict[str, Score] = {}
    for family in FAMILIES:
        asked = [m.name for m in METRICS if m.family == family and m.name in scored]
        score = combined([s for name in asked if (s := scores.get(name)) is not None])
        if score is not None:
            families[family] = score
    return families


def crowd_score(families: Mapping[str, Score]) -> Score | None:
    """Mean over the families arrivals, presence, trips and space; None if none has a score."""
    return combined([score for name, score in families.items() if name not in WALK])


def walk_score(families: Mapping[str, Score], *, passes: bool) -> Score | None:
    """The lesser of motion and interaction, resample by resample; None if neither has a score.

    A mean would allow policies to buy one family with the other: people who ignore each other may
    move smoothly, and people who wander at random may keep their distances. If the policy does not
    pass the scene's gate (see `crowdbench.scene.Gate`), the score is at most 0.
    """
    walks = [families[name] for name in WALK if name in families]
    if not walks:
        return None
    value = min(score.value for score in walks)
    resampled = np.min([score.resampled for score in walks], axis=0)
    if passes:
        return Score(value, resampled)
    return Score(min(0.0, value), np.minimum(0.0, resampled))


def overall_score(crowd: Score | None, walk: Score | None) -> Score | None:
    """Mean of crowd and walk; None if either is missing."""
    return None if crowd is None or walk is None else combined([crowd, walk])


def total_score(families: Mapping[str, Score], *, passes: bool) -> Score | None:
    """Mean of crowd and walk, or that of them which has a score; None if neither has."""
    both = (crowd_score(families), walk_score(families, passes=passes))
    return combined([score for score in both if score is not None])


def ranks(scores: Sequence[Score]) -> list[int]:
    """Rank of each score: 1 + the number of scores that are significantly better."""
    worse = [k for _, k in significant_pairs(scores)]
    return [1 + worse.count(k) for k in range(len(scores))]


def significant_pairs(scores: Sequence[Score]) -> list[tuple[int, int]]:
    """Pairs of indices of which the first score is significantly better than the second.

    The test uses paired differences on the shared resamples. It is two-sided at 5 % over all
    pairs, with Holm's (1979) step-down correction. The p-values come from a normal distribution
    with the standard deviation of the resamples, because 1,000 resamples cannot resolve the small
    p-values that the correction requires for many entries.
    """
    from scipy.special import ndtr  # `scipy.stats` takes longer to import than to rank

    pairs = [(i, j) for i in range(len(scores)) for j in range(i)]
    differences = [scores[i].value - scores[j].value for i, j in pairs]
    spreads = [float((scores[i].resampled - scores[j].resampled).std()) for i, j in pairs]
    p = [
        float(2 * ndtr(-abs(d) / s)) if s > 0 else float(d == 0)
        for d, s in zip(differences, spreads, strict=True)
    ]
    return [
        (i, j) if difference > 0 else (j, i)
        for (i, j), difference, significant in zip(pairs, differences, holm(p), strict=True)
        if significant
    ]


def holm(p: Sequence[float], level: float = LEVEL) -> list[bool]:
    """Which p-values are significant at a family-wise error rate of `level` (Holm 1979)."""
    found = [False] * len(p)
    for step, index in enumerate(np.argsort(p, kind="stable").tolist()):
        if not p[index] <= level / (len(p) - step):
            break
        found[index] = True
    return found
