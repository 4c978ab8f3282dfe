"""Compiled kernels of `ntpp-paper`: densities of events, and sampling, one area at a time.

`weights` are those of one area in the order of `ntpp_paper.SHAPES`; times are in frames.
"""

import math

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.spawn.ntpp.kernels import gru

TINY = 1e-8
"""Gaps are at least this long, in frames; the published code clamps at the same value."""


@compiled(error_model="python")
def _softplus(x):
    return max(x, 0.0) + math.log1p(math.exp(-abs(x)))


@compiled(error_model="python")
def _head(h, weights, linear):
    """Rate b and shape k of the next gap: P(gap > τ) = exp(−b τᵏ)."""
    hidden_weight, hidden_bias, out_weight, out_bias = weights[5:9]
    out = out_weight @ (h if linear else np.tanh(hidden_weight @ h + hidden_bias)) + out_bias
    return _softplus(out[0]), _softplus(out[1])


@compiled(error_model="python")
def _update(h, gap, weights):
    """The state after an event that follows the previous one by `gap`."""
    x = np.empty(2)
    x[0] = gap
    x[1] = math.log(max(gap, TINY))
    return gru(x, h, weights[0], weights[1], weights[2], weights[3])


@compiled(error_model="python")
def density(gaps, weights, linear):
    """Log-density of each gap, and its cumulative hazard; the last gap ends without an event."""
    logs, hazards = np.empty(len(gaps)), np.empty(len(gaps))
    h = weights[4].copy()
    for i in range(len(gaps)):
        b, k = _head(h, weights, linear)
        gap = max(gaps[i], TINY)
        hazards[i] = b * gap**k
        logs[i] = math.log(b) + math.log(k) + (k - 1.0) * math.log(gap) - hazards[i]
        h = _update(h, gaps[i], weights)
    if len(gaps):
        logs[-1] = -hazards[-1]
    return logs, hazards


@compiled(error_model="python")
def draw(end, most, weights, linear, clamped, rng):
    """Sample the times of events in [0, `end`); stops after `most` events.

    With `clamped`, the state is clamped at 1e-8 before it is used, as in the published code.
    """
    times = np.empty(256)
    n, now = 0, 0.0
    h = weights[4].copy()
    while n < most:
        if clamped:
            h = np.maximum(h, TINY)
        b, k = _head(h, weights, linear)
        gap = (-math.log1p(-rng.random()) / b + TINY * clamped) ** (1.0 / k)
        now += gap
        if not now < end:
            break
        if n == len(times):
            times = np.concatenate((times, np.empty(n)))
        times[n] = now
        n += 1
        h = _update(h, gap, weights)
    return times[:n]
