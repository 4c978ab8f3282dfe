"""Compiled kernels of `ntpp-gmm`: cumulative hazards of groups, and sampling.

They process one area at a time, in float64. `weights` are those of one area in the order of
`ntpp.SHAPES`. Likelihood and sampling use the same functions `_head` and `_update`.
"""

import math

import numpy as np

from crowdbench.compilation import compiled

LOG_SHAPE_BOUND = 2.0
"""The Weibull shape stays within a factor of exp(±2) of its base value."""
BOUND = 4.0
"""The scale and the odds of one more member stay within a factor of exp(±4) of their base value."""


@compiled(error_model="python")
def _bounded(x, bound):
    return bound * math.tanh(x / bound)


@compiled(error_model="python")
def _sigmoid(x):
    return 1.0 / (1.0 + math.exp(-x))


@compiled(error_model="python")
def _head(h, weights):
    """Weibull shape and scale (grid steps) of the next gap, and −log P(one more member)."""
    hidden_weight, hidden_bias, out_weight, out_bias, base = weights[5:10]
    out = out_weight @ np.tanh(hidden_weight @ h + hidden_bias) + out_bias
    shape = math.exp(base[0] + _bounded(out[0], LOG_SHAPE_BOUND))
    scale = math.exp(base[1] + _bounded(out[1], BOUND))
    more = math.log1p(math.exp(-base[2] - _bounded(out[2], BOUND)))
    return shape, scale, more


@compiled(error_model="python")
def gru(x, h, input_weight, input_bias, state_weight, state_bias):
    """The next state of a gated recurrent unit with input x and state h, as in torch."""
    n = len(h)
    i = input_weight @ x + input_bias
    s = state_weight @ h + state_bias
    new = np.empty(n)
    for j in range(n):
        reset = _sigmoid(i[j] + s[j])
        keep = _sigmoid(i[n + j] + s[n + j])
        candidate = math.tanh(i[2 * n + j] + reset * s[2 * n + j])
        new[j] = (1.0 - keep) * candidate + keep * h[j]
    return new


@compiled(error_model="python")
def _update(h, gap, size, weights):
    """The state after a group of `size` that enters `gap` grid steps after the previous group."""
    scaling = weights[10]
    x = np.empty(2)
    x[0] = (math.log(gap) - scaling[0]) / scaling[1]
    x[1] = (math.log(size) - scaling[2]) / scaling[3]
    return gru(x, h, weights[0], weights[1], weights[2], weights[3])


@compiled(error_model="python")
def _forget(h, steps, memory, weights):
    """Reset the state after each `memory` grid steps without a group.

    Returns the state after `steps` grid steps, the steps since the last reset, and the cumulative
    hazard before it.
    """
    hazard = 0.0
    while memory < steps:
        shape, scale, _ = _head(h, weights)
        hazard += (memory / scale) ** shape
        h = weights[4].copy()
        steps -= memory
    return h, steps, hazard


@compiled(error_model="python")
def expect(gap, size, offsets, rest, memory, weights, gaps, sizes, rests):
    """Run the network along the spells of one area.

    Fills the cumulative hazards `gaps` and `sizes` (n, 2) and `rests` (S,).
    """
    for s in range(len(rest)):
        h = weights[4].copy()
        for i in range(offsets[s], offsets[s + 1]):
            h, steps, before = _forget(h, gap[i], memory, weights)
            shape, scale, more = _head(h, weights)
            gaps[i, 0] = before + ((steps - 1) / scale) ** shape
            gaps[i, 1] = before + (steps / scale) ** shape
            sizes[i, 0] = more * (size[i] - 1)
            sizes[i, 1] = more * size[i]
            h = _update(h, steps, size[i], weights)
        h, steps, before = _forget(h, rest[s], memory, weights)
        shape, scale, more = _head(h, weights)
        rests[s] = before + (steps / scale) ** shape


@compiled(error_model="python")
def draw(points, memory, weights, rng):
    """Sample the grid points in [0, `points`) at which groups enter one area, and their sizes."""
    ticks = np.empty(points, np.int64)
    sizes = np.empty(points, np.int64)
    n = 0
    tick = -1  # grid point of the last group or reset
    h = weights[4].copy()
    while True:
        shape, scale, more = _head(h, weights)
        gap = max(1.0, math.ceil(scale * (-math.log1p(-rng.random())) ** (1.0 / shape)))
        if min(gap, memory + 1.0) >= points - tick:
            return ticks[:n], sizes[:n]
        if gap > memory:
            tick += memory
            h = weights[4].copy()
            continue
        size = 1.0 + math.floor(-math.log1p(-rng.random()) / more)
        tick += int(gap)
        ticks[n] = tick
        sizes[n] = int(size)
        n += 1
        h = _update(h, gap, size, weights)
