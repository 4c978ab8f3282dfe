"""Metrics: distances between a recorded and a simulated crowd.

They see `Trajectories` and `TimeBlocks` and nothing else, so they score any simulator.
"""

from crowdbench.metrics.agents_over_time import AgentsOverTime
from crowdbench.metrics.dwell import Dwell
from crowdbench.metrics.inter_spawn import InterSpawn
from crowdbench.metrics.metric import Histograms, Metric, MetricResult, distance

METRICS: tuple[Metric, ...] = (AgentsOverTime(), InterSpawn(), Dwell())
"""All metrics, in the order in which tables show them."""

__all__ = [
    "METRICS",
    "AgentsOverTime",
    "Dwell",
    "Histograms",
    "InterSpawn",
    "Metric",
    "MetricResult",
    "distance",
]
