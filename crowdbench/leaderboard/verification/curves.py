"""Curves: the values that the plots on an entry's page are drawn from."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Float

from crowdbench.leaderboard.verification.entry import POINTS, Curve
from crowdbench.metrics import Metric, Statistics, Sums, total
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
    each = list(splits)
    recorded = _pooled(metric, [seen.recorded for seen in each])
    simulated = _pooled(metric, [crowd for seen in each for crowd in seen.crowds])
    size = max(len(v) for sums in (recorded, simulated) for v in sums.values())
    size = max(size, metric.if_empty(reference.blocks) + 1)
    support = np.arange(size)
    of_recorded, of_simulated = (
        metric.embed(
            {n: np.pad(v, (0, size - len(v))) for n, v in sums.items()},
            support,
            reference.blocks,
        )
        for sums in (recorded, simulated)
    )
    last = max(int(np.searchsorted(f, _SHOWN)) for f in (of_recorded, of_simulated))
    shown = _spread_out(min(last + 1, size))
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


def _pooled(metric: Metric, crowds: Sequence[Statistics]) -> Sums:
    """The sum of the histograms of all crowds."""
    pooled: Sums = {}
    for sums in map(total, crowds):
        for name, values in sums.items():
            if metric.on_lattice(name):
                known = pooled.get(name, np.zeros(0, dtype=np.int64))
                pooled[name] = np.pad(known, (0, max(0, len(values) - len(known))))
                pooled[name][: len(values)] += values
    return pooled


def _spread_out(size: int) -> np.ndarray:
    """At most `POINTS` evenly spaced indices, from 0 to `size` − 1."""
    return np.unique(np.linspace(0, size - 1, min(size, POINTS)).round().astype(np.int64))


def _rounded(values: np.ndarray) -> list[float]:
    return [round(float(v), 4) for v in values]
