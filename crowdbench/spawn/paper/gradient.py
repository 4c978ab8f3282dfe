"""Compiled loss of `ntpp-paper` and its gradient, by backpropagation through time.

They stand in for torch's automatic differentiation, which takes about five times as long for
networks of this size. The windows of a batch are sorted from long to short, and their gaps are
stored by step: at step t only the windows with more than t gaps take part, so there is no padding.
Numbers are float32, in arrays whose rows are gaps.

The unit is that of torch (`nn.GRU`) with the reset gate r, the update gate z and the candidate c:
h' = (1 − z) c + z h and c = tanh(i + r s), where i is linear in the input and s in the state h.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from crowdbench.compilation import compiled
from crowdbench.spawn.paper.kernels import TINY
from crowdbench.spawn.paper.model import HIDDEN

ROWS = 80
"""Windows in a batch. OpenBLAS uses one thread for products of matrices this small, so the order of
summation is fixed, and their rows stay in the cache."""

_ZERO, _ONE, _TWO = np.float32(0.0), np.float32(1.0), np.float32(2.0)
_Z, _S = HIDDEN, 2 * HIDDEN
"""Where the columns of z and s begin; those of r come first."""

_compiled = compiled(fastmath={"contract"})
"""Without checks for a division by 0, which keep loops from working on many numbers at once. For
the same reason the loops over units end at a shape, as those with a fixed end are unrolled."""


class Weights(NamedTuple):
    """The weights of one area, as in `ntpp_paper.SHAPES`, or the gradient by them."""

    input_weight: Float[np.ndarray, "3*H 2"]
    input_bias: Float[np.ndarray, " 3*H"]
    state_weight: Float[np.ndarray, "3*H H"]
    state_bias: Float[np.ndarray, " 3*H"]
    initial: Float[np.ndarray, " H"]
    """Not trained: its gradient stays 0."""
    hidden_weight: Float[np.ndarray, "H H"]
    hidden_bias: Float[np.ndarray, " H"]
    out_weight: Float[np.ndarray, "2 H"]
    out_bias: Float[np.ndarray, " 2"]


class Batch(NamedTuple):
    """The gaps of windows by step, and in each step by window, from long to short."""

    inputs: Float[np.ndarray, "n 3"]
    """The gap in frames, its logarithm, and 1 for the bias."""
    log_gap: Float[np.ndarray, " n"]
    event: Float[np.ndarray, " n"]
    """1 where an event ends the gap, 0 where the window ends."""
    share: Float[np.ndarray, " n"]
    """Weight of the window in the loss."""
    offsets: Int[np.ndarray, " T+1"]
    """The rows of step t begin at offsets[t] and end before offsets[t + 1]."""


class Scratch(NamedTuple):
    """Memory that all batches use in turn; to get new memory for each takes long."""

    state: Float[np.ndarray, "n H"]
    """The state before each gap."""
    gates: Float[np.ndarray, "n 3*H"]
    """r, z and s on the way to the next state, and later the gradient by what they are made of."""
    candidate: Float[np.ndarray, "n H"]
    """c on the way to the next state, and later the gradient by i."""

    @classmethod
    def of(cls, batches: Sequence[Batch]) -> "Scratch":
        """As much memory as the largest batch needs."""
        n = max(len(batch.log_gap) for batch in batches)
        return cls(*(np.empty((n, k * HIDDEN), np.float32) for k in (1, 3, 1)))


class _Turned(NamedTuple):
    """Weights in the form in which the way forward is fastest."""

    by_input: Float[np.ndarray, "3 3*H"]
    """For each column of `Batch.inputs`; with the bias of the state where it is only added."""
    state_weight: Float[np.ndarray, "H 3*H"]
    hidden_weight: Float[np.ndarray, "H H"]


def pack(windows: Sequence[Float[np.ndarray, " _"]], share: Float[np.ndarray, " V"]) -> Batch:
    """A batch of windows, given by their gaps in frames; the last gap of each ends the window."""
    lengths = np.array([len(window) for window in windows])
    order = np.argsort(-lengths, kind="stable")
    sizes = [int((lengths > t).sum()) for t in range(lengths.max())]
    at = np.concatenate([order[:size] for size in sizes])
    step = np.repeat(np.arange(len(sizes)), sizes)
    begin = np.cumsum(lengths) - lengths
    gap = np.concatenate(windows)[begin[at] + step].astype(np.float32)
    log_gap = np.log(np.maximum(gap, np.float32(TINY)))
    return Batch(
        np.stack([gap, log_gap, np.ones_like(gap)], axis=1),
        log_gap,
        (step < lengths[at] - 1).astype(np.float32),
        share[at].astype(np.float32),
        np.concatenate([[0], np.cumsum(sizes)]),
    )


@_compiled
def exponential(x):
    """exp(x) of a float32 by operations that can be done for many numbers at once.

    exp(x) = 2ⁿ exp(r) with |r| ≤ log(2) / 2, and the polynomial of Cephes (Moshier, `expf`) for
    exp(r). Beyond ±87 it is that of ±87, so that the result is a normal number.
    """
    x = min(max(x, np.float32(-87.0)), np.float32(87.0))
    # The last bits of so large a number are the integer n next to x / log(2).
    shifted = np.float32(x * np.float32(1.44269504) + np.float32(12582912.0))
    n = shifted - np.float32(12582912.0)
    r = x - n * np.float32(0.693359375) + n * np.float32(2.12194440e-4)
    p = np.float32(1.9875691500e-4) * r + np.float32(1.3981999507e-3)
    p = p * r + np.float32(8.3334519073e-3)
    p = p * r + np.float32(4.1665795894e-2)
    p = p * r + np.float32(1.6666665459e-1)
    p = p * r + np.float32(5.0000001201e-1)
    power_of_two = (shifted.view(np.int32) << np.int32(23)) + np.int32(0x3F800000)
    return (p * (r * r) + r + _ONE) * np.int32(power_of_two).view(np.float32)


@_compiled
def softplus(x):
    """log(1 + eˣ) of a float32, by log(1 + e) = 2 artanh(e / (2 + e)) for e ≤ 1, and its series."""
    e = exponential(-abs(x))
    y = e / (_TWO + e)
    q = y * y
    p = np.float32(1 / 13) * q + np.float32(1 / 11)
    p = p * q + np.float32(1 / 9)
    p = p * q + np.float32(1 / 7)
    p = p * q + np.float32(1 / 5)
    p = p * q + np.float32(1 / 3)
    return max(x, _ZERO) + _TWO * (y * q * p + y)


@_compiled
def _sigmoid(x):
    return _ONE / (_ONE + exponential(-x))


@_compiled
def _tanh(x):
    return _ONE - _TWO / (_ONE + exponential(_TWO * x))


@_compiled
def _add(x, into):
    """Add numbers to others in the same order."""
    x, into = x.ravel(), into.ravel()
    for i in range(len(x)):
        into[i] += x[i]


@_compiled
def _add_rows(x, into):
    """Add the sum of the rows (n, k) of x to `into`."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            into[j] += x[i, j]


