"""Measures where the CPU time of scoring goes, metric by metric.

Summarising a crowd and computing an energy score are measured separately. Some metrics share
intermediate results, such as the positions at ticks, which are kept for the crowd that was
summarised last. Whichever metric needs them first would pay for all others, so each crowd is
summarised twice: the second time is the metric's own, and what the first time took longer is a
figure of its own.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

from threadpoolctl import threadpool_limits

from crowdbench.data.table import Trajectories
from crowdbench.metrics import WALK, Metric, blamed
from crowdbench.policies import Straight
from crowdbench.registry import spawn_model
from crowdbench.run.jobs import Job
from crowdbench.run.judge import draws_of, seen_in
from crowdbench.run.rollout import rollout
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene
from crowdbench.scoring.energy import energy
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.spawn.areas import read_areas
from studies.speed import Figure

ROLLOUTS = 4
REPEATS = 3
"""Each crowd is summarised that often, after a first time that compiles; the least time counts."""
SPAWN = "poisson-gmm"
SHARED = "shared by several metrics"


def measure_judging(scene: Scene) -> Iterator[Figure]:
    """CPU time of summarising crowds and of energy scores by metric, the dearest first, and totals.

    The crowds are rollouts of poisson-gmm × straight. Summaries and energy scores are computed as
    in evaluations; energy scores are those of the metrics that the scene scores.
    """
    spawn, areas, reference = spawn_model(SPAWN, scene), read_areas(scene), read_reference(scene)
    crowds = [areas.assign(rollout(scene, spawn, Straight(), seed=k)) for k in range(ROLLOUTS)]
    thousands = sum(map(len, crowds)) / 1000
    summarising = _summarising_s(crowds, reference)
    yield from _figures("summarising", summarising, thousands, "CPU-s per 1,000 persons")
    scores = _energy_s(scene, crowds, reference)
    yield from _figures("energy score", scores, len(crowds), "CPU-s per rollout")


def _figures(what: str, took_s: dict[str, float], number: float, unit: str) -> Iterator[Figure]:
    for name in sorted(took_s, key=took_s.__getitem__, reverse=True):
        yield Figure(f"{what}, {name}", took_s[name] / number, unit)
    yield Figure(f"{what}, total", sum(took_s.values()) / number, unit)


def _summarising_s(crowds: list[Trajectories], reference: Reference) -> dict[str, float]:
    """CPU time of each metric's summaries of all crowds, and that of the work they share."""
    own, first = dict.fromkeys([m.name for m in reference.metrics], 0.0), 0.0
    _summaries_s(crowds[0], reference)  # compiles
    for crowd in crowds:
        each = [_summaries_s(crowd, reference) for _ in range(REPEATS)]
        for name in own:
            own[name] += min(second_s[name] for _, second_s in each)
            first += min(first_s[name] for first_s, _ in each)
    return own | {SHARED: max(0.0, first - sum(own.values()))}


def _summaries_s(
    crowd: Trajectories, reference: Reference
) -> tuple[dict[str, float], dict[str, float]]:
    """CPU time of each metric's first and second summary of a crowd."""
    crowd = replace(crowd)  # nothing is kept for the new object
    first_s: dict[str, float] = {}
    second_s: dict[str, float] = {}
    for metric in reference.metrics:
        with blamed(metric):
            for took_s in (first_s, second_s):
                took_s[metric.name] = _cpu_s(
                    partial(metric.summarise, crowd, reference.blocks, reference.place)
                )
    return first_s, second_s


def _energy_s(scene: Scene, crowds: list[Trajectories], reference: Reference) -> dict[str, float]:
    """CPU time of the energy score of each scored metric, of all crowds as rollouts of one fit."""
    rolled = {
        Job(scene.id, SPAWN, "straight", "full", 0, k, Path(), ""): RolloutSummary.of_crowd(
            crowd, reference
        )
        for k, crowd in enumerate(crowds)
    }
    draws = draws_of(scene, reference, "full")

    def score(metric: Metric) -> None:
        for seen in seen_in(reference, metric, rolled, "full"):
            spread = metric.family not in WALK
            energy(metric, seen.recorded, seen.fits, seen.blocks, draws, spread=spread)

    took_s = {}
    for metric in (m for m in reference.metrics if m.name in scene.protocol.scored):
        with blamed(metric), threadpool_limits(1, "blas"):
            score(metric)  # compiles
            took_s[metric.name] = _cpu_s(partial(score, metric))
    return took_s


def _cpu_s(work: Callable[[], object]) -> float:
    began = time.process_time()
    work()
    return time.process_time() - began
