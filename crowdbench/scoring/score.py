"""Scores from energy scores, their intervals, means and ranks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.metrics import FAMILIES, WALK, Metric
from crowdbench.scoring.energy import Energy

LOWEST = -1.0
LEVEL = 0.05


@dataclass(frozen=True, eq=False)
class Score:
    """A score with its resamples, which lie around it."""

    value: float
    resampled: Float[np.ndarray, " R"]

    @property
    def interval(self) -> tuple[float, float]:
        """The central 95 %."""
        low, high = np.percentile(self.resampled, [100 * LEVEL / 2, 100 * (1 - LEVEL / 2)])
        return float(low), float(high)

    def __repr__(self) -> str:
        low, high = self.interval
        return f"Score({self.value:.2f} [{low:.2f}, {high:.2f}])"


def score_of(es: Energy, floor_: Energy, anchor: Energy) -> Score | None:
    """S = 1 − (ES − F)/(ES_anchor − F), clipped below at −1, never above.

    The resamples follow that to first order: where anchor and floor lie close together, single
    resamples of the span between them all but vanish, and the ratio itself would tell nothing.
    A score that is cut is as certain as it is low.
    None where the anchor is no worse than the floor: the metric tells nothing here.
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
    """The mean of some scores, resample by resample; None of none."""
    if not scores:
        return None
    return Score(
        float(np.mean([s.value for s in scores])),
        np.mean([s.resampled for s in scores], axis=0),
    )


def family_scores(
    metrics: Sequence[Metric], scores: Mapping[str, Score | None], scored: Sequence[str]
) -> dict[str, Score]:
    """Mean over the scored metrics of each family; families without one are left out."""
    families: dict[str, Score] = {}
    for family in FAMILIES:
        each = [scores.get(m.name) for m in metrics if m.family == family and m.name in scored]
        score = combined([s for s in each if s is not None])
        if score is not None:
            families[family] = score
    return families


def overall(families: Mapping[str, Score], *, walk: bool) -> Score | None:
    """Mean over the four families of crowds, and over those of walking if `walk`."""
    wanted = [f for f in FAMILIES if walk or f not in WALK]
    return combined([families[f] for f in wanted if f in families])


def ranks(scores: Sequence[Score]) -> list[int]:
    """1 + the number of entries that are significantly better; equal ranks are a tie group."""
    worse = [k for _, k in significant_pairs(scores)]
    return [1 + worse.count(k) for k in range(len(scores))]


def significant_pairs(scores: Sequence[Score]) -> list[tuple[int, int]]:
    """The pairs of which the first is significantly better than the second, by index.

    Paired differences on the shared resamples, two-sided at 5 % over all pairs by Holm's (1979)
    step-down. The p-values are those of a normal law with the resamples' standard deviation:
    1,000 resamples cannot resolve the small ones that Holm asks for among many entries.
    """
    from scipy.stats import norm

    pairs = [(i, j) for i in range(len(scores)) for j in range(i)]
    differences = [scores[i].value - scores[j].value for i, j in pairs]
    spreads = [float((scores[i].resampled - scores[j].resampled).std()) for i, j in pairs]
    p = [
        float(2 * norm.sf(abs(d) / s)) if s > 0 else float(d == 0)
        for d, s in zip(differences, spreads, strict=True)
    ]
    found = []
    for step, index in enumerate(np.argsort(p, kind="stable")):
        if p[index] > LEVEL / (len(pairs) - step):
            break
        i, j = pairs[index]
        found.append((i, j) if differences[index] > 0 else (j, i))
    return found
