"""Numbers of people present in the samples of a model, and tests of differences."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.report.text.words import digits
from crowdbench.scoring.score import holm
from studies.paper.presence import Presence

_ROUNDING = 1e-9
"""Differences of distances and counts below this are rounding errors."""


@dataclass(frozen=True)
class Numbers:
    """Statistics of N(t) for each sample of a model, for one of `study.SCHEMES`."""

    mean: list[float]
    """Mean number of persons."""
    sd: list[float]
    """Standard deviation over time, persons."""
    correlation: list[float | None]
    """Autocorrelation at 60 s; None if no stretch of observed time is that long."""
    distance: list[float]
    """Wasserstein-1 distance to the recording, divided by the recording's mean."""

    @classmethod
    def of(cls, samples: Sequence[Presence], recorded: Presence) -> "Numbers":
        """Compute the statistics of each sample."""
        return cls(
            [s.mean for s in samples],
            [s.sd for s in samples],
            [s.correlation for s in samples],
            [s.distance(recorded) for s in samples],
        )


def signs(pairs: Sequence[tuple[Sequence[float], Sequence[float]]]) -> list[int]:
    """Sign of each difference of means; 0 if it is not significant.

    Welch's (1947) t-tests over the samples, two-sided at 5 % over all pairs by Holm (1979).
    """
    significant = holm([_welch(a, b) for a, b in pairs])
    return [
        int(np.sign(np.mean(a) - np.mean(b))) if differs else 0
        for (a, b), differs in zip(pairs, significant, strict=True)
    ]


def difference(a: Sequence[float], b: Sequence[float]) -> tuple[float, float]:
    """95 % confidence interval of the difference of means by Welch's (1947) procedure."""
    from scipy.stats import t

    middle, error, degrees = _compared(a, b)
    width = error * t.ppf(0.975, degrees) if error else 0.0
    return float(middle - width), float(middle + width)


def pm(values: Sequence[float]) -> str:
    """Mean ± standard deviation over samples; for a single value, only that value."""
    mean = digits(float(np.mean(values)))
    return f"{mean} ± {np.std(values, ddof=1):.2g}" if len(values) > 1 else mean


def _welch(a: Sequence[float], b: Sequence[float]) -> float:
    """p-value of Welch's t-test; 1 for a single sample, which has no spread."""
    from scipy.stats import t

    if min(len(a), len(b)) < 2:
        return 1.0
    middle, error, degrees = _compared(a, b)
    if not error:
        return float(np.isclose(middle, 0.0, atol=_ROUNDING))
    return float(2 * t.sf(abs(middle) / error, degrees))


def _compared(a: Sequence[float], b: Sequence[float]) -> tuple[float, float, float]:
    """Difference of means, its standard error and the degrees of freedom (Welch 1947).

    `scipy.stats.ttest_ind` warns if the values of a sample are equal, as those of a deterministic
    policy are.
    """
    spreads = [0.0 if np.ptp(x) < _ROUNDING else np.var(x, ddof=1) / len(x) for x in (a, b)]
    total = sum(spreads)
    if not total:
        return float(np.mean(a) - np.mean(b)), 0.0, np.inf
    each = sum(v**2 / (len(x) - 1) for v, x in zip(spreads, (a, b), strict=True))
    return float(np.mean(a) - np.mean(b)), float(np.sqrt(total)), float(total**2 / each)
