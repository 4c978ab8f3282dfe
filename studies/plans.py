"""How well models of plans describe companions, ways and stops.

    python -m studies plans eth-v0 gc-v0 > docs/plans.md

writes a page with two tables for each scene. The first one has log-likelihoods of held-out people,
beside those of simpler models. The second one compares statistics of samples with those of the
recording.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.metrics import METRICS, Metric
from crowdbench.registry import list_policies, policy, recording_of, spawn_model
from crowdbench.run.jobs import BATCH
from crowdbench.run.rollout import rollouts
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, read_reference
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.plans.fitting import Marks, fit_plans, marks_of, trips_alone
from crowdbench.spawn.plans.links import STAGES, Links, candidates, log_likelihood, stages
from crowdbench.spawn.plans.mixtures import FEWEST, log_gaussians, moments
from crowdbench.spawn.plans.way_fitting import Trips, log_speeds
from crowdbench.spawn.plans.ways import SAME, SPEED, Places, TripMixtures, Ways, ranked
from studies.markdown import table

Pair = tuple[str, str]
"""A spawn model and a policy."""
PAIRS: tuple[Pair, ...] = (
    ("ntpp-gmm", "straight"),
    ("ntpp-plans", "straight"),
    ("cox-plans", "straight"),
    ("cox-plans", "anticipate"),
)
SHOWN = (
    "companion_share",
    "group_size",
    "companion_distance",
    "companion_offset",
    "standing_share",
    "agents_over_time",
    "agents_sd",
    "autocorrelation",
)
"""Metrics whose typical values are compared."""
SEEDS = 20
INTRODUCTION = """# How well plans describe people

