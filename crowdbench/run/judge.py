"""Computes the scorecard of rollouts: distances, energy scores and noise floors."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Int
from threadpoolctl import threadpool_limits

from crowdbench import __version__
from crowdbench.data.blocks import HELD_OUT, SPLITS, TimeBlocks
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.metrics import WALK, Metric, Statistics, blamed
from crowdbench.metrics.metric import in_blocks
from crowdbench.metrics.motion import Speed
from crowdbench.progress import steps
from crowdbench.registry import recording_of
from crowdbench.run.jobs import Job, Pair, splits_of
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene
from crowdbench.scoring.energy import RESAMPLES, Draws, FloorDraws, energy, floor, mean_of
from crowdbench.scoring.reference import Reference, check_fits
from crowdbench.scoring.scorecard import (
    SCHEMA,
    EnergyCard,
    MetricCard,
    PairResult,
    Protocol,
    Scale,
    Scorecard,
    files_of,
    read_anchors,
)
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.names import replays

FINISHED = (OUTCOMES.index("goal"), OUTCOMES.index("exit"), OUTCOMES.index("timeout"))
TRAJECTORIES = "trajectories"
"""Name of the spawn model and policy of rollouts that another program made."""
LATE_S, FAR_M = 1.0, 1.0
"""People are recognised by where and when they enter, to within this time and distance."""
KNOWN = 0.95
"""Share of the people who have to be recognised."""
_PLAN = ("spawn_area", "goal_area", "goal_x", "goal_y", "group")
_UNKNOWN, _GOAL, _EXIT = (OUTCOMES.index(name) for name in ("unknown", "goal", "exit"))


def judge(
    place: Scene,
    reference: Reference,
    rolled: dict[Job, RolloutSummary],
    protocol: Protocol,
    seeds: int,
    scale: Scale,
) -> Scorecard:
    """The scorecard of rollouts; `seeds` is their number per pair (in each fold)."""
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
        gate=place.gate,
        scale=scale,
        entries=entries_of(place, reference, rolled, protocol, seeds, scored=place.protocol.scored),
    )


def judge_crowds(
    place: Scene, reference: Reference, crowds: Sequence[Trajectories], *, recorded_arrivals: bool
) -> Scorecard:
    """The scorecard of rollouts of another simulator; see `crowdbench.score_rollouts`.

    Raises:
        SettingError: there are no crowds.
        RecordingError: a crowd does not fit the scene or does not enter as recorded, or the
            recording that tells this is not imported.
    """
    if not crowds:
        raise SettingError("crowds", got="none", expected="one or more rollouts")
    areas, spawn = read_areas(place), "replay" if recorded_arrivals else TRAJECTORIES
    recording = recording_of(place) if recorded_arrivals else None
    rolled = {}
    for k, crowd in enumerate(crowds):
        check_fits(crowd, place)
        if recording is not None:
            crowd = recognised(crowd, recording, place)
        job = Job(place.id, spawn, TRAJECTORIES, "full", 0, k, Path(), "")
        rolled[job] = RolloutSummary.of_crowd(areas.assign(crowd), reference)
    scale = read_anchors(place).protocols["full"]
    # A single rollout under the recorded arrivals is scored as that of a deterministic policy.
    seeds = max(2, len(crowds)) if recorded_arrivals else len(crowds)
    card = judge(place, reference, rolled, "full", seeds, scale)
    return msgspec.structs.replace(card, fits=1, rollouts=len(crowds))  # fits are unknown


def recognised(crowd: Trajectories, recording: Trajectories, scene: Scene) -> Trajectories:
    """The crowd with the goals, areas and companions of the recorded people it consists of.

    People who left and whose outcome is unknown get the outcome `goal` if they ended within 1 m of
    the recorded goal (or within the scene's goal radius, if that is larger), otherwise `exit`.

    Raises:
        RecordingError: fewer than 95 % of the people, recorded or simulated, are recognised.
    """
    person = matched(crowd, recording)
    known = person >= 0
    most = max(len(crowd), len(recording), 1)
    if known.sum() < KNOWN * most:
        raise RecordingError(
            f"crowd scored on {scene.id}",
            got=f"{len(crowd)} people, of whom {int(known.sum())} enter like one of the "
            f"{len(recording)} recorded people",
            expected=f"at least {KNOWN:.0%}, within {LATE_S:g} s and {FAR_M:g} m",
            hint=f"`crowdbench spawn sample {scene.asked} --model replay --out arrivals.csv` "
            "writes the recorded arrivals. Without --recorded-arrivals, arrivals are scored too.",
        )
    whose = person[known]
    columns = {name: getattr(crowd, name).copy() for name in (*_PLAN, "left", "outcome")}
    for name in _PLAN:
        columns[name][known] = getattr(recording, name)[whose]
    columns["left"][known] &= recording.left[whose]  # who was not seen to leave stays censored
    goal = np.stack([columns["goal_x"], columns["goal_y"]], axis=1)
    near_m = max(FAR_M, scene.motion.goal_radius_m)
    near = np.linalg.norm(crowd.end - goal, axis=1) <= near_m
    untold = known & columns["left"] & (crowd.outcome == _UNKNOWN)
    columns["outcome"][untold] = np.where(near[untold], _GOAL, _EXIT)
    return replace(crowd, **columns)


def matched(crowd: Trajectories, recording: Trajectories) -> Int[np.ndarray, " P"]:
    """Index in the recording of each of the `P` people of a crowd; −1 for nobody.

    In order of entry, each recorded person is the nearest person who enters within `LATE_S` and
    `FAR_M` and is not yet taken.
    """
    found = np.full(len(crowd), -1)
    order = np.argsort(crowd.requested_s, kind="stable")
    times = crowd.requested_s[order]
    free = np.ones(len(crowd), dtype=bool)
    starts = crowd.start[order].astype(np.float64)
    first = np.searchsorted(times, recording.requested_s - LATE_S - 1e-9)
    stop = np.searchsorted(times, recording.requested_s + LATE_S + 1e-9)
    for p in np.argsort(recording.requested_s, kind="stable").tolist():
        window = slice(first[p], stop[p])
        distance = np.linalg.norm(starts[window] - recording.start[p], axis=1)
        distance[~free[window]] = np.inf
        if len(distance) and distance.min() <= FAR_M:
            at = first[p] + int(distance.argmin())
            found[order[at]], free[at] = p, False
    return found


def draws_of(scene: Scene, reference: Reference, split: str) -> Draws:
    """The resamples of a split, which are the same for all entries."""
    return Draws.of(
        reference.blocks.scored(split),
        resample_s=scene.protocol.resample_s,
        block_s=scene.protocol.block_s,
        seed=(SPLITS.index(split),),
    )


def floors(scene: Scene, reference: Reference, protocol: str) -> dict[str, EnergyCard]:
    """Noise floor F of each metric, averaged over the splits of a protocol."""
    splits = splits_of(protocol)
    draws = {split: draws_of(scene, reference, split) for split in splits}
    everyone = [(np.flatnonzero(reference.blocks.in_split(p)), draws[p]) for p in splits]
    found = {}
    for metric in steps("noise floors", reference.metrics):
        each = []
        for split in splits:
            blocks = reference.blocks.scored(split)
            if metric.applies(blocks):
                recording = reference.statistics[metric.name]
                recorded = in_blocks(recording, reference.blocks.in_split(split))
                of_floor = FloorDraws.of(draws[split], everyone)
                each.append(floor(metric, recording, recorded, blocks, of_floor))
        known = [e for e in each if e is not None]
        if len(known) == len(splits):
            found[metric.name] = EnergyCard.of(mean_of(known))
    return found


def entries_of(
    scene: Scene,
    reference: Reference,
    rolled: dict[Job, RolloutSummary],
    protocol: str,
    seeds: int,
    *,
    scored: Sequence[str] | None = None,
) -> list[PairResult]:
    """The results of each pair of spawn model and policy.

    All metrics have distances. Those in `scored` have energy scores too, None: all.
    """
    of_pair: dict[Pair, dict[Job, RolloutSummary]] = {}
    for job, what in rolled.items():
        of_pair.setdefault((job.spawn, job.policy), {})[job] = what
    cards: dict[Pair, dict[str, MetricCard]] = {pair: {} for pair in of_pair}
    for pair, metric in steps("judging", [(p, m) for p in of_pair for m in reference.metrics]):
        energies = scored is None or metric.name in scored
        # Products of matrices are small: further threads would mostly wait. Sums of counts are
        # exact, so the number of threads changes no result.
        with blamed(metric), threadpool_limits(1, "blas"):
            cards[pair][metric.name] = _metric_card(
                scene, reference, metric, of_pair[pair], protocol, seeds, energies=energies
            )
    results = []
    for (spawn, policy), mine in of_pair.items():
        ended = np.sum([summary.outcomes for summary in mine.values()], axis=0)
        finished = int(ended[list(FINISHED)].sum())
        results.append(
            PairResult(
                spawn=spawn,
                policy=policy,
                seeds=[job.seed for job in mine],
                persons=int(ended.sum()),
                outcomes={n: int(c) for n, c in zip(OUTCOMES, ended, strict=True) if c},
                speed_mps=_walking_speed(mine),
                at_goal=float(ended[FINISHED[0]]) / finished if finished else None,
                metrics=cards[spawn, policy],
            )
        )
    return results


def _walking_speed(rolled: dict[Job, RolloutSummary]) -> float | None:
    """Mean speed of people who walk, m/s, over all rollouts; None if nobody does."""
    speed = Speed()
    each = [what.of(speed)["counts"].sum(axis=0) for what in rolled.values()]
    counts = np.array(list(zip_longest(*each, fillvalue=0)), dtype=np.int64)
    return speed.walking_mps({"counts": counts.T})


@dataclass(frozen=True, eq=False)
class MetricSlice:
    """One metric's statistics of rollouts and recording, in the scored blocks of a split."""

    split: str
    blocks: TimeBlocks
    recorded: Statistics
    crowds: list[Statistics]
    """Statistics of the rollouts, by seed."""
    fits: list[list[Statistics]]
    """The same statistics, grouped by fit."""


def seen_in(
    reference: Reference, metric: Metric, rolled: dict[Job, RolloutSummary], protocol: str
) -> Iterator[MetricSlice]:
    """One metric's statistics of a pair's rollouts, for each split that the metric applies to."""
    # Pairs that are not fitted to the recording have rollouts of the split `full` only; these
    # are evaluated fold by fold.
    whole_recording = all(job.split in (SPLITS[0], HELD_OUT) for job in rolled)
    for split in splits_of(protocol):
        inside = reference.blocks.in_split(split)
        blocks = reference.blocks.scored(split)
        if not metric.applies(blocks):
            continue
        crowds = {
            job: in_blocks(what.of(metric), inside)
            for job, what in rolled.items()
            if whole_recording or job.split == split
        }
        fits = sorted({job.fit for job in crowds})
        yield MetricSlice(
            split,
            blocks,
            in_blocks(reference.statistics[metric.name], inside),
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
    *,
    energies: bool,
) -> MetricCard:
    results, each = [], []
    recorded_arrivals = replays(next(iter(rolled)).spawn)
    for seen in seen_in(reference, metric, rolled, protocol):
        results += [metric.compare(seen.recorded, crowd, seen.blocks) for crowd in seen.crowds]
        if (energies and (metric.family not in WALK or recorded_arrivals)) and (
            len(seen.crowds) == 1 < seeds or min(map(len, seen.fits)) >= 2
        ):
            draws = draws_of(scene, reference, seen.split)
            spread = metric.family not in WALK
            each.append(energy(metric, seen.recorded, seen.fits, seen.blocks, draws, spread=spread))
    known = [e for e in each if e is not None]
    whole = bool(known) and len(known) == len(splits_of(protocol))
    return MetricCard(
        distance=_mean([r.distance for r in results]),
        distances=[None if (d := _number(r.distance)) is None else _short(d) for r in results],
        recorded=_mean([r.recorded for r in results]),
        simulated=_mean([r.simulated for r in results]),
        unit=metric.unit,
        n=sum(r.n for r in results),
        energy=EnergyCard.of(mean_of(known)) if whole else None,
    )


def _mean(values: list[float]) -> float | None:
    return _number(np.mean(values)) if values else None


def _short(value: float) -> float:
    """The value with six significant digits, which is all that a list of rollouts shows."""
    return float(f"{value:.6g}")


def _number(value: float | np.floating) -> float | None:
    """The value, or None if it is not finite, because JSON has neither NaN nor infinity."""
    return float(value) if np.isfinite(value) else None
