"""The likelihood of `ntpp-gmm` in torch, for sequences of several networks at once."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from crowdbench.spawn.ntpp.kernels import BOUND, LOG_SHAPE_BOUND
from crowdbench.spawn.ntpp.model import HIDDEN
from crowdbench.spawn.ntpp.sequences import Sequence


@dataclass(frozen=True)
class Packed:
    """The sequences of `B` networks, packed.

    First come the starts of all sequences, then the first groups of those that have one, then the
    second groups of those that have two, and so on, padded to the same number in all networks. Row
    r represents a state and the gap that follows it.
    """

    live: list[int]
    """Number of sequences with at least j groups."""
    x: Float[Tensor, "B r 2"]
    """Input of the network for each row except the starts."""
    before: Float[Tensor, "B R"]
    """Grid steps without a group: all but the last step of a gap, or the rest of the window."""
    until: Float[Tensor, "B R"]
    """The gap in grid steps; 1 if no group ends it."""
    size: Float[Tensor, "B R"]
    """Number of persons in the group that ends the gap; 0 if none does."""
    persons: Float[Tensor, " B"]
    """Number of persons in all sequences of each network, at least 1."""


def pack(networks: list[list[Sequence]], scaling: np.ndarray) -> Packed:
    """Pack the sequences of each network; `scaling` are the weights of that name."""
    networks = [sorted(each, key=lambda s: -len(s.gap)) for each in networks]
    lengths = np.zeros((len(networks), max(map(len, networks))), dtype=np.int64)
    for b, each in enumerate(networks):
        lengths[b, : len(each)] = [len(s.gap) for s in each]
    live = [int((lengths >= j).sum(axis=1).max()) for j in range(lengths.max() + 1)]
    begin = np.cumsum([0, *live])
    shape = (len(networks), begin[-1])
    x = np.zeros((shape[0], shape[1] - live[0], 2))
    before, until, size = np.zeros(shape), np.ones(shape), np.zeros(shape)
    for b, each in enumerate(networks):
        for i, s in enumerate(each):
            n = len(s.gap)
            rows = begin[:n] + i
            before[b, rows], until[b, rows], size[b, rows] = s.gap - 1, s.gap, s.size
            before[b, begin[n] + i] = s.rest
            logs = np.log(np.stack([s.gap, s.size], axis=1))
            x[b, begin[1 : n + 1] + i - live[0]] = (logs - scaling[b, ::2]) / scaling[b, 1::2]
    persons = np.maximum(1, size.sum(axis=1))
    parts = (torch.tensor(a, dtype=torch.float32) for a in (x, before, until, size, persons))
    return Packed(live, *parts)


def head(weights: dict[str, Tensor], batch: Packed) -> tuple[Tensor, Tensor, Tensor]:
    """Weibull shape, log scale (grid steps) and −log P(one more member) at each row; (B, R)."""
    state = weights["initial"][:, None].expand(-1, batch.live[0], -1)
    states = [state]
    # Split in one call, because the gradient of each slice would be as large as the whole tensor.
    read = _linear(weights, "input", batch.x)
    each = torch.split(read, batch.live[1:], dim=1)
    for n, i in zip(batch.live[1:], each, strict=True):
        state = state[:, :n]
        s = _linear(weights, "state", state)
        gates = torch.sigmoid(i[..., : 2 * HIDDEN] + s[..., : 2 * HIDDEN])
        reset, keep = gates[..., :HIDDEN], gates[..., HIDDEN:]
        candidate = torch.tanh(i[..., 2 * HIDDEN :] + reset * s[..., 2 * HIDDEN :])
        state = (1 - keep) * candidate + keep * state
        states.append(state)
    out = _linear(weights, "out", torch.tanh(_linear(weights, "hidden", torch.cat(states, 1))))
    base = weights["base"][:, None]
    shape = torch.exp(base[..., 0] + _bounded(out[..., 0], LOG_SHAPE_BOUND))
    log_scale = base[..., 1] + _bounded(out[..., 1], BOUND)
    more = torch.nn.functional.softplus(-base[..., 2] - _bounded(out[..., 2], BOUND))
    return shape, log_scale, more


def _linear(weights: dict[str, Tensor], name: str, x: Tensor) -> Tensor:
    return torch.baddbmm(weights[f"{name}_bias"][:, None], x, weights[f"{name}_weight"].mT)


def _bounded(x: Tensor, bound: float) -> Tensor:
    return bound * torch.tanh(x / bound)


def nats(weights: dict[str, Tensor], batch: Packed) -> Tensor:
    """Negative log-probability of each network's sequences, (B,)."""
    shape, log_scale, more = head(weights, batch)
    # For 0 steps the hazard is 0, but its derivative with respect to the shape would be 0 · ∞.
    some = batch.before > 0
    steps = torch.where(some, batch.before, torch.ones_like(batch.before))
    before = some * torch.exp(shape * (torch.log(steps) - log_scale))
    until = torch.exp(shape * (torch.log(batch.until) - log_scale))
    ends = batch.size > 0
    last = torch.where(ends, until - before, torch.ones_like(before)).clamp_min(1e-12)
    size = more * (batch.size - 1) - torch.log(-torch.expm1(-more))
    return (before + ends * (size - torch.log(-torch.expm1(-last)))).sum(dim=1)
