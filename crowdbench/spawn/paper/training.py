"""Training of `ntpp-paper` with torch, as the founding paper and its published code describe it.

Windows of w frames, o frames apart (the paper's "overlap" is a stride in its code), are cut from
the recording; windows at the end of an observed stretch are shorter. The loss is the mean over the
windows of the negative log-density of their gaps, with the survival term of eq. 5 for the time
after the last event, divided by w. Each epoch is one Adam step on all windows of an area, as in the
published code; the paper does not say how windows are batched. There is no early stopping and no
calibration. An area in which nobody enters during the training time gets a rate of almost 0, as
there is nothing to train on.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import softplus
from torch.nn.utils.rnn import pad_sequence

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.ntpp.model import HIDDEN
from crowdbench.spawn.ntpp.sequences import windows
from crowdbench.spawn.ntpp.training import deterministic
from crowdbench.spawn.paper.kernels import TINY
from crowdbench.spawn.paper.model import SHAPES, NtppPaper, between, gaps_within

_ROWS = 512  # windows in a batch; all batches of an area make one step
_NEVER = -100.0  # output of a head that gives a rate of almost 0


@dataclass(frozen=True)
class PaperSettings:
    """Settings of training; the defaults are those of the paper."""

    window_frames: int = 1000
    stride_frames: int = 50
    """The paper compares windows of 100, 500 and 1000 frames and strides of 5 and 50."""
    epochs: int = 500
    learning_rate: float = 0.0
    """By default (0) 1e-4, as in the paper, and 5e-3 with `published_code`."""
    published_code: bool = False
    """Whether the model is that of the published code; see `ntpp_paper`."""

    def __post_init__(self) -> None:
        if self.learning_rate == 0.0:
            object.__setattr__(self, "learning_rate", 5e-3 if self.published_code else 1e-4)


DEFAULT = PaperSettings()


class _Network(nn.Module):
    def __init__(self, linear: bool) -> None:
        super().__init__()
        self.gru = nn.GRU(2, HIDDEN, batch_first=True)
        self.hidden = None if linear else nn.Linear(HIDDEN, HIDDEN)
        self.out = nn.Linear(HIDDEN, 2)
        self.initial: Tensor = torch.zeros(HIDDEN) if linear else torch.randn(HIDDEN)

    def forward(self, gap: Float[Tensor, "V L"], log_gap: Float[Tensor, "V L"]) -> Tensor:
        """The outputs (V, L, 2) of the head before each gap of V windows."""
        states = self.initial.expand(len(gap), 1, HIDDEN)
        if gap.shape[1] > 1:
            inputs = torch.stack([gap, log_gap], dim=-1)[:, :-1]
            later, _ = self.gru(inputs, states.transpose(0, 1).contiguous())
            states = torch.cat([states, later], dim=1)
        return self.out(states if self.hidden is None else torch.tanh(self.hidden(states)))

    def tensors(self) -> dict[str, Tensor]:
        """The weights with the names of `SHAPES`, in their order."""
        hidden, of_gru = self.hidden, dict(self.gru.named_parameters())
        return {
            "input_weight": of_gru["weight_ih_l0"],
            "input_bias": of_gru["bias_ih_l0"],
            "state_weight": of_gru["weight_hh_l0"],
            "state_bias": of_gru["bias_hh_l0"],
            "initial": self.initial,
            "hidden_weight": torch.zeros(HIDDEN, HIDDEN) if hidden is None else hidden.weight,
            "hidden_bias": torch.zeros(HIDDEN) if hidden is None else hidden.bias,
            "out_weight": self.out.weight,
            "out_bias": self.out.bias,
        }

    def weights(self) -> dict[str, np.ndarray]:
        """Copies of the weights with the names of `SHAPES`."""
        return {name: tensor.detach().numpy().copy() for name, tensor in self.tensors().items()}


def fit(
    arrivals: Arrivals, areas: Areas, scene: Scene, *, seed: int, settings: PaperSettings = DEFAULT
) -> NtppPaper:
    """Train the networks of a scene's areas; the same seed gives the same weights."""
    rng = np.random.default_rng([seed, 0])
    weights: dict[str, list[np.ndarray]] = {name: [] for name in SHAPES}
    with deterministic(), torch.random.fork_rng(devices=[]):
        for k in range(arrivals.areas):
            torch.manual_seed(1000 * seed + k)
            network = _Network(settings.published_code)
            found = sequences(arrivals, k, scene, settings, rng)
            if any(len(gaps) > 1 for gaps in found):
                train(network, found, settings)
            else:  # nobody enters: a rate of almost 0
                with torch.no_grad():
                    network.out.weight.zero_()
                    network.out.bias.copy_(torch.tensor([_NEVER, 1.0]))
            for name, array in network.weights().items():
                weights[name].append(array)
    stacked = {name: np.stack(each) for name, each in weights.items()}
    return NtppPaper(areas, stacked, scene.dt_s, arrivals.grid_s, asdict(settings))


