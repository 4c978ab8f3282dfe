"""Metrics: distances between a recorded and a simulated crowd.

They see `Trajectories` and `TimeBlocks` and nothing else, so they score any simulator.
"""

from crowdbench.metrics.arrivals import (
    FanoFactor10,
    FanoFactor60s,
    InterSpawn,
    InterSpawnPerArea,
    SpawnCounts,
)
from crowdbench.metrics.interaction import ClosestApproach, OverlapRate, WallHits
from crowdbench.metrics.lives import Detour, Dwell, GoalShare, OriginDestination
from crowdbench.metrics.metric import (
    FAMILIES,
    WALK,
    Metric,
    MetricResult,
    Place,
    Statistics,
    Sums,
    Support,
    distance,
    total,
)
from crowdbench.metrics.motion import Acceleration, Speed, Turning
from crowdbench.metrics.presence import AgentsOverTime, AgentsSpread, Autocorrelation
from crowdbench.metrics.space import NearestNeighbour, Occupancy
from crowdbench.trajectories.blocks import TimeBlocks

METRICS: tuple[Metric, ...] = (
    InterSpawn(),
    InterSpawnPerArea(),
    SpawnCounts(),
    FanoFactor10(),
    FanoFactor60s(),
    AgentsOverTime(),
    AgentsSpread(),
    Autocorrelation(),
    Dwell(),
    OriginDestination(),
    Detour(),
    GoalShare(),
    Occupancy(),
    NearestNeighbour(),
    Speed(),
    Acceleration(),
    Turning(),
    ClosestApproach(),
    OverlapRate(),
    WallHits(),
)
"""All metrics, in the order in which tables show them."""


def metrics_for(blocks: TimeBlocks) -> tuple[Metric, ...]:
    """The metrics that blocks of this length can tell something by."""
    return tuple(metric for metric in METRICS if metric.applies(blocks))


__all__ = [
    "FAMILIES",
    "METRICS",
    "WALK",
    "Metric",
    "MetricResult",
    "Place",
    "Statistics",
    "Sums",
    "Support",
    "distance",
    "metrics_for",
    "total",
]
