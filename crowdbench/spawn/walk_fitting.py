"""Fitting of walks to complete trips; see `crowdbench.spawn.walks`.

The places of an area are a mixture of Gaussians that is fitted to the starts, or goals, of its
people, with the Gaussian of the area itself as one more, which has the weight of `PRIOR` people. If
one Gaussian is enough, it is that of the area.

The walks between two areas are then adapted from the product of both mixtures by expectation
maximisation with a prior, as Reynolds, Quatieri and Dunn (2000), "Speaker verification using
adapted Gaussian mixture models", do: the weights, and the moments of each pair of places, are those
of the people and of as many as `PRIOR` others together.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.mixtures import (
    FEWEST,
    PRIOR,
    log_gaussians,
    mixed,
    moments,
    responsibilities,
    widened,
)
from crowdbench.spawn.walks import GOAL, SPEED, START, Places, Walks

_LEAST_VARIANCE_M2 = 0.05
"""Of 0.01, 0.02, 0.03, 0.05 and 0.09: with less, held-out people of ETH are 0.05 nats or more less
likely, with more those of Grand Central and the Forum 0.02."""
_STEPS = 10
"""30 change held-out likelihoods by 0.002 nats."""


def fit_walks(
    walk: Float[np.ndarray, "n 5"],
    weight: Float[np.ndarray, " n"],
    spawn_area: Int[np.ndarray, " n"],
    goal_area: Int[np.ndarray, " n"],
    areas: Areas,
    seed: int,
) -> Walks:
    """Fit starts, goals and log speeds to those of at least one person."""
    starts = _places(walk[:, START], weight, spawn_area, areas.spawn, seed)
    goals = _places(walk[:, GOAL], weight, goal_area, areas.goal, seed)
    common = Walks.apart(starts, goals, log_speeds(walk[:, SPEED], weight))
    weights = common.weight.copy()
    own, mean, covariance = [common.own], [common.mean], [common.covariance]
    for a, g in np.unique(np.stack([spawn_area, goal_area], axis=1), axis=0).tolist():
        mine = (spawn_area == a) & (goal_area == g)
        if mine.sum() < FEWEST:
            continue
        at = common.between(a, g)
        weights[at], enough, *found = _adapted(common, at, walk[mine], weight[mine])
        own.append(np.stack(at, axis=1)[enough])
        mean.append(found[0][enough])
        covariance.append(found[1][enough])
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
        mine = area == k
        shares = responsibilities(x[mine], seed, _LEAST_VARIANCE_M2)
        if shares.shape[1] == 1:
            found.append((np.ones(1), whole.mean[k, None], whole.covariance[k, None]))
            continue
        weighted = shares * weight[mine, None]
        each = [moments(x[mine], of) for of in weighted.T]
        total = np.append(weighted.sum(axis=0), PRIOR)
        found.append(
            (
                total / total.sum(),
                np.stack([*(mean for mean, _ in each), whole.mean[k]]),
                np.stack([*widened(np.stack([c for _, c in each]), START), whole.covariance[k]]),
            )
        )
    number = [len(of[0]) for of in found]
    return Places(
        np.repeat(np.arange(len(areas)), number),
        *(np.concatenate(x) for x in zip(*found, strict=True)),
    )


def _adapted(
    common: Walks,
    at: tuple[Int[np.ndarray, " C"], Int[np.ndarray, " C"]],
    x: Float[np.ndarray, "n 5"],
    weight: Float[np.ndarray, " n"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Weights, which Gaussians stand for enough people, means and covariances; those of `common`,
    drawn towards the people who walk between these places.

    Gaussians of too few people remain as they are.
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