def sequences(
    arrivals: Arrivals, area: int, scene: Scene, settings: PaperSettings, rng: np.random.Generator
) -> list[Float[np.ndarray, " _"]]:
    """The gaps in each training window of an area, in frames; the last one ends the window."""
    step = arrivals.grid_s / scene.dt_s
    tick = arrivals.tick[arrivals.area == area]
    if settings.published_code:
        times = np.unique(np.floor(tick * step + 1e-6))
    else:
        times = np.sort((tick + rng.random(len(tick))) * step)
    width = max(1, round(settings.window_frames / step))
    stride = max(1, round(settings.stride_frames / step))
    if not settings.published_code:
        cut = windows(arrivals.windows, width, stride)
        return [gaps_within(times, a * step, b * step) for a, b in cut.tolist()]
    found = []
    for start, stop in arrivals.windows.tolist():
        for a in range(start, stop, stride):
            inside = between(times, a * step, min(a + width, stop) * step)
            if len(inside):
                last = inside[0] + settings.window_frames
                found.append(np.diff(np.concatenate([inside[:1], inside, [last]])))
    return found


def train(
    network: _Network, found: Sequence[Float[np.ndarray, " _"]], settings: PaperSettings
) -> list[float]:
    """Train a network on its windows; returns the loss before each epoch."""
    batches = _batches(found, settings.window_frames)
    adam = torch.optim.Adam(network.parameters(), lr=settings.learning_rate)
    losses = []
    for _ in range(settings.epochs):
        adam.zero_grad()
        losses.append(0.0)
        for batch in batches:  # one step: their gradients are added
            loss = _loss(network, batch)
            loss.backward()  # type: ignore[no-untyped-call]
            losses[-1] += loss.item()
        adam.step()
    return losses


class _Windows(NamedTuple):
    gap: Float[Tensor, "V L"]
    """In frames; the last one of a window ends without an event."""
    log_gap: Float[Tensor, "V L"]
    event: Float[Tensor, "V L"]
    """1 where an event ends the gap."""
    share: Float[Tensor, "V L"]
    """Weight of the window in the loss; 0 where it is padded."""


def _batches(found: Sequence[Float[np.ndarray, " _"]], window_frames: int) -> list[_Windows]:
    """Windows of similar lengths together, each with its share; those that are equal count once.

    Most windows of a quiet area are equal, as nobody enters.
    """
    count = Counter(gaps.astype(np.float32).tobytes() for gaps in found)
    by_length = sorted(count.items(), key=lambda item: len(item[0]))
    batches = []
    for k in range(0, len(by_length), _ROWS):
        rows = [
            torch.frombuffer(bytearray(data), dtype=torch.float32)
            for data, _ in by_length[k : k + _ROWS]
        ]
        shares = torch.tensor([n for _, n in by_length[k : k + _ROWS]], dtype=torch.float32)
        gap = pad_sequence(rows, batch_first=True, padding_value=1.0)
        length = torch.tensor([len(row) for row in rows])[:, None]
        step = torch.arange(gap.shape[1])
        share = shares[:, None] / (len(found) * window_frames) * (step < length)
        batches.append(_Windows(gap, gap.clamp_min(TINY).log(), (step < length - 1).float(), share))
    return batches


def _loss(network: _Network, batch: _Windows) -> Float[Tensor, ""]:
    """−Σ share · log-density of the gaps of a batch (eq. 5)."""
    rate, shape = softplus(network(batch.gap, batch.log_gap)).unbind(-1)
    density = rate.log() + shape.log() + (shape - 1) * batch.log_gap
    hazard = rate * torch.exp(shape * batch.log_gap)
    return -(batch.share * (batch.event * density - hazard)).sum()
