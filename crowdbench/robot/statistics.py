"""Estimates from episodes: shares with Wilson intervals, means with bootstrap intervals."""

import math

import msgspec
import numpy as np
from jaxtyping import Float, Int

from crowdbench.scoring.score import Score

RESAMPLES = 1000
_Z = 1.959964  # of 95 %


class Estimate(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """A share or a mean over episodes, with its 95 % interval."""

    value: float | None
    """None if no episode has a value, such as the time to the goal if nobody arrived."""
    low: float | None
    high: float | None


def share(events: int, episodes: int) -> Estimate:
    """The share of episodes in which something happened, with Wilson's (1927) score interval.

    J. Am. Stat. Assoc. 22, 209-212: unlike the normal interval, it is valid for shares near 0 or 1.
    """
    if episodes == 0:
        return Estimate(None, None, None)
    p, spread = events / episodes, _Z * _Z / episodes
    middle = (p + spread / 2) / (1 + spread)
    half = _Z / (1 + spread) * math.sqrt(p * (1 - p) / episodes + spread / (4 * episodes))
    return Estimate(p, max(0.0, middle - half), min(1.0, middle + half))


def resamples(episodes: int, seed: int) -> Int[np.ndarray, "R E"]:
    """Indices of episodes drawn with replacement (R, E); all controllers share them."""
    return np.random.default_rng(seed).integers(episodes, size=(RESAMPLES, episodes))


def mean(values: Float[np.ndarray, " E"], drawn: Int[np.ndarray, "R E"]) -> Estimate:
    """The mean over the episodes that have a value, with its bootstrap percentile interval.

    Args:
        values: (E,) one value per episode, NaN where there is none.
        drawn: (R, E) resamples.
    """
    known = ~np.isnan(values)
    if not known.any():
        return Estimate(None, None, None)
    count = known[drawn].sum(axis=1)
    total = np.where(known, values, 0.0)[drawn].sum(axis=1)
    low, high = np.percentile(total[count > 0] / count[count > 0], [2.5, 97.5])
    return Estimate(float(values[known].mean()), float(low), float(high))


def score(values: Float[np.ndarray, " E"], drawn: Int[np.ndarray, "R E"]) -> Score:
    """The mean with its resamples, for `crowdbench.scoring.score.ranks`: ties by differences."""
    return Score(float(values.mean()), values[drawn].mean(axis=1))