@_compiled
def _losses(log_gap, event, share, out, bias):
    """The loss of n gaps (eq. 5); replaces the output of the head (2, n) by the gradient by it."""
    rest, product = np.empty_like(share), np.empty_like(share)
    for i in range(len(share)):
        first, second = out[0, i] + bias[0], out[1, i] + bias[1]
        rate, shape = softplus(first), softplus(second)
        power = exponential(shape * log_gap[i])
        hazard = rate * power
        rest[i] = event[i] * (shape - _ONE) * log_gap[i] - hazard
        product[i] = rate * shape
        by_rate = event[i] / rate - power
        by_shape = event[i] * (_ONE / shape + log_gap[i]) - hazard * log_gap[i]
        out[0, i] = -share[i] * by_rate * _sigmoid(first)
        out[1, i] = -share[i] * by_shape * _sigmoid(second)
    loss = 0.0
    for i in range(len(share)):  # apart from the others, as logarithms are taken one by one
        loss -= share[i] * (rest[i] + event[i] * math.log(product[i]))
    return loss


@_compiled
def _activate(x, bias):
    """Replace x by tanh(x + bias); rows of units."""
    for i in range(x.shape[0]):
        for j in range(x.shape[1]):
            x[i, j] = _tanh(x[i, j] + bias[j])


@_compiled
def _spread(by_out, weight, by_top):
    """Fill the gradient by the units that the outputs (2, n) are made of."""
    for i in range(by_top.shape[0]):
        for j in range(by_top.shape[1]):
            by_top[i, j] = by_out[0, i] * weight[0, j] + by_out[1, i] * weight[1, j]


@_compiled
def _deactivate(top, by_top):
    """Replace the gradient by the values of tanh by that by its arguments."""
    for i in range(top.shape[0]):
        for j in range(top.shape[1]):
            by_top[i, j] *= _ONE - top[i, j] * top[i, j]


