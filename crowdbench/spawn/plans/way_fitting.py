"""Fitting of ways to the complete trips of a recording; see `crowdbench.spawn.plans.ways`."""

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.stops import LEAST_S, standing
from crowdbench.data.table import Trajectories
from crowdbench.errors import SceneError
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.plans.mixtures import FEWEST, PRIOR, mixed, moments, responsibilities, widened
from crowdbench.spawn.plans.trip_fitting import fit_trips
from crowdbench.spawn.plans.ways import BEND, OFF_M, STOP, Trips, Ways
from crowdbench.spawn.recorded_plans import SLOWEST_MPS, RecordedPlans

_FEW_STOPS = 0.5
_LEAST_VARIANCE = 1e-2
_SHORT_LOG_WAIT = np.log(10.0), 1.0
"""Mean and variance of the log waits by which those of fewer than ten people are filled up to ten:
the median stop lasts 9 to 11 s in ETH, Hotel, Zara and the Forum."""


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


def fit_ways(trips: Trips, areas: Areas, seed: int = 0) -> Ways:
    """Fit the ways of people to their complete trips.

    Raises:
        SceneError: there is no trip.
    """
    if len(trips.weight) == 0:
        raise SceneError(
            areas.scene,
            got="a recording of people none of whom was seen to enter, walk and leave",
            expected="complete trips to learn ways from",
        )
    weight, a, g = trips.weight, trips.spawn_area, trips.goal_area
    trip, bend, stops = trips.trip, trips.bend, trips.stops
    shape = (len(areas.spawn), len(areas.goal))
    straight = ~stops
    common = np.zeros((*shape, BEND)), np.broadcast_to(np.diag([0.04, 0.25]), (*shape, BEND, BEND))
    if weight[straight].sum() >= FEWEST:
        mean, covariance = moments(bend[straight], weight[straight])
        common = (
            np.broadcast_to(mean, (*shape, BEND)),
            np.broadcast_to(covariance, (*shape, BEND, BEND)),
        )
    bend_mean, bend_covariance = _pairs(
        bend[straight], weight[straight], a[straight], g[straight], *common
    )
    places = _places(trips, shape, seed)
    return Ways(
        fit_trips(trips, areas, seed),
        bend_mean,
        bend_covariance,
        _stopping(stops, weight, a, g, shape) * (len(places[0]) > 0),
        *places,
        longer=np.zeros(shape[0]),
        fastest_mps=max(float(np.exp(trip[:, 4].max())), 1.01 * SLOWEST_MPS),
    )


