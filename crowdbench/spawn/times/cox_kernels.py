"""Sampling and the particle filter of `cox-gmm`, compiled."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compilation import compiled


@compiled(error_model="python")
def drawn(
    groups: Float[np.ndarray, "T K"],
    following: Float[np.ndarray, " H"],
    next_member: Float[np.ndarray, " K"],
    rng: np.random.Generator,
) -> Int[np.ndarray, "T K"]:
    """Numbers of persons, given the rates of groups that follow nobody, per grid step."""
    number = np.zeros(groups.shape, np.int64)
    for t in range(groups.shape[0]):
        for a in range(groups.shape[1]):
            after = 0.0
            for h in range(1, min(t, following.size) + 1):
                after += following[h - 1] * number[t - h, a]
            more = 1 - next_member[a]
            for _ in range(rng.poisson(groups[t, a] + more * after)):
                number[t, a] += rng.geometric(more)
    return number


@compiled(error_model="python")
def filtered(
    counts: Int[np.ndarray, "T K"],
    following: Float[np.ndarray, "T K"],
    width: int,
    groups: Float[np.ndarray, " K"],
    next_member: Float[np.ndarray, " K"],
    roots: Float[np.ndarray, "J K K"],
    recursion: Float[np.ndarray, "J 4"],
    half_variance: Float[np.ndarray, " K"],
    particles: int,
    rng: np.random.Generator,
) -> float:
    """Log of the estimated probability of the counts of one stretch.

    The factors change every `width` grid points. `groups` is the mean number of groups per grid
    point that follow nobody, `following` that of those who follow others; `roots` and `recursion`
    are those of `Waves`.
    """
    scales, areas = len(roots), groups.size
    state = np.zeros((particles, 2, scales, areas))
    noise = np.empty((2, areas))
    log_weight = np.zeros(particles)
    logs = np.empty(particles)
    total = 0.0
    for first in range(0, len(counts), width):
        block, after = counts[first : first + width], following[first : first + width]
        for i in range(particles):
            now, before = state[i]
            for j in range(scales):
                a1, a2, sigma, r = recursion[j]
                for k in range(areas):
                    noise[0, k], noise[1, k] = rng.standard_normal(), 0.0
                    if first == 0:
                        noise[1, k] = rng.standard_normal()
                for k in range(areas):
                    fresh = older = 0.0
                    for b in range(areas):
                        fresh += roots[j, k, b] * noise[0, b]
                        older += roots[j, k, b] * noise[1, b]
                    if first == 0:
                        before[j, k], now[j, k] = older, r * older + np.sqrt(1 - r * r) * fresh
                    else:
                        moved = a1 * now[j, k] + a2 * before[j, k] + sigma * fresh
                        before[j, k], now[j, k] = now[j, k], moved
            logs[i] = 0.0
            for a in range(areas):
                log_factor = -half_variance[a]
                for j in range(scales):
                    log_factor += now[j, a]
                rate = groups[a] * np.exp(log_factor)
                for t in range(len(block)):
                    logs[i] += log_probability(block[t, a], rate + after[t, a], next_member[a])
        log_weight += logs
        highest = log_weight.max()
        weight = np.exp(log_weight - highest)
        summed = weight.sum()
        total += highest + np.log(summed)
        weight /= summed
        # The weights of the next step begin with those of this one, normalised.
        if 1.0 / (weight * weight).sum() < 0.5 * particles:
            state = state[_systematic(weight, rng.random())]
            log_weight[:] = -np.log(particles)
        else:
            log_weight = np.log(np.maximum(weight, 1e-300))
        if first == 0:
            # All weights were 1 at first, not 1 / particles.
            total -= np.log(particles)
    return total


@compiled(error_model="python")
def log_probability(number: int, rate: float, next_member: float) -> float:
    """Log-probability of a number of persons: Poisson groups with geometric sizes.

    The Pólya–Aeppli distribution, by its recursion (Johnson, Kemp and Kotz 2005, Univariate
    Discrete Distributions, eq. 9.166), in proportion to the probability of 0.
    """
    if number == 0:
        return -rate
    before, now = 0.0, 1.0
    for n in range(1, number + 1):
        first = (rate * (1 - next_member) + 2 * next_member * (n - 1)) / n * now
        second = next_member * next_member * (n - 2) / n * before if n > 1 else 0.0
        before, now = now, first - second
    return np.log(max(now, 1e-300)) - rate


@compiled(error_model="python")
def _systematic(weight: Float[np.ndarray, " P"], u: float) -> Int[np.ndarray, " P"]:
    """Indices of particles by systematic resampling."""
    chosen = np.empty(len(weight), np.int64)
    at, reached = 0, weight[0]
    for i in range(len(weight)):
        while (i + u) / len(weight) > reached and at < len(weight) - 1:
            at += 1
            reached += weight[at]
        chosen[i] = at
    return chosen