@_compiled
def _head(batch, a, b, state, weights, turned, linear, gradient, by_state):
    """The loss of the gaps of rows a to b; fills `by_state` and adds to the gradient."""
    top = state
    if not linear:
        top = np.dot(state, turned.hidden_weight)
        _activate(top, weights.hidden_bias)
    out = np.dot(weights.out_weight, top.T)
    loss = _losses(batch.log_gap[a:b], batch.event[a:b], batch.share[a:b], out, weights.out_bias)
    _add(np.dot(out, top), gradient.out_weight)
    _add_rows(out.T, gradient.out_bias)
    if linear:
        _spread(out, weights.out_weight, by_state)
    else:
        by_top = np.empty_like(top)
        _spread(out, weights.out_weight, by_top)
        _deactivate(top, by_top)
        _add(np.dot(by_top.T, state), gradient.hidden_weight)
        _add_rows(by_top, gradient.hidden_bias)
        np.dot(by_top, weights.hidden_weight, by_state)
    return loss


@_compiled
def _forward(inputs, state, turned, state_bias, gates, candidate, new):
    """Fill the `new` state and what leads to it."""
    np.dot(state, turned.state_weight, gates)
    by_input = turned.by_input
    units = state.shape[1]
    for i in range(len(state)):
        gap, log_gap = inputs[i, 0], inputs[i, 1]
        for j in range(2 * units):
            of_input = gap * by_input[0, j] + log_gap * by_input[1, j] + by_input[2, j]
            gates[i, j] = _sigmoid(of_input + gates[i, j])
        for j in range(units):
            gates[i, _S + j] += state_bias[_S + j]
        for j in range(units):
            k = _S + j
            of_input = gap * by_input[0, k] + log_gap * by_input[1, k] + by_input[2, k]
            candidate[i, j] = _tanh(of_input + gates[i, j] * gates[i, k])
        for j in range(units):
            c = candidate[i, j]
            new[i, j] = c + gates[i, _Z + j] * (state[i, j] - c)


@_compiled
def _turn_back(state, gates, candidate, by_new):
    """Replace values by gradients, and `by_new` by the part that comes straight from `state`."""
    units = state.shape[1]
    for i in range(len(state)):
        for j in range(units):
            r, z, s, c = gates[i, j], gates[i, _Z + j], gates[i, _S + j], candidate[i, j]
            by = by_new[i, j]
            by_i = by * (_ONE - z) * (_ONE - c * c)
            gates[i, j] = by_i * s * r * (_ONE - r)
            gates[i, _Z + j] = by * (state[i, j] - c) * z * (_ONE - z)
            gates[i, _S + j] = by_i * r
            candidate[i, j] = by_i
            by_new[i, j] = by * z


@_compiled
def _turned(weights):
    by_input = np.empty((3, 3 * HIDDEN), np.float32)
    by_input[:2] = weights.input_weight.T
    by_input[2] = weights.input_bias
    by_input[2, :_S] += weights.state_bias[:_S]
    return _Turned(
        by_input,
        np.ascontiguousarray(weights.state_weight.T),
        np.ascontiguousarray(weights.hidden_weight.T),
    )


@_compiled
def add_gradient(batch, weights, linear, gradient, scratch):
    """Add the gradient of a batch's loss, −Σ share · log-density; returns the loss."""
    state, gates, candidate = scratch
    inputs, offsets, turned = batch.inputs, batch.offsets, _turned(weights)
    state[: offsets[1]] = weights.initial
    for t in range(len(offsets) - 2):
        a, b, end = offsets[t], offsets[t + 1], offsets[t + 2]
        stop = a + end - b  # windows that end with this step are the last ones of it
        now = slice(a, stop)
        _forward(
            inputs[now], state[now], turned, weights.state_bias,
            gates[now], candidate[now], state[b:end],
        )  # fmt: skip
    loss = 0.0
    by_gates = np.zeros((3, 3 * HIDDEN), np.float32)
    by_i = np.zeros((3, HIDDEN), np.float32)
    by_new = np.empty((0, HIDDEN), np.float32)
    for t in range(len(offsets) - 2, -1, -1):
        a, b = offsets[t], offsets[t + 1]
        by_state = np.empty((b - a, HIDDEN), np.float32)
        loss += _head(batch, a, b, state[a:b], weights, turned, linear, gradient, by_state)
        now = slice(a, a + len(by_new))
        if len(by_new):
            _turn_back(state[now], gates[now], candidate[now], by_new)
            _add(np.dot(inputs[now].T, gates[now]), by_gates)
            _add(np.dot(inputs[now].T, candidate[now]), by_i)
            _add(np.dot(gates[now].T, state[now]), gradient.state_weight)
            _add(np.dot(gates[now], weights.state_weight), by_new)
            _add(by_new, by_state[: len(by_new)])
        by_new = by_state
    _add(by_gates[2], gradient.state_bias)
    by_gates[:, _S:] = by_i  # which has a bias and weights of its own
    gradient.input_weight[:] += by_gates[:2].T
    _add(by_gates[2], gradient.input_bias)
    return loss
