"""What the network of `joint-gmm` learns from: the arrivals of a place, as features and counts."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.joint.kernels import features_of, fill_features, recent_of
from crowdbench.spawn.joint.traces import BINS, FEATURES, mean_traces, width_of
from crowdbench.spawn.times.cox import lags
from crowdbench.spawn.times.groups import group_size

_PIECE_S = 180.0
"""Mean length of the pieces into which training windows are cut."""
_MOST_STEPS = 8_000
"""About the largest number of steps without arrivals from which is learned."""
LEVELS = np.linspace(-2.5, 2.5, 21)
"""Logarithms of constant levels of arrivals, in relation to usual ones."""


@dataclass(frozen=True, eq=False)
class Place:
    """What is learned from the arrivals of one place.

    The log-probability is that of nobody at all grid points, which is a sum over steps, plus what
    changes at the `E` grid points and areas where somebody entered. Of steps without arrivals, a
    long recording has many that are almost equal: some stand for all.
    """

    features: Tensor
    """(S, K, 20), at the beginning of each step that is used."""
    points: Tensor
    """Number of grid points (S,) for which each step stands."""
    recent: Tensor
    """Sum over all grid points of those who entered before each, by area and bin (K, 5)."""
    step: Tensor
    """Of each event (E,): its number in `features`, area, and number of people."""
    area: Tensor
    number: Tensor
    before: Tensor
    """Those who entered before each event, by bin (E, 5)."""
    log_rate: Tensor
    log_odds: Tensor
    rate_per_s: Float[np.ndarray, " K"]
    persons: float
    levels: Tensor
    """(L, K, 20), where arrivals had always been a constant times as frequent as usual."""

    @classmethod
    def of(cls, arrivals: Arrivals, known: Arrivals, rng: np.random.Generator | None) -> "Place":
        """Arrivals in windows, cut at random if `rng` is given, beside rates of `known` ones."""
        log_rate, log_odds, rate_per_s = _rates(known)
        grid_s, width = arrivals.grid_s, width_of(arrivals.grid_s)
        mean, of_lag = mean_traces(rate_per_s), lags(grid_s)
        features, points, before, events, steps = [], [], [], [], 0
        recent = np.zeros((arrivals.areas, BINS))
        every = -(-sum(-(-len(n) // width) for n in arrivals.by_window()) // _MOST_STEPS)
        for window in arrivals.by_window():
            for n in _cut(window, grid_s, rng):
                seen = np.empty((-(-len(n) // width), n.shape[1], FEATURES))
                features_of(n, width, width * grid_s, mean, seen)
                due = np.empty((*n.shape, BINS))
                recent_of(n, of_lag, due)
                recent += due.sum(axis=0)
                tick, area = np.nonzero(n)
                used, stands_for, at = used_steps(len(n), width, tick, every)
                features.append(seen[used])
                points.append(stands_for)
                before.append(due[tick, area])
                events.append(np.stack([steps + at, area, n[tick, area]]))
                steps += len(used)
        happened = torch.from_numpy(np.concatenate(events, axis=1))
        return cls(
            tensor(np.concatenate(features)),
            tensor(np.concatenate(points)),
            tensor(recent),
            happened[0],
            happened[1],
            happened[2].float(),
            tensor(np.concatenate(before)),
            tensor(log_rate),
            tensor(log_odds),
            rate_per_s,
            max(1.0, float(len(arrivals.tick))),
            tensor(_features_of_levels(mean)),
        )


def used_steps(
    points: int, width: int, tick: Int[np.ndarray, " E"], every: int
) -> tuple[Int[np.ndarray, " S"], Float[np.ndarray, " S"], Int[np.ndarray, " E"]]:
    """The steps that are used, for how many grid points each stands, and which one each event has.

    All with events are used, and of the others, each one in `every`.
    """
    steps = -(-points // width)
    length = np.minimum(width, points - width * np.arange(steps)).astype(np.float64)
    busy = np.zeros(steps, dtype=bool)
    busy[tick // width] = True
    quiet = np.flatnonzero(~busy)
    kept = quiet[every // 2 :: every] if len(quiet) > every else quiet
    if len(kept):
        length[kept] *= length[quiet].sum() / length[kept].sum()
    used = np.sort(np.concatenate([np.flatnonzero(busy), kept]))
    return used, length[used], np.searchsorted(used, tick // width)


def tensor(values: np.ndarray) -> Tensor:
    """The values as float32."""
    return torch.tensor(values, dtype=torch.float32)


def _rates(
    arrivals: Arrivals,
) -> tuple[Float[np.ndarray, " K"], Float[np.ndarray, " K"], Float[np.ndarray, " K"]]:
    """Log rate of groups per grid step, log odds of one more member, and persons per second."""
    counts = arrivals.counts()
    groups, persons = (counts > 0).sum(axis=0), counts.sum(axis=0)
    rate = -np.log1p(-(groups + 0.5) / (len(counts) + 1))
    more, _ = group_size(arrivals)
    log_odds = np.log(more / (1 - more))
    return np.log(rate), log_odds, (persons + 0.5) / arrivals.exposure_s()


def _cut(
    window: Int[np.ndarray, "T K"], grid_s: float, rng: np.random.Generator | None
) -> list[Int[np.ndarray, "t K"]]:
    """A window in pieces of random lengths."""
    if rng is None:
        return [window]
    ends, length = [0], _PIECE_S / grid_s
    while ends[-1] < len(window):
        ends.append(ends[-1] + max(1, round(length * rng.exponential())))
    return [window[a:b] for a, b in pairwise(ends) if a < len(window)]


def _features_of_levels(mean: Float[np.ndarray, "K 5"]) -> Float[np.ndarray, "L K 20"]:
    """Features of all areas after very long times at each constant level."""
    features = np.empty((len(LEVELS), *mean.shape[:1], FEATURES))
    for level, filled in zip(LEVELS, features, strict=True):
        fill_features(np.exp(level) * mean, mean, np.inf, filled)
    return features