def bends_of(crowd: Trajectories, persons: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Fraction along the straight line, and metres to its left, of the furthest point of paths."""
    found = np.zeros((len(persons), BEND))
    for k, person in enumerate(persons.tolist()):
        path = crowd.path(person).astype(np.float64)
        way = crowd.goal[person] - path[0]
        length = np.hypot(*way)
        if length < OFF_M:
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


def _pairs(
    x: Float[np.ndarray, "n D"],
    weight: Float[np.ndarray, " n"],
    a: Int[np.ndarray, " n"],
    g: Int[np.ndarray, " n"],
    mean: Float[np.ndarray, "K G D"],
    covariance: Float[np.ndarray, "K G D D"],
) -> tuple[Float[np.ndarray, "K G D"], Float[np.ndarray, "K G D D"]]:
    """Gaussians of the pairs that enough people walked, drawn towards the given ones."""
    mean, covariance = mean.copy(), covariance.copy()
    for pair in np.unique(np.stack([a, g], axis=1), axis=0):
        mine = (a == pair[0]) & (g == pair[1])
        if mine.sum() < FEWEST:
            continue
        at = tuple(pair)
        own = moments(x[mine], weight[mine])
        mean[at], covariance[at] = mixed(own, weight[mine].sum(), (mean[at], covariance[at]))
    return mean, widened(covariance)


def _stopping(
    stops: Bool[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    a: Int[np.ndarray, " n"],
    g: Int[np.ndarray, " n"],
    shape: tuple[int, int],
) -> Float[np.ndarray, "K G"]:
    """Share of people who stop, drawn towards that of the spawn area, and this to that of all.

    The odds of all pairs of areas are then multiplied by one factor, so that as many people stop
    as were seen to: shares are drawn to the middle, more so where few people walk.
    """
    overall = weight[stops].sum() / weight.sum()
    of_area = np.bincount(a, weight, minlength=shape[0])
    stop_area = np.bincount(a[stops], weight[stops], minlength=shape[0])
    area = (stop_area + PRIOR * overall) / (of_area + PRIOR)
    both, stop_both = np.zeros(shape), np.zeros(shape)
    np.add.at(both, (a, g), weight)
    np.add.at(stop_both, (a[stops], g[stops]), weight[stops])
    drawn = (stop_both + PRIOR * area[:, None]) / (both + PRIOR)
    return _with_share(drawn, both / both.sum(), float(overall))


def _with_share(
    p: Float[np.ndarray, "K G"], weight: Float[np.ndarray, "K G"], mean: float
) -> Float[np.ndarray, "K G"]:
    """Probabilities whose odds are multiplied by one factor, so that they have this mean."""
    from scipy.optimize import brentq
    from scipy.special import expit, logit

    if mean in (0.0, 1.0):  # no factor leads there, and all probabilities are there already
        return p
    log_odds = logit(p)
    factor = brentq(lambda x: (weight * expit(log_odds + x)).sum() - mean, -20.0, 20.0)
    return np.asarray(expit(log_odds + factor))


def _places(
    trips: Trips, shape: tuple[int, int], seed: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mixture of stops: means, covariances, and weights by spawn and by goal area."""
    stops = trips.stops
    x, weight = trips.stop[stops], trips.weight[stops]
    a, g = trips.spawn_area[stops], trips.goal_area[stops]
    if len(x) == 0:
        none = np.zeros((0, STOP)), np.zeros((0, STOP, STOP))
        return *none, np.zeros((0, shape[0])), np.zeros((0, shape[1]))
    if len(x) < FEWEST:
        fitted, shares = [_few(trips)], weight[:, None]
    else:
        shares = responsibilities(x, seed, _LEAST_VARIANCE) * weight[:, None]
        fitted = [moments(x, shares[:, c]) for c in range(shares.shape[1])]
    total = shares.sum(axis=0)[:, None] / shares.sum()
    of_spawn = np.stack([np.bincount(a, s, minlength=shape[0]) for s in shares.T])
    of_goal = np.stack([np.bincount(g, s, minlength=shape[1]) for s in shares.T])
    # P(c | a, g) ∝ P(c) P(a | c) P(g | c), each drawn towards what does not depend on c.
    from_area = of_spawn + PRIOR * total * of_spawn.sum(axis=0).clip(_FEW_STOPS) / len(x)
    to_area = of_goal + PRIOR * total * of_goal.sum(axis=0).clip(_FEW_STOPS) / len(x)
    return (
        np.stack([mean for mean, _ in fitted]),
        widened(np.stack([covariance for _, covariance in fitted]), slice(0, 2)),
        from_area,
        to_area / to_area.sum(axis=1, keepdims=True),
    )


def _few(trips: Trips) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """A Gaussian of the stops of fewer than ten people.

    They stop half way on the trips of all. Their log waits are filled up to those of ten people by
    waits that are usual elsewhere.
    """
    half_way = (trips.trip[:, :2] + trips.trip[:, 2:4]) / 2
    mean, covariance = np.zeros(STOP), np.zeros((STOP, STOP))
    mean[:2], covariance[:2, :2] = moments(half_way, trips.weight)
    usual, variance = _SHORT_LOG_WAIT
    stops = trips.stops
    share = stops.sum() / FEWEST
    own, spread = moments(trips.stop[stops, 2:], trips.weight[stops])
    mean[2] = share * own[0] + (1 - share) * usual
    covariance[2, 2] = (
        share * spread[0, 0] + (1 - share) * variance + share * (1 - share) * (own[0] - usual) ** 2
    )
    return mean, covariance
