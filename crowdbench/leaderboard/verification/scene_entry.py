"""One scene of an entry: scores, metrics, copy index, flags and curves of its rollouts."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from crowdbench.data.storage import read
from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.copying import (
    BINS,
    COARSE_S,
    copies_in,
    independent_limits,
    index_name,
)
from crowdbench.leaderboard.verification.curves import (
    AGENTS,
    DISTRIBUTIONS,
    agents_over_time,
    distribution,
)
from crowdbench.leaderboard.verification.entry import (
    AsRecorded,
    CoarseCopy,
    Copy,
    Curve,
    Flag,
    MetricEntry,
    SceneEntry,
    ScoreCard,
)
from crowdbench.leaderboard.verification.flags import evenness, flags_of, read_limits
from crowdbench.metrics import METRICS, WALK, Metric, metrics_for
from crowdbench.run.jobs import Job, Pair
from crowdbench.run.judge import TRAJECTORIES, MetricSlice, judge, seen_in
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene, load_scene, scenes_folder
from crowdbench.scoring.energy import Energy, FitEnergies, energies_of_fits
from crowdbench.scoring.ranking import failures, gate_standard, metric_scores, rows, scale_of
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.score import LOWEST, Score, total_score
from crowdbench.scoring.scorecard import PairResult, Protocol, Scorecard, read_anchors
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.names import with_key


@dataclass(frozen=True, eq=False)
class SceneRollouts:
    """The rollouts of a submission on one scene: planned, then made by `roll_out`."""

    place: Scene
    reference: Reference
    protocol: Protocol
    crowd: Pair | None
    """Models scored on arrivals, presence, trips and space; None on track walk."""
    walk: Pair | None
    """Models scored on motion and interaction; None on track spawn."""
    jobs: list[Job]
    seeds: int
    """Number of rollouts per pair of models and split."""
    rolled: dict[Job, RolloutSummary] = field(default_factory=dict)

    def roll_out(self, workers: int | None, progress: Callable[[int, int], None]) -> None:
        """Make the rollouts, or read those of submitted trajectories."""
        if self.jobs[0].policy != TRAJECTORIES:
            jobs = [replace(job, shown=False) for job in self.jobs]
            rolled = roll_out(jobs, self.reference, workers, progress, copies_in)
            self.rolled.update(rolled)
            return
        for done, job in enumerate(self.jobs, 1):
            crowd = crowd_of(job)
            copies = copies_in(job, crowd)
            self.rolled[job] = RolloutSummary.of_crowd(crowd, self.reference, copies)
            progress(done, len(self.jobs))

    @cached_property
    def card(self) -> Scorecard:
        """The scorecard of the rollouts."""
        scale = read_anchors(self.place).protocols[self.protocol]
        return judge(self.place, self.reference, self.rolled, self.protocol, self.seeds, scale)

    @property
    def main(self) -> Pair:
        """The pair of models whose persons and rollouts are counted."""
        pair = self.crowd or self.walk
        assert pair is not None
        return pair

    @cached_property
    def results(self) -> dict[Pair, PairResult]:
        """The scorecard's results by pair of models."""
        return {(each.spawn, each.policy): each for each in self.card.entries}

    def of(self, pair: Pair) -> dict[Job, RolloutSummary]:
        """The rollouts of a pair of models."""
        return {j: what for j, what in self.rolled.items() if (j.spawn, j.policy) == pair}

    @cached_property
    def used(self) -> dict[str, tuple[Metric, Pair]]:
        """The metrics of the track by name, each with the pair of models it is computed for."""
        metrics = metrics_for(self.reference.blocks)
        pairs = [self.walk if metric.family in WALK else self.crowd for metric in metrics]
        return {m.name: (m, p) for m, p in zip(metrics, pairs, strict=True) if p is not None}

    def seen(self, name: str) -> Iterator[MetricSlice]:
        """The data of a metric, one slice per split."""
        metric, pair = self.used[name]
        return seen_in(self.reference, metric, self.of(pair), self.protocol)

    @cached_property
    def energies(self) -> dict[str, dict[str, FitEnergies]]:
        """Energies of each fit, by metric and split; only for scored metrics that have a score."""
        found: dict[str, dict[str, FitEnergies]] = {}
        for name, (metric, pair) in self.used.items():
            if name in self.card.scored and self.results[pair].metrics[name].energy is not None:
                spread = metric.family not in WALK
                splits = {
                    s.split: energies_of_fits(metric, s.recorded, s.fits, s.blocks, spread=spread)
                    for s in self.seen(name)
                }
                found[name] = {p: e for p, e in splits.items() if e is not None}
        return found


def crowd_of(job: Job) -> Trajectories:
    """Read submitted trajectories; their areas are derived from the positions."""
    place = load_scene(job.scene)
    crowd = read(job.path, scene=place.id, dt_s=place.dt_s)
    nowhere = np.full(len(crowd), -1, dtype=np.int32)
    unknown = replace(
        crowd, grid_s=place.grid_s, spawn_area=nowhere, goal_area=nowhere, scene=place.id
    )
    return read_areas(place).assign(unknown)


