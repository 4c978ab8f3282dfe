"""Metrics: distances between a recorded and a simulated crowd.

They are computed from `Trajectories`, `TimeBlocks` and `Place` alone, so they can score the output
of any simulator.
"""

from collections.abc import Iterable
from contextlib import AbstractContextManager, nullcontext

from crowdbench.data.blocks import TimeBlocks
from crowdbench.errors import SettingError
from crowdbench.metrics import arrivals, groups, interaction, motion, presence, space, trips
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
from crowdbench.plugins import blaming, instance_of, names, part

METRICS: tuple[Metric, ...] = (
    arrivals.InterSpawn(), arrivals.InterSpawnPerArea(), arrivals.SpawnCounts(),
    arrivals.FanoFactor10(), arrivals.FanoFactor60s(),
    presence.AgentsOverTime(), presence.AgentsSpread(), presence.Autocorrelation(),
    presence.SlowAutocorrelation(), presence.StandingShare(),
    trips.Dwell(), trips.OriginDestination(), trips.Detour(), trips.GoalShare(),
    space.Occupancy(), space.NearestNeighbour(), space.StartDensity(), space.GoalDensity(),
    groups.CompanionShare(), groups.GroupSize(),
    groups.CompanionDistance(), groups.CompanionOffset(),
    motion.Speed(), motion.Pace(), motion.Acceleration(), motion.Turning(), motion.Deviation(),
    interaction.Avoidance(), interaction.WallClearance(), interaction.OverlapRate(),
)  # fmt: skip
"""crowdbench's own metrics, in the order of the tables."""

PAPER = ("agents_over_time", "inter_spawn", "dwell")
"""The three metrics of the founding paper. Tables of distances show them first, whether or not a
scene scores them."""


def paper_first(metrics: Iterable[Metric]) -> list[Metric]:
    """The metrics in the order of tables of distances: those of the founding paper first."""
    known = list(metrics)
    by_name = {metric.name: metric for metric in known}
    first = [by_name[name] for name in PAPER if name in by_name]
    return [*first, *(metric for metric in known if metric.name not in PAPER)]


def all_metrics() -> tuple[Metric, ...]:
    """All metrics: crowdbench's own, then those that other packages have registered.

    Raises:
        SettingError: a registered object is not a metric, its name or family is invalid, or one of
            crowdbench's own metrics already has its name.
    """
    found = names("metrics", [metric.name for metric in METRICS])
    return (*METRICS, *(_check(name, part("metrics", name)) for name in found))


def _check(name: str, given: Metric | type[Metric]) -> Metric:
    metric = instance_of(given)
    if not isinstance(metric, Metric):
        raise SettingError(
            f"metric {name}", got=f"{metric!r}", expected="a subclass of crowdbench.metrics.Metric"
        )
    if metric.name != name or metric.family not in FAMILIES:
        got = f"the name {metric.name!r} and the family {metric.family!r}"
        expected = f"the name {name!r} and one of the families {', '.join(FAMILIES)}"
        raise SettingError(f"metric {name}", got=got, expected=expected)
    return metric


def blamed(metric: Metric) -> AbstractContextManager[None]:
    """A context that reports errors in another package's metric under the metric's name."""
    return nullcontext() if metric in METRICS else blaming(f"metric {metric.name}")


def metrics_for(blocks: TimeBlocks) -> tuple[Metric, ...]:
    """Those of crowdbench's own metrics that apply to time blocks of this length."""
    return tuple(metric for metric in METRICS if metric.applies(blocks))


__all__ = [
    "FAMILIES", "METRICS", "PAPER", "WALK", "Metric", "MetricResult", "Place", "Statistics",
    "Sums", "Support", "all_metrics", "blamed", "distance", "metrics_for", "paper_first", "total",
]  # fmt: skip
