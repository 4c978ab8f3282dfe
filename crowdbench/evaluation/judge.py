"""The scorecard of rollouts: their distances, energy scores and floors."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from crowdbench import __version__
from crowdbench.evaluation.rollout_jobs import (
    Job,
    RolloutSummary,
    parts_of,
)
from crowdbench.metrics import WALK, Metric, Statistics, blamed
from crowdbench.scene import Scene
from crowdbench.scoring.energy import RESAMPLES, Draws, FloorDraws, energy, floor, mean_of
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import (
    SCHEMA,
    EnergyCard,
    MetricCard,
    PairResult,
    Protocol,
    Scale,
    Scorecard,
    files_of,
)
from crowdbench.trajectories.blocks import PARTS, TimeBlocks
from crowdbench.trajectories.table import OUTCOMES


def judge(
    place: Scene,
    reference: Reference,
    rolled: dict[Job, RolloutSummary],
    protocol: Protocol,
    seeds: int,
    scale: Scale,
) -> Scorecard:
    """The scorecard of rollouts, `seeds` of each pair (in each fold)."""
    return Scorecard(
        schema=SCHEMA,
        crowdbench=__version__,
        scene=place.id,
        made_from=files_of(place),
        protocol=protocol,
        horizon_s=place.horizon_s,
        blocks=len(reference.blocks),
        fits=place.protocol.fits,
        rollouts=seeds,
        resamples=RESAMPLES,
        scored=list(place.protocol.scored),
        scale=scale,
        entries=entries_of(place, reference, rolled, protocol, seeds),
    )


def draws_of(scene: Scene, reference: Reference, part: str) -> Draws:
    """The resamples of a part: the same for everyone who is scored on it."""
    return Draws.of(
        reference.blocks.scored(part),
        resample_s=scene.protocol.resample_s,
        block_s=scene.protocol.block_s,
        seed=(PARTS.index(part),),
    )


def floors(scene: Scene, reference: Reference, protocol: str) -> dict[str, EnergyCard]:
    """F of each metric."""
    parts = parts_of(protocol)
    draws = {part: draws_of(scene, reference, part) for part in parts}
    everyone = [(np.flatnonzero(reference.blocks.in_part(p)), draws[p]) for p in parts]
    found = {}
    for metric in reference.metrics:
        each = []
        for part in parts:
            blocks = reference.blocks.scored(part)
            if metric.applies(blocks):
                recording = reference.statistics[metric.name]
                recorded = _rows(recording, reference.blocks.in_part(part))
                of_floor = FloorDraws.of(draws[part], everyone)
                each.append(floor(metric, recording, recorded, blocks, of_floor))
        known = [e for e in each if e is not None]
        if len(known) == len(parts):
            found[metric.name] = EnergyCard.of(mean_of(known))
    return found


def entries_of(
    scene: Scene, reference: Reference, rolled: dict[Job, RolloutSummary], protocol: str, seeds: int
) -> list[PairResult]:
    """An entry of each pair."""
    pairs = list(dict.fromkeys((job.spawn, job.policy) for job in rolled))
    return [
        _entry(
            scene,
            reference,
            {job: what for job, what in rolled.items() if (job.spawn, job.policy) == pair},
            protocol,
            seeds,
        )
        for pair in pairs
    ]


def _rows(statistics: Statistics, inside: np.ndarray) -> Statistics:
    return {name: values[inside] for name, values in statistics.items()}


def _entry(
    scene: Scene,
    reference: Reference,
    rolled: dict[Job, RolloutSummary],
    protocol: str,
    seeds: int,
) -> PairResult:
    first = next(iter(rolled))
    metrics = {}
    for metric in reference.metrics:
        with blamed(metric):
            card = _metric_card(scene, reference, metric, rolled, protocol, seeds)
        metrics[metric.name] = card
    ended = np.sum([r.outcomes for r in rolled.values()], axis=0)
    return PairResult(
        spawn=first.spawn,
        policy=first.policy,
        seeds=[job.seed for job in rolled],
        persons=int(ended.sum()),
        outcomes={n: int(c) for n, c in zip(OUTCOMES, ended, strict=True) if c},
        metrics=metrics,
    )


@dataclass(frozen=True, eq=False)
class MetricSlice:
    """Rollouts and the recording as one metric sees them in the blocks that a part is scored on."""

    part: str
    blocks: TimeBlocks
    recorded: Statistics
    crowds: list[Statistics]
    """The rollouts', by seed."""
    fits: list[list[Statistics]]
    """The same, of each fit."""


def seen_in(
    reference: Reference, metric: Metric, rolled: dict[Job, RolloutSummary], protocol: str
) -> Iterator[MetricSlice]:
    """What a metric sees of one pair's rollouts in each part of a protocol that it applies to."""
    # Who was not trained on the recording walks all of it once, and is looked at fold by fold.
    whole_recording = all(job.part == "full" for job in rolled)
    for part in parts_of(protocol):
        inside = reference.blocks.in_part(part)
        blocks = reference.blocks.scored(part)
        if not metric.applies(blocks):
            continue
        crowds = {
            job: _rows(what.of(metric), inside)
            for job, what in rolled.items()
            if whole_recording or job.part == part
        }
        fits = sorted({job.fit for job in crowds})
        yield MetricSlice(
            part,
            blocks,
            _rows(reference.statistics[metric.name], inside),
            list(crowds.values()),
            [[c for job, c in crowds.items() if job.fit == fit] for fit in fits],
        )


def _metric_card(
    scene: Scene,
    reference: Reference,
    metric: Metric,
    rolled: dict[Job, RolloutSummary],
    protocol: str,
    seeds: int,
) -> MetricCard:
    results, energies = [], []
    recorded_arrivals = next(iter(rolled)).spawn == "replay"
    for seen in seen_in(reference, metric, rolled, protocol):
        results += [metric.compare(seen.recorded, crowd, seen.blocks) for crowd in seen.crowds]
        if (metric.family not in WALK or recorded_arrivals) and (
            len(seen.crowds) == 1 < seeds or min(map(len, seen.fits)) >= 2
        ):
            draws = draws_of(scene, reference, seen.part)
            energies.append(energy(metric, seen.recorded, seen.fits, seen.blocks, draws))
    known = [e for e in energies if e is not None]
    whole = bool(known) and len(known) == len(parts_of(protocol))
    return MetricCard(
        distance=_mean([r.distance for r in results]),
        distances=[_number(r.distance) for r in results],
        recorded=_mean([r.recorded for r in results]),
        simulated=_mean([r.simulated for r in results]),
        unit=metric.unit,
        n=sum(r.n for r in results),
        energy=EnergyCard.of(mean_of(known)) if whole else None,
    )


def _mean(values: list[float]) -> float | None:
    return _number(np.mean(values)) if values else None


def _number(value: float | np.floating) -> float | None:
    """JSON has neither NaN nor infinity."""
    return float(value) if np.isfinite(value) else None
