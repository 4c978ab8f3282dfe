"""Metrics: distances between a recorded and a simulated crowd.

They see `Trajectories` and `TimeBlocks` and nothing else, so they score any simulator.
"""

from contextlib import AbstractContextManager, nullcontext

from crowdbench.errors import SettingError
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
from crowdbench.plugins import blaming, made, parts
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
"""Our metrics, in the order in which tables show them."""


def all_metrics() -> tuple[Metric, ...]:
    """Ours, then those that others have registered.

    Raises:
        SettingError: what was registered is no metric, or has the name of one of ours.
    """
    found = parts("metrics", [metric.name for metric in METRICS])
    return (*METRICS, *(_checked(name, part) for name, part in found.items()))


def _checked(name: str, part: Metric | type[Metric]) -> Metric:
    metric = made(part)
    if not isinstance(metric, Metric):
        raise SettingError(
            f"metric {name}", got=f"{metric!r}", expected="a subclass of crowdbench.metrics.Metric"
        )
    if metric.name != name or metric.family not in FAMILIES:
        raise SettingError(
            f"metric {name}",
            got=f"the name {metric.name!r} and the family {metric.family!r}",
            expected=f"{name!r}, and one of {', '.join(FAMILIES)}",
        )
    return metric


def blamed(metric: Metric) -> AbstractContextManager[None]:
    """Reports errors of a metric of another package under its name."""
    return nullcontext() if metric in METRICS else blaming(f"metric {metric.name}")


def metrics_for(blocks: TimeBlocks) -> tuple[Metric, ...]:
    """Our metrics that blocks of this length can tell something by."""
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
    "all_metrics",
    "blamed",
    "distance",
    "metrics_for",
    "total",
]
