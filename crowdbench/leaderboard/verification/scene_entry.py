"""One scene of an entry: scores, metrics, copy index, flags and curves of its rollouts."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.copying import ArrivalCopies, TripCopies, independent_limit
from crowdbench.leaderboard.verification.curves import (
    AGENTS,
    DISTRIBUTIONS,
    agents_over_time,
    distribution,
)
from crowdbench.leaderboard.verification.entry import (
    Copy,
    Curve,
    Flag,
    MetricEntry,
    SceneEntry,
    ScoreCard,
)
from crowdbench.leaderboard.verification.flags import evenness, flags_of
from crowdbench.metrics import METRICS, WALK, Metric, metrics_for
from crowdbench.progress import steps
from crowdbench.run.judge import MetricSlice, seen_in
from crowdbench.run.rollout_jobs import Job, Pair
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene
from crowdbench.scoring.energy import Energy, FitEnergies, energies_of_fits
from crowdbench.scoring.ranking import failures, gate_standard, metric_scores, rows, scale_of
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.score import LOWEST, Score, total_score
from crowdbench.scoring.scorecard import PairResult, Scorecard


@dataclass(frozen=True, eq=False)
class Rollouts:
    """The rollouts of one scene, and their scorecard."""

    place: Scene
    reference: Reference
    card: Scorecard
    rolled: dict[Job, RolloutSummary]
    crowd: Pair | None
    """Models scored on arrivals, presence, trips and space; None on track walk."""
    walk: Pair | None
    """Models scored on motion and interaction; None on track spawn."""

    @property
    def main(self) -> Pair:
        """The pair of models whose persons and rollouts are counted."""
        pair = self.crowd or self.walk
        assert pair is not None
        return pair

    def of(self, pair: Pair) -> dict[Job, RolloutSummary]:
        """The rollouts of a pair of models."""
        return {j: what for j, what in self.rolled.items() if (j.spawn, j.policy) == pair}

    def entry(self, pair: Pair) -> PairResult:
        """The scorecard's result for a pair of models."""
        return next(e for e in self.card.entries if (e.spawn, e.policy) == pair)

    def pair_of(self, metric: Metric) -> Pair | None:
        """The pair of models that a metric is computed for; None if the track does not use it."""
        return self.walk if metric.family in WALK else self.crowd

    def seen(self, metric: Metric) -> Iterator[MetricSlice]:
        """The metric's data for its pair of models, one slice per split."""
        pair = self.pair_of(metric)
        assert pair is not None
        return seen_in(self.reference, metric, self.of(pair), self.card.protocol)

    @cached_property
    def energies(self) -> dict[str, dict[str, FitEnergies]]:
        """Energies of each fit, by metric and split; only for scored metrics that have a score."""
        found: dict[str, dict[str, FitEnergies]] = {}
        for metric in metrics_for(self.reference.blocks):
            pair = self.pair_of(metric)
            if pair is None or self.entry(pair).metrics[metric.name].energy is None:
                continue
            if metric.name in self.card.scored:
                spread = metric.family not in WALK
                splits = {
                    s.split: energies_of_fits(metric, s.recorded, s.fits, s.blocks, spread=spread)
                    for s in self.seen(metric)
                }
                found[metric.name] = {p: e for p, e in splits.items() if e is not None}
        return found


def scene_entry(
    rollouts: Rollouts, recording: Trajectories, crowd_of: Callable[[Job], Trajectories]
) -> tuple[SceneEntry, list[Flag]]:
    """Return the scene's result and its flags. `crowd_of` reads a rollout's table."""
    place, card = rollouts.place, rollouts.card
    jobs = list(rollouts.of(rollouts.main))
    entry = rollouts.entry(rollouts.main)
    families = _families(rollouts)
    standard = gate_standard(card)
    walker = rollouts.entry(rollouts.walk or rollouts.main)
    fails = () if rollouts.walk is None else failures(card, walker)
    copy = _copy(rollouts, recording, map(crowd_of, steps("copies", jobs)))
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
        metrics=_metrics(rollouts),
        copy=copy,
        curves=_curves(rollouts),
    )
    score = total_score(families, passes=not fails)
    return of_scene, flags_of(place.id, score, _evenness(rollouts), copy)


