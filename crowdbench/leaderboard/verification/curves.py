"""Curves: the values that the plots on an entry's page are drawn from."""

from collections.abc import Iterable

import numpy as np
from jaxtyping import Float

from crowdbench.leaderboard.verification.entry import POINTS, Curve
from crowdbench.metrics import Metric, Statistics, total
from crowdbench.metrics.forms import RelativeWasserstein
from crowdbench.run.judge import MetricSlice
from crowdbench.scoring.reference import Reference

DISTRIBUTIONS = {
    "inter_spawn": ("Time between arrivals", "time to the next arrival (s)"),
    "dwell": ("Dwell time", "dwell time (s)"),
    "speed": ("Speed", "speed (m/s)"),
    "deviation": ("Deviation from the straight way", "deviation (m)"),
}
AGENTS = "Agents over time"
TITLES = {AGENTS, *(title for title, _ in DISTRIBUTIONS.values())}
_SHOWN = 0.996
"""A distribution is shown up to the value that this share does not exceed."""


def agents_over_time(reference: Reference, splits: Iterable[MetricSlice]) -> Curve:
    """Mean number of agents in each time block, over the rollouts that are scored on it."""
    recorded, simulated = np.zeros((2, len(reference.blocks)))
    for seen in splits:
        inside = reference.blocks.in_split(seen.split)
        recorded[inside] = _block_means(seen.recorded)
        simulated[inside] = np.mean([_block_means(crowd) for crowd in seen.crowds], axis=0)
    middle = reference.blocks.frames.mean(axis=1) * reference.blocks.dt_s
    shown = _spread_out(len(middle))
    return Curve(
        x_label="time (s)",
        y_label="agents, mean of a time block",
        x=_rounded(middle[shown]),
        recorded=_rounded(recorded[shown]),
        simulated=_rounded(simulated[shown]),
    )


def distribution(metric: Metric, reference: Reference, splits: Iterable[MetricSlice]) -> Curve:
    """Distribution functions of a metric's values, pooled over all rollouts and splits."""
    assert isinstance(metric, RelativeWasserstein)
    each, blocks = list(splits), reference.blocks
    recorded = [seen.recorded for seen in each]
    simulated = [crowd for seen in each for crowd in seen.crowds]
    aligned, support = metric.aligned([*recorded, *simulated], blocks)
    sums = [total(statistics) for statistics in aligned]
    # A distribution function is constant between two values of the support.
    steps = np.repeat(np.arange(len(support)), np.diff(support, append=support[-1] + 1))
    pools = (sums[: len(recorded)], sums[len(recorded) :])
    pooled = ({n: np.sum([s[n] for s in pool], axis=0) for n in pool[0]} for pool in pools)
    of_recorded, of_simulated = (metric.embed(s, support, blocks)[steps] for s in pooled)
    last = max(int(np.searchsorted(f, _SHOWN)) for f in (of_recorded, of_simulated))
    shown = _spread_out(min(last + 1, len(steps)))
    return Curve(
        x_label=DISTRIBUTIONS[metric.name][1],
        y_label="cumulative share",
        x=_rounded(shown * metric.step(reference.blocks)),
        recorded=_rounded(of_recorded[shown]),
        simulated=_rounded(of_simulated[shown]),
    )


def _block_means(statistics: Statistics) -> Float[np.ndarray, " B"]:
    counts = statistics["counts"]
    return counts @ np.arange(counts.shape[1]) / np.maximum(counts.sum(axis=1), 1)


def _spread_out(size: int) -> np.ndarray:
    """At most `POINTS` evenly spaced indices, from 0 to `size` − 1."""
    return np.unique(np.linspace(0, size - 1, min(size, POINTS)).round().astype(np.int64))


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(v), 4) for v in values]
