"""Fitting of mixtures to complete trips; see `crowdbench.spawn.plans.trip_mixtures`.

The places of an area are a mixture of Gaussians that is fitted to the starts, or goals, of its
people, with the Gaussian of the area itself as one more, which has the weight of `PRIOR` people. If
one Gaussian is enough, it is that of the area.

The trips between two areas are then adapted from the product of both mixtures by expectation
maximisation with a prior, as Reynolds, Quatieri and Dunn (2000), "Speaker verification using
adapted Gaussian mixture models", do: the weights, and the moments of each pair of places, are those
of the people and of as many as `PRIOR` others together.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.plans.mixtures import (
    FEWEST,
    PRIOR,
    log_gaussians,
    mixed,
    moments,
    responsibilities,
    widened,
)
from crowdbench.spawn.plans.trip_mixtures import GOAL, SPEED, START, Places, TripMixtures
from crowdbench.spawn.plans.ways import Trips

_LEAST_VARIANCE_M2 = 0.05
"""Of 0.01, 0.02, 0.03, 0.05 and 0.09: with less, held-out people of ETH are 0.05 nats or more less
likely, with more those of Grand Central and the Forum 0.02."""
_STEPS = 10
"""30 change held-out likelihoods by 0.002 nats."""


def fit_trips(trips: Trips, areas: Areas, seed: int) -> TripMixtures:
    """Fit starts, goals and log speeds to those of at least one person."""
    trip, weight, a, g = trips.trip, trips.weight, trips.spawn_area, trips.goal_area
    starts = _places(trip[:, START], weight, a, areas.spawn, seed)
    goals = _places(trip[:, GOAL], weight, g, areas.goal, seed)
    common = TripMixtures.apart(starts, goals, log_speeds(trip[:, SPEED], weight))
    weights = common.weight.copy()
    own, mean, covariance = [common.own], [common.mean], [common.covariance]
    for pair in np.unique(np.stack([a, g], axis=1), axis=0):
        mine = (a == pair[0]) & (g == pair[1])
        if mine.sum() < FEWEST:
            continue
        at = common.between(*pair.tolist())
        weights[at], enough, means, covariances = _adapted(common, at, trip[mine], weight[mine])
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


def log_speeds(
    log_speed: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]
) -> Float[np.ndarray, " 2"]:
    """Weighted mean and variance."""
    mean, variance = moments(log_speed[:, None], weight)
    return np.array([mean[0], variance[0, 0]])


def _places(
    x: Float[np.ndarray, "n 2"],
    weight: Float[np.ndarray, " n"],
    area: Int[np.ndarray, " n"],
    areas: Gaussians,
    seed: int,
) -> Places:
    """The places of each area."""
    whole = Places.of(areas)
    found = []
    for k in range(len(areas)):
        area_mean, area_covariance = whole.mean[k, None], whole.covariance[k, None]
        shares = responsibilities(x[area == k], seed, _LEAST_VARIANCE_M2)
        if shares.shape[1] == 1:
            found.append((np.ones(1), area_mean, area_covariance))
            continue
        weighted = shares * weight[area == k, None]
        each = [moments(x[area == k], of) for of in weighted.T]
        total = np.append(weighted.sum(axis=0), PRIOR)
        means = np.concatenate([[mean for mean, _ in each], area_mean])
        covariances = widened(np.stack([covariance for _, covariance in each]), START)
        found.append((total / total.sum(), means, np.concatenate([covariances, area_covariance])))
    return Places(
        np.repeat(np.arange(len(areas)), [len(weights) for weights, _, _ in found]),
        *(np.concatenate(part) for part in zip(*found, strict=True)),
    )


def _adapted(
    common: TripMixtures,
    at: tuple[Int[np.ndarray, " C"], Int[np.ndarray, " C"]],
    x: Float[np.ndarray, "n 5"],
    weight: Float[np.ndarray, " n"],
) -> tuple[
    Float[np.ndarray, " C"],
    Bool[np.ndarray, " C"],
    Float[np.ndarray, "C 5"],
    Float[np.ndarray, "C 5 5"],
]:
    """Draw the mixture between two areas towards the people who walk from one to the other.

    Returns weights, which Gaussians stand for enough people, means and covariances. Gaussians of
    too few people remain as they are.
    """
    before = common.weight[at]
    usual, spread = (of[at] for of in common.gaussians)
    share, mean, covariance = before, usual, spread
    for _ in range(_STEPS):
        log = log_gaussians(x, mean, covariance) + np.log(share)
        each = np.exp(log - np.logaddexp.reduce(log, axis=1)[:, None])
        weighted = each * weight[:, None]
        people = weighted.sum(axis=0)
        share = (people + PRIOR * before) / (people.sum() + PRIOR)
        enough = each.sum(axis=0) >= FEWEST
        mean, covariance = usual.copy(), spread.copy()
        for c in np.flatnonzero(enough):
            mean[c], covariance[c] = mixed(
                moments(x, weighted[:, c]), people[c], (usual[c], spread[c])
            )
            covariance[c] = widened(covariance[c], START, GOAL)
    return share, enough, mean, covariance