def _families(rollouts: Rollouts) -> dict[str, Score]:
    by_pair = {(row.spawn, row.policy): row for row in rows(rollouts.card)}
    found: dict[str, Score] = {}
    for pair, of_walking in ((rollouts.crowd, False), (rollouts.walk, True)):
        if pair is not None:
            scores = by_pair[pair].families
            found |= {f: s for f, s in scores.items() if (f in WALK) == of_walking}
    return found


def _metrics(rollouts: Rollouts) -> dict[str, MetricEntry]:
    scale = scale_of(rollouts.card)
    scores = {
        pair: metric_scores(scale, rollouts.entry(pair))
        for pair in (rollouts.crowd, rollouts.walk)
        if pair is not None
    }
    found = {}
    for metric in metrics_for(rollouts.reference.blocks):
        pair = rollouts.pair_of(metric)
        if pair is None:
            continue
        card = rollouts.entry(pair).metrics[metric.name]
        score = scores[pair].get(metric.name)
        energies = rollouts.energies.get(metric.name, {})
        found[metric.name] = MetricEntry(
            distance=card.distance,
            recorded=card.recorded,
            simulated=card.simulated,
            unit=card.unit,
            scored=metric.name in rollouts.card.scored,
            score=None if score is None else score.value,
            interval=None if score is None else score.interval,
            splits={p: _of_fits(e, *scale[metric.name]) for p, e in energies.items()},
        )
    return found


def _of_fits(energies: FitEnergies, floor: Energy, anchor: Energy) -> list[float | None]:
    """The score of each fit, relative to the noise floor and the anchor of all splits together."""
    span = anchor.centre - floor.centre
    if not span > 0:
        return [None] * len(energies.spread)
    above = energies.to_recorded - energies.spread - floor.centre
    return [max(LOWEST, float(1 - a / span)) for a in above]


def _evenness(rollouts: Rollouts) -> float | None:
    """Relative spread of the rollouts; None on track walk, or without scores."""
    if rollouts.crowd is None:
        return None
    even = {m.name for m in METRICS if m.family in ("arrivals", "presence")}
    energies = {name: splits for name, splits in rollouts.energies.items() if name in even}
    floors = {name: floor.energy().centre for name, floor in rollouts.card.scale.floor.items()}
    return evenness(energies, floors)


def _copy(rollouts: Rollouts, recording: Trajectories, crowds: Iterable[Trajectories]) -> Copy:
    """The copy index, averaged over the rollouts; on track walk of trips only."""
    trips = TripCopies(recording, rollouts.place)
    arrivals = None if rollouts.crowd is None else ArrivalCopies(recording, rollouts.place)
    shares, indices = [], []
    for crowd in crowds:  # one at a time: many of them would not fit into memory
        shares.append(trips.share(crowd))
        if arrivals is not None:
            persons = np.flatnonzero(crowd.entered)
            area = crowd.spawn_area[persons].astype(np.int64)
            indices.append(arrivals.index(crowd.spawn_s[persons], area))
    return Copy(
        arrivals=_mean(indices),
        arrivals_limit=None if arrivals is None else independent_limit(arrivals, rollouts.place),
        trips=_mean(shares),
    )


def _mean(values: Sequence[float | None]) -> float | None:
    """The mean of the values that are not None; None if there are none."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


def _curves(rollouts: Rollouts) -> dict[str, Curve]:
    by_name: Mapping[str, Metric] = {m.name: m for m in metrics_for(rollouts.reference.blocks)}
    found: dict[str, Curve] = {}
    if rollouts.crowd is not None:
        seen = rollouts.seen(by_name["agents_over_time"])
        found[AGENTS] = agents_over_time(rollouts.reference, seen)
    for name, (title, _) in DISTRIBUTIONS.items():
        if rollouts.pair_of(by_name[name]) is not None:
            seen = rollouts.seen(by_name[name])
            found[title] = distribution(name, rollouts.reference, seen)
    return found
