"""Fitting of ways to the complete trips of a recording; see `crowdbench.spawn.plans.ways`.

The places of an area are a mixture of Gaussians that is fitted to the starts, or goals, of its
people, with the Gaussian of the area itself as one more, which has the weight of `PRIOR` people. If
one Gaussian is enough, it is that of the area.

The trips between two areas are then adapted from the product of both mixtures by expectation
maximisation with a prior, as Reynolds, Quatieri and Dunn (2000), "Speaker verification using
adapted Gaussian mixture models", do: the weights, and the moments of each pair of places, are those
of the people and of as many as `PRIOR` others together.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.stops import LEAST_S, standing
from crowdbench.data.table import Flags, Indices, Numbers, Points, Trajectories
from crowdbench.errors import SceneError
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.plans import mixtures, ways
from crowdbench.spawn.recorded_plans import SLOWEST_MPS, RecordedPlans

_LEAST_VARIANCE_M2 = 0.05
"""Of 0.01, 0.02, 0.03, 0.05 and 0.09: with less, held-out people of ETH are 0.05 nats or more less
likely, with more those of Grand Central and the Forum 0.02."""
_STEPS = 10  # 30 change held-out likelihoods by 0.002 nats
_MOST_RANKS, _FINER, _LEAST_STEP = 32, 10, 1e-4
_FEW_STOPS = 0.5
_LEAST_VARIANCE = 1e-2
_USUAL_BENDS = np.zeros(ways.BEND), np.diag([0.04, 0.25])
_SHORT_LOG_WAIT = np.log([10.0]), np.ones((1, 1))
"""Mean and variance of the log waits by which those of fewer than ten people are filled up to ten:
the median stop lasts 9 to 11 s in ETH, Hotel, Zara and the Forum."""


@dataclass(frozen=True, eq=False)
class Trips:
    """What `n` recorded people did, who were seen to enter, walk and leave."""

    weight: Float[np.ndarray, " n"]
    """1 / P(a trip as long as this is seen to its end)."""
    spawn_area: Int[np.ndarray, " n"]
    goal_area: Int[np.ndarray, " n"]
    trip: Float[np.ndarray, "n 5"]
    """Start, goal, log speed."""
    bend: Float[np.ndarray, "n 2"]
    stop: Float[np.ndarray, "n 3"]
    """Place and log wait; NaN for those who do not stop."""

    @property
    def stops(self) -> Bool[np.ndarray, " n"]:
        """Whether they stop."""
        return np.isfinite(self.stop[:, 0])

    def chosen(self, which: Bool[np.ndarray, " n"]) -> "Trips":
        """Those of some of these people."""
        return Trips(**{f.name: getattr(self, f.name)[which] for f in fields(self)})

    def between_areas(self) -> Iterator[tuple[tuple[int, int], "Trips"]]:
        """The pairs of a spawn and a goal area that enough people walked, with their trips."""
        for a, g in np.unique(np.stack([self.spawn_area, self.goal_area], axis=1), axis=0).tolist():
            people = (self.spawn_area == a) & (self.goal_area == g)
            if people.sum() >= mixtures.FEWEST:
                yield (a, g), self.chosen(people)


def trips_of(crowd: Trajectories, plans: RecordedPlans, chosen: Bool[np.ndarray, " P"]) -> Trips:
    """The complete trips of the chosen people of a recording, which has areas."""
    known = (crowd.spawn_area >= 0) & (crowd.goal_area >= 0)
    whole = np.flatnonzero(chosen & known & crowd.left & np.isfinite(plans.speed))
    # A plan has one stop: those who stop several times stand there for as long as at all of them.
    stood_s = np.bincount(crowd.row_person(), standing(crowd), len(crowd)) * crowd.dt_s
    log_wait = np.log(np.maximum(plans.wait_s, stood_s)[whole].clip(LEAST_S))
    return Trips(
        weight=seen_weights(crowd, chosen)[whole],
        spawn_area=crowd.spawn_area[whole].astype(np.int64),
        goal_area=crowd.goal_area[whole].astype(np.int64),
        trip=np.column_stack(
            [crowd.start[whole], crowd.goal[whole], np.log(plans.speed[whole])]
        ).astype(np.float64),
        bend=bends_of(crowd, whole),
        stop=np.column_stack([plans.via[whole], log_wait]).astype(np.float64),
    )


def fit_ways(trips: Trips, areas: Areas) -> ways.Ways:
    """Fit the ways of people to their complete trips.

    Raises:
        SceneError: there is no trip.
    """
    if len(trips.weight) == 0:
        got = "a recording of people none of whom was seen to enter, walk and leave"
        raise SceneError(areas.scene, got=got, expected="complete trips to learn ways from")
    shape = len(areas.spawn), len(areas.goal)
    bend_mean, bend_covariance = _bends(trips.chosen(~trips.stops), shape)
    places = _stops(trips, shape)
    mixture = fit_trips(trips, areas)
    return ways.Ways(
        mixture,
        bend_mean,
        bend_covariance,
        _stopping(trips, shape) * (len(places[0]) > 0),
        *places,
        ranks=_ranks(mixture, trips),
        longer=np.zeros(shape[0]),
        fastest_mps=max(float(np.exp(trips.trip[:, ways.SPEED].max())), 1.01 * SLOWEST_MPS),
    )


def _bends(
    trips: Trips, shape: tuple[int, int]
) -> tuple[Float[np.ndarray, "K G 2"], Float[np.ndarray, "K G 2 2"]]:
    """Gaussians of bends between areas: that of all, and towards it those of enough people."""
    usual = _USUAL_BENDS
    if trips.weight.sum() >= mixtures.FEWEST:
        usual = mixtures.moments(trips.bend, trips.weight)
    mean, covariance = (np.tile(of, (*shape, *[1] * of.ndim)) for of in usual)
    for pair, people in trips.between_areas():
        own = mixtures.moments(people.bend, people.weight)
        share = people.weight.sum() / (people.weight.sum() + mixtures.PRIOR)
        mean[pair], covariance[pair] = mixtures.mixed(own, share, usual)
    return mean, mixtures.widened(covariance)


def _stopping(trips: Trips, shape: tuple[int, int]) -> Float[np.ndarray, "K G"]:
    """Share of people who stop, drawn towards that of the spawn area, and this to that of all.

    The odds of all pairs of areas are then multiplied by one factor, so that as many people stop
    as were seen to: shares are drawn to the middle, more so where few people walk.
    """
    from scipy.optimize import brentq
    from scipy.special import expit, logit

    both, stop_both = np.zeros(shape), np.zeros(shape)
    for table, people in ((both, trips), (stop_both, trips.chosen(trips.stops))):
        np.add.at(table, (people.spawn_area, people.goal_area), people.weight)
    overall = float(trips.weight[trips.stops].sum() / trips.weight.sum())
    area = (stop_both.sum(axis=1) + mixtures.PRIOR * overall) / (both.sum(axis=1) + mixtures.PRIOR)
    p = (stop_both + mixtures.PRIOR * area[:, None]) / (both + mixtures.PRIOR)
    if overall in (0.0, 1.0):  # no factor leads there, and all probabilities are there already
        return p
    share, log_odds = both / both.sum(), logit(p)
    factor = brentq(lambda x: (share * expit(log_odds + x)).sum() - overall, -20.0, 20.0)
    return np.asarray(expit(log_odds + factor))


def bends_of(crowd: Trajectories, persons: Indices) -> Points:
    """Fraction along the straight line, and metres to its left, of the furthest point of paths."""
    found = np.zeros((len(persons), ways.BEND))
    for k, person in enumerate(persons.tolist()):
        path = crowd.path(person).astype(np.float64)
        way = crowd.goal[person] - path[0]
        length = np.hypot(*way)
        if length < ways.OFF_M:
            continue
        off = path - path[0]
        along = (off @ way) / length**2
        left = (off[:, 1] * way[0] - off[:, 0] * way[1]) / length
        furthest = int(np.argmax(np.abs(left)))
        found[k] = np.clip(along[furthest], 0.05, 0.95), left[furthest]
    return found


def seen_weights(crowd: Trajectories, chosen: Bool[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
    """1 / P(a trip as long as the person's is seen to its end), by Kaplan and Meier (1958)."""
    length = (crowd.last - crowd.first).astype(np.int64)
    times, at = np.unique(length, return_inverse=True)
    trips = np.bincount(at[chosen], minlength=len(times))
    cut = np.bincount(at[chosen & ~crowd.left], minlength=len(times))
    at_risk = trips[::-1].cumsum()[::-1]
    survival = np.cumprod(1 - cut / np.maximum(at_risk, 1))
    before = np.concatenate([[1.0], survival[:-1]])
    return np.asarray(1 / np.maximum(before[at], 0.1))


def _stops(
    trips: Trips, shape: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mixture of stops: means, covariances, and weights by spawn and by goal area."""
    people = trips.chosen(trips.stops)
    x, weight, a, g = people.stop, people.weight, people.spawn_area, people.goal_area
    if len(x) == 0:
        none = np.zeros((0, ways.STOP)), np.zeros((0, ways.STOP, ways.STOP))
        return *none, np.zeros((0, shape[0])), np.zeros((0, shape[1]))
    if len(x) < mixtures.FEWEST:
        fitted, shares = [_few(trips)], weight[:, None]
    else:
        shares = mixtures.responsibilities(x, _LEAST_VARIANCE) * weight[:, None]
        fitted = [mixtures.moments(x, shares[:, c]) for c in range(shares.shape[1])]
    total = shares.sum(axis=0)[:, None] / shares.sum()
    of_spawn = np.stack([np.bincount(a, s, minlength=shape[0]) for s in shares.T])
    of_goal = np.stack([np.bincount(g, s, minlength=shape[1]) for s in shares.T])
    # P(c | a, g) ∝ P(c) P(a | c) P(g | c), each drawn towards what does not depend on c.
    from_area = of_spawn + mixtures.PRIOR * total * of_spawn.sum(axis=0).clip(_FEW_STOPS) / len(x)
    to_area = of_goal + mixtures.PRIOR * total * of_goal.sum(axis=0).clip(_FEW_STOPS) / len(x)
    return (
        np.stack([mean for mean, _ in fitted]),
        mixtures.widened(np.stack([covariance for _, covariance in fitted]), slice(0, 2)),
        from_area,
        to_area / to_area.sum(axis=1, keepdims=True),
    )


def _few(trips: Trips) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """A Gaussian of the stops of fewer than ten people.

    They stop half way on the trips of all. Their log waits are filled up to those of ten people by
    waits that are usual elsewhere.
    """
    half_way = (trips.trip[:, :2] + trips.trip[:, 2:4]) / 2
    mean, covariance = np.zeros(ways.STOP), np.zeros((ways.STOP, ways.STOP))
    mean[:2], covariance[:2, :2] = mixtures.moments(half_way, trips.weight)
    own = mixtures.moments(trips.stop[trips.stops, 2:], trips.weight[trips.stops])
    mean[2:], covariance[2:, 2:] = mixtures.mixed(
        own, trips.stops.sum() / mixtures.FEWEST, _SHORT_LOG_WAIT
    )
    return mean, covariance


def fit_trips(trips: Trips, areas: Areas) -> ways.TripMixtures:
    """Fit starts, goals and log speeds to those of at least one person."""
    starts = _places(trips.trip[:, ways.START], trips.weight, trips.spawn_area, areas.spawn)
    goals = _places(trips.trip[:, ways.GOAL], trips.weight, trips.goal_area, areas.goal)
    common = ways.TripMixtures.apart(starts, goals, log_speeds(trips))
    weights = common.weight.copy()
    own, mean, covariance = [common.own], [common.mean], [common.covariance]
    for pair, people in trips.between_areas():
        at = common.between(*pair)
        weights[at], enough, means, covariances = _adapted(common, at, people)
        own.append(np.stack(at, axis=1)[enough])
        mean.append(means[enough])
        covariance.append(covariances[enough])
    return replace(
        common,
        weight=weights,
        own=np.concatenate(own),
        mean=np.concatenate(mean),
        covariance=np.concatenate(covariance),
    )


def _ranks(mixture: ways.TripMixtures, trips: Trips) -> Float[np.ndarray, "R 2"]:
    """Mean log speeds of the mixture, and recorded ones, of people of about the same rank.

    So that no speed of a person can be read from them, they are means over about ten people or more
    (with unequal weights, at least seven on ETH).
    """
    count = min(int(len(trips.weight) / mixtures.FEWEST), _MOST_RANKS)
    if count < 2:
        return ways.SAME
    rank = (np.arange(count * _FINER) + 0.5) / (count * _FINER)
    speed = trips.trip[:, ways.SPEED]
    order = np.argsort(speed, kind="stable")
    weight = trips.weight[order] / trips.weight.sum()
    recorded = np.interp(rank, weight.cumsum() - weight / 2, speed[order])
    both = np.stack([_quantiles(mixture, trips, rank), recorded])
    found = both.reshape(2, count, _FINER).mean(axis=2).T
    # Where many people had the same speed, it has one rank.
    apart = np.diff(found, axis=0, prepend=-np.inf).min(axis=1) > _LEAST_STEP
    return found[apart] if apart.sum() >= 2 else ways.SAME


def _quantiles(mixture: ways.TripMixtures, trips: Trips, rank: Numbers) -> Numbers:
    """Quantiles of the log speeds that are drawn for people between the same areas."""
    from scipy.special import ndtr

    mean, covariance = mixture.gaussians
    share = np.zeros(mixture.weight.shape)
    for a, g in np.unique(np.stack([trips.spawn_area, trips.goal_area], axis=1), axis=0).tolist():
        people = trips.weight[(trips.spawn_area == a) & (trips.goal_area == g)].sum()
        at = mixture.between(a, g)
        share[at] += people * mixture.weight[at]
    chosen = share > 0
    mean, sd = mean[chosen, ways.SPEED], np.sqrt(covariance[chosen, ways.SPEED, ways.SPEED])
    x = np.linspace((mean - 5 * sd).min(), (mean + 5 * sd).max(), 2_000)
    below = ndtr((x[:, None] - mean) / sd) @ (share[chosen] / share.sum())
    return np.interp(rank, below, x)


def log_speeds(trips: Trips) -> Float[np.ndarray, " 2"]:
    """Weighted mean and variance."""
    mean, variance = mixtures.moments(trips.trip[:, ways.SPEED, None], trips.weight)
    return np.array([mean[0], variance[0, 0]])


def _places(x: Points, weight: Numbers, area: Indices, areas: Gaussians) -> ways.Places:
    whole = ways.Places.of(areas)
    found = []
    for k in range(len(areas)):
        mine, area_mean, area_covariance = area == k, whole.mean[k, None], whole.covariance[k, None]
        shares = mixtures.responsibilities(x[mine], _LEAST_VARIANCE_M2)
        if shares.shape[1] == 1:
            found.append((np.ones(1), area_mean, area_covariance))
            continue
        weighted = shares * weight[mine, None]
        mean, covariance = zip(*(mixtures.moments(x[mine], of) for of in weighted.T), strict=True)
        total = np.append(weighted.sum(axis=0), mixtures.PRIOR)
        covariances = np.concatenate(
            [mixtures.widened(np.stack(covariance), ways.START), area_covariance]
        )
        found.append((total / total.sum(), np.concatenate([mean, area_mean]), covariances))
    return ways.Places(
        np.repeat(np.arange(len(areas)), [len(weights) for weights, _, _ in found]),
        *(np.concatenate(part) for part in zip(*found, strict=True)),
    )


def _adapted(
    common: ways.TripMixtures, at: tuple[Indices, Indices], people: Trips
) -> tuple[Numbers, Flags, Float[np.ndarray, "n 5"], Float[np.ndarray, "n 5 5"]]:
    """Draw the mixture between two areas towards the people who walk from one to the other.

    Returns weights, which Gaussians stand for enough people, means and covariances. Gaussians of
    too few people remain as they are.
    """
    before = common.weight[at]
    usual, spread = (of[at] for of in common.gaussians)
    share, mean, covariance = before, usual, spread
    for _ in range(_STEPS):
        log = mixtures.log_gaussians(people.trip, mean, covariance) + np.log(share)
        each = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None])
        weighted = each * people.weight[:, None]
        number = weighted.sum(axis=0)
        share = (number + mixtures.PRIOR * before) / (number.sum() + mixtures.PRIOR)
        enough = each.sum(axis=0) >= mixtures.FEWEST
        mean, covariance = usual.copy(), spread.copy()
        for c in np.flatnonzero(enough):
            own = mixtures.moments(people.trip, weighted[:, c])
            of_own = number[c] / (number[c] + mixtures.PRIOR)
            mean[c], covariance[c] = mixtures.mixed(own, of_own, (usual[c], spread[c]))
            covariance[c] = mixtures.widened(covariance[c], ways.START, ways.GOAL)
    return share, enough, mean, covariance