def scene_entry(rollouts: SceneRollouts) -> tuple[SceneEntry, list[Flag]]:
    """Return the scene's result and its flags."""
    place, card = rollouts.place, rollouts.card
    rolled = rollouts.of(rollouts.main)
    jobs = list(rolled)
    entry = rollouts.results[rollouts.main]
    families = _families(rollouts)
    standard = gate_standard(card)
    walker = rollouts.results[rollouts.walk or rollouts.main]
    fails = () if rollouts.walk is None else failures(card, walker)
    copy = _copy(rollouts)
    of_scene = SceneEntry(
        made_from=card.made_from,
        protocol=card.protocol,
        fits=len({job.fit for job in jobs}),
        rollouts=sum(job.split == jobs[0].split for job in jobs),
        persons=entry.persons,
        outcomes=entry.outcomes,
        speed_mps=walker.speed_mps,
        at_goal=walker.at_goal,
        recorded_speed_mps=standard.speed_mps,
        recorded_at_goal=standard.at_goal,
        fails=list(fails),
        families={name: ScoreCard.of(score) for name, score in families.items()},
        as_recorded=_as_recorded(rollouts),
        metrics=_metrics(rollouts),
        copy=copy,
        curves=_curves(rollouts),
    )
    score = total_score(families, passes=not fails)
    return of_scene, flags_of(place.id, score, _evenness(rollouts), copy)


def _families(rollouts: SceneRollouts) -> dict[str, Score]:
    by_pair = {(row.spawn, row.policy): row for row in rows(rollouts.card)}
    found: dict[str, Score] = {}
    for pair, of_walking in ((rollouts.crowd, False), (rollouts.walk, True)):
        if pair is not None:
            scores = by_pair[pair].families
            found |= {f: s for f, s in scores.items() if (f in WALK) == of_walking}
    return found


def _as_recorded(rollouts: SceneRollouts) -> AsRecorded | None:
    """Results under the recorded arrivals, if those under perturbed ones count."""
    if rollouts.walk is None or with_key(rollouts.walk[0]) is None:
        return None
    pair = "replay", rollouts.walk[1]
    row = next(row for row in rows(rollouts.card) if (row.spawn, row.policy) == pair)
    result = rollouts.results[pair]
    return AsRecorded(
        families={f: ScoreCard.of(score) for f, score in row.families.items() if f in WALK},
        fails=list(failures(rollouts.card, result)),
        speed_mps=result.speed_mps,
        at_goal=result.at_goal,
    )


def _metrics(rollouts: SceneRollouts) -> dict[str, MetricEntry]:
    scale = scale_of(rollouts.card)
    scores = {
        pair: metric_scores(scale, rollouts.results[pair])
        for pair in (rollouts.crowd, rollouts.walk)
        if pair is not None
    }
    found = {}
    for name, (_, pair) in rollouts.used.items():
        card = rollouts.results[pair].metrics[name]
        score = scores[pair].get(name)
        energies = rollouts.energies.get(name, {})
        found[name] = MetricEntry(
            distance=card.distance,
            recorded=card.recorded,
            simulated=card.simulated,
            unit=card.unit,
            scored=name in rollouts.card.scored,
            score=None if score is None else score.value,
            interval=None if score is None else score.interval,
            splits={p: _of_fits(e, *scale[name]) for p, e in energies.items()},
        )
    return found


def _of_fits(energies: FitEnergies, floor: Energy, anchor: Energy) -> list[float | None]:
    """The score of each fit, relative to the noise floor and the anchor of all splits together."""
    span = anchor.centre - floor.centre
    if not span > 0:
        return [None] * len(energies.spread)
    above = energies.to_recorded - energies.spread - floor.centre
    return [round(max(LOWEST, float(1 - a / span)), 4) for a in above]


def _evenness(rollouts: SceneRollouts) -> float | None:
    """Relative spread of the rollouts; None on track walk, or without scores."""
    if rollouts.crowd is None:
        return None
    even = {m.name for m in METRICS if m.family in ("arrivals", "presence")}
    energies = {name: splits for name, splits in rollouts.energies.items() if name in even}
    floors = {name: floor.energy().centre for name, floor in rollouts.card.scale.floor.items()}
    return evenness(energies, floors)


def _copy(rollouts: SceneRollouts) -> Copy:
    """The copy index, averaged over the rollouts: of arrivals on other tracks than walk."""
    place, everyone = rollouts.place, [*rollouts.rolled.values()]
    trips = _mean([each.measured("trips") for each in everyone])
    if rollouts.crowd is None:
        return Copy(arrivals=None, arrivals_limit=None, trips=trips)
    index = [_mean([each.measured(index_name(bin_s)) for each in everyone]) for bin_s in BINS]
    known = read_limits().arrivals.get(place.id) if place.folder.parent == scenes_folder() else None
    limits = known or independent_limits(place)
    return Copy(
        arrivals=index[0],
        arrivals_limit=limits[0],
        coarse=[
            CoarseCopy(bin_s=bin_s, index=i, limit=limit)
            for bin_s, i, limit in zip(COARSE_S, index[1:], limits[1:], strict=True)
        ],
        trips=trips,
    )


def _mean(values: Sequence[float]) -> float | None:
    known = [value for value in values if not np.isnan(value)]
    return float(np.mean(known)) if known else None


def _curves(rollouts: SceneRollouts) -> dict[str, Curve]:
    reference, used = rollouts.reference, rollouts.used
    found: dict[str, Curve] = {}
    if "agents_over_time" in used:
        found[AGENTS] = agents_over_time(reference, rollouts.seen("agents_over_time"))
    for name, (title, _) in DISTRIBUTIONS.items():
        if name in used:
            found[title] = distribution(used[name][0], reference, rollouts.seen(name))
    return found