[Models of plans](spawn-models.md#plans-companions-ways-and-stops) send people with companions, ways
and stops. This page tests them in two ways. It is the output of

    python -m studies plans {scenes}

**Held-out people.** Companions, ways and stops are fitted to the training blocks of each fold. The
first table of a scene has the log-likelihood of the people in the other blocks, all folds together,
and that of a simpler model, fitted to the same people. Models of single people have no companions
and no stops; so the simpler models are the simplest ones that have them. Higher is better.

**Samples.** The second table compares samples with the recording. Models are fitted to all of it,
walkers are straight, or those of `anticipate` where it comes with the scene; values are means of
{seeds} rollouts. Brackets contain 95 % of the values of recordings whose time blocks are resampled;
! marks values outside. Companions are found by the same rule in recordings and rollouts. `ntpp-gmm`
sends people without companions: those that it has happen to walk together. So do strangers among
straight walkers, who do not make way for each other.
"""
_RESAMPLES = 1000


@dataclass(frozen=True, kw_only=True)
class Held:
    """Log-likelihoods of held-out people, all folds together, nats."""

    what: str
    number: int
    """Number of people."""
    model: float
    """Nats per person."""
    simpler: float
    """Nats per person of the simpler model."""
    beside: str
    """What the simpler model is."""


def likelihoods(scene: Scene) -> list[Held]:
    """Fit companions, ways and stops to the training blocks of each fold, and test them.

    Raises:
        WeightsError: the scene lacks areas or statistics.
        RecordingError: its recording has not been imported.
    """
    crowd, blocks, areas = recording_of(scene), read_reference(scene).blocks, read_areas(scene)
    found: dict[str, list[tuple[int, float, float]]] = {}
    for fold in SPLITS[1:]:
        training, held_out = blocks.training(fold), blocks.scored(fold)
        fitted = fit_plans(crowd, training, areas)
        slower = fitted.links.group_log_speed
        known, marks = marks_of(crowd, training), marks_of(crowd, held_out)
        same = _same_for_all(fitted.links, known)
        found.setdefault("who joins whom", []).append(
            (len(marks.persons), log_joins(fitted.links, marks), log_joins(same, marks))
        )
        learnt, trips = (trips_alone(crowd, m, slower) for m in (known, marks))
        places = Places.of(areas.spawn), Places.of(areas.goal)
        apart = TripMixtures.apart(*places, log_speeds(learnt))
        found.setdefault("start, goal and speed", []).append(
            (
                len(trips.weight),
                float(log_trips(fitted.ways.trips, trips, fitted.ways.ranks).sum()),
                float(log_trips(apart, trips).sum()),
            )
        )
        if len(fitted.ways.stop_mean):
            found.setdefault("whether people stop", []).append(
                (
                    len(trips.weight),
                    float(log_stopping(fitted.ways, trips).sum()),
                    float(_same_stopping(learnt, trips)),
                )
            )
        if learnt.stops.sum() >= FEWEST:  # else the model has no places of its own
            found.setdefault("where and how long", []).append(
                (
                    int(trips.stops.sum()),
                    float(log_stops(fitted.ways, trips).sum()),
                    float(_one_place(learnt, trips)),
                )
            )
    beside = {
        "who joins whom": "the same probability at all delays and areas",
        "start, goal and speed": "independent of each other, as in models of single people",
        "whether people stop": "the same probability everywhere",
        "where and how long": "one Gaussian",
    }
    return [
        Held(
            what=what,
            number=(number := sum(n for n, _, _ in parts)),
            model=sum(x for _, x, _ in parts) / max(number, 1),
            simpler=sum(x for _, _, x in parts) / max(number, 1),
            beside=beside[what],
        )
        for what, parts in found.items()
    ]


def log_joins(links: Links, marks: Marks) -> float:
    """Log-probability of who joins which group, in total, nats."""
    pairs = candidates(marks.time_s, marks.area)
    x = np.concatenate([links.log_weight, links.larger, [links.crowded], links.tendency])
    same, stage = pairs.same(marks.group), stages(pairs, marks.area, marks.group)
    return log_likelihood(x, pairs, marks.area, same, stage)[0]


def log_trips(
    mixtures: TripMixtures, trips: Trips, ranks: Float[np.ndarray, "R 2"] = SAME
) -> Float[np.ndarray, " n"]:
    """Log density of starts, goals and log speeds, given the areas.

    Walls and bounds, at which ways are drawn again, are left out of account.
    """
    mean, covariance = mixtures.gaussians
    drawn = trips.trip.copy()
    drawn[:, SPEED] = ranked(drawn[:, SPEED], ranks[:, ::-1])
    steep = np.concatenate([[1.0], np.diff(ranks[:, 0]) / np.diff(ranks[:, 1]), [1.0]])
    found = np.log(steep[np.searchsorted(ranks[:, 1], trips.trip[:, SPEED])])
    areas = np.stack([trips.spawn_area, trips.goal_area], axis=1)
    for pair in np.unique(areas, axis=0):
        mine, at = (areas == pair).all(axis=1), mixtures.between(*pair.tolist())
        each = log_gaussians(drawn[mine], mean[at], covariance[at])
        with np.errstate(divide="ignore"):  # rounded weights may be 0
            found[mine] += np.logaddexp.reduce(each + np.log(mixtures.weight[at]), axis=1)
    return found


def log_stopping(ways: Ways, trips: Trips) -> Float[np.ndarray, " n"]:
    """Log probability that they stop, or that they do not, given the areas."""
    p = ways.stopping[trips.spawn_area, trips.goal_area]
    return np.asarray(np.log(np.where(trips.stops, p, 1 - p)))


def log_stops(ways: Ways, trips: Trips) -> Float[np.ndarray, " m"]:
    """Log density of the places and log waits of the `m` people who stop."""
    who = trips.chosen(trips.stops)
    share = ways.from_area[:, who.spawn_area] * ways.to_area[:, who.goal_area]
    each = log_gaussians(who.stop, ways.stop_mean, ways.stop_covariance).T
    return np.asarray(np.logaddexp.reduce(each + np.log(share / share.sum(axis=0)), axis=0))


def _same_for_all(links: Links, known: Marks) -> Links:
    """Links with one weight, the most likely one, whatever the delay and the area."""
    from scipy.optimize import minimize_scalar

    def same(log_weight: float) -> Links:
        one = np.full(len(links.log_weight), log_weight)
        nothing = np.zeros(len(links.tendency))
        return replace(
            links, log_weight=one, tendency=nothing, larger=np.zeros(STAGES - 1), crowded=0.0
        )

    best = minimize_scalar(
        lambda x: -log_joins(same(x), known),
        bounds=(-10.0, 5.0),
        method="bounded",
    )
    return same(float(best.x))


def _same_stopping(learnt: Trips, trips: Trips) -> float:
    share = learnt.weight[learnt.stops].sum() / learnt.weight.sum()
    return float(np.log(np.where(trips.stops, share, 1 - share)).sum())


def _one_place(learnt: Trips, trips: Trips) -> float:
    mean, covariance = moments(learnt.stop[learnt.stops], learnt.weight[learnt.stops])
    covariance = covariance + 1e-6 * np.eye(len(mean))
    return float(log_gaussians(trips.stop[trips.stops], mean[None], covariance[None]).sum())


@dataclass(frozen=True, kw_only=True)
class Shown:
    """A statistic of the recording and of samples."""

    metric: str
    recorded: float
    low: float
    high: float
    """Central 95 % of the recording's value, its time blocks resampled."""
    sampled: dict[Pair, list[float]]
    """Values of the samples of each pair."""


def pairs_of(scene: Scene) -> list[Pair]:
    """The pairs whose policies the scene has."""
    known = list_policies(scene)
    return [pair for pair in PAIRS if pair[1] in known]


def statistics(scene: Scene, pairs: Sequence[Pair], *, seeds: int = SEEDS) -> list[Shown]:
    """Compare samples of models fitted to the whole recording with it.

    Raises:
        WeightsError: the scene lacks fits or statistics.
        RecordingError: its recording has not been imported.
    """
    areas: Areas = read_areas(scene)
    reference, fits = Reference.of(recording_of(scene), scene, areas), scene.protocol.fits
    crowds: dict[Pair, list[Trajectories]] = {}
    for spawn, walker in pairs:
        models = [spawn_model(spawn, scene, fit=seed % fits) for seed in range(seeds)]
        found = crowds[spawn, walker] = []
        for k in range(0, seeds, BATCH):
            some = models[k : k + BATCH]
            numbers = range(k, k + len(some))
            found += rollouts(scene, some, policy(walker, scene), seeds=numbers)
    metrics = [m for m in METRICS if m.name in SHOWN and m.name in reference.statistics]
    return [_shown(metric, crowds, reference) for metric in metrics]


def _shown(metric: Metric, crowds: dict[Pair, list[Trajectories]], reference: Reference) -> Shown:
    recorded, blocks = reference.statistics[metric.name], reference.blocks
    (own,), support = metric.aligned([recorded], blocks)
    rng = np.random.default_rng(0)
    drawn = []
    for _ in range(_RESAMPLES):
        chosen = rng.integers(0, len(blocks), len(blocks))
        sums = {name: values[chosen].sum(axis=0) for name, values in own.items()}
        drawn.append(metric.typical(sums, support, blocks))
    low, high = np.nanpercentile(drawn, [2.5, 97.5])
    place = reference.place
    results = {
        pair: [metric.compare(recorded, metric.summarise(c, blocks, place), blocks) for c in some]
        for pair, some in crowds.items()
    }
    return Shown(
        metric=metric.name,
        recorded=next(iter(results.values()))[0].recorded,
        low=float(low),
        high=float(high),
        sampled={pair: [r.simulated for r in some] for pair, some in results.items()},
    )


def tables(scene: str | Path, *, seeds: int = SEEDS) -> str:
    """Both tables of a scene, as Markdown."""
    place = load_scene(scene)
    pairs = pairs_of(place)
    first = table(
        ["held out", "people", "nats per person", "simpler model", "which is"],
        [
            [h.what, f"{h.number:,}", _signed(h.model), _signed(h.simpler), h.beside]
            for h in likelihoods(place)
        ],
    )
    second = table(
        ["statistic", "recorded [95 %]", *(f"{spawn}, {walker}" for spawn, walker in pairs)],
        [
            [
                s.metric.replace("_", " "),
                f"{_number(s.recorded)} [{_number(s.low)}, {_number(s.high)}]",
                *(_value(s, pair) for pair in pairs),
            ]
            for s in statistics(place, pairs, seeds=seeds)
        ],
    )
    return f"## {place.id}\n\n{first}\n\n{second}\n"


def _value(shown: Shown, pair: Pair) -> str:
    value = float(np.mean(shown.sampled[pair]))
    mark = "" if shown.low <= value <= shown.high else " !"
    return f"{_number(value)}{mark}"


def _number(value: float) -> str:
    return (f"{value:.3g}" if abs(value) >= 1 else f"{value:.2f}").replace("-", "−")


def _signed(nats: float) -> str:
    return f"{nats:.3f}".replace("-", "−")


def page(scenes: Sequence[str], *, seeds: int = SEEDS) -> str:
    """The page: an introduction and both tables of each scene.

    Raises:
        SceneError, WeightsError: a scene does not exist, or lacks fits or statistics.
        RecordingError: a recording has not been imported.
    """
    parts = [tables(scene, seeds=seeds) for scene in scenes]
    return "\n".join([INTRODUCTION.format(scenes=" ".join(scenes), seeds=seeds), *parts])
