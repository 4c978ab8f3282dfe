"""Training of the paper's model: the loss of batches of windows, and what Adam makes of it."""

import numpy as np
import pytest
import torch
from jaxtyping import Float
from models import AREAS, GRID_S
from torch import Tensor
from torch.nn.functional import softplus

from crowdbench.scene import load_scene
from crowdbench.spawn import NtppPaper
from crowdbench.spawn.paper import training
from crowdbench.spawn.paper.kernels import TINY, density
from crowdbench.spawn.paper.training import PaperSettings

FRAMES = 1000
Network = training._Network


def windows(seed: int = 0, count: int = 200) -> list[Float[np.ndarray, " _"]]:
    """Windows of 1,000 frames with some tens of events, few, and none; some are equal."""
    rng = np.random.default_rng(seed)
    found = []
    for events in rng.integers(0, 40, count) * (rng.random(count) < 0.8):
        times = np.sort(rng.uniform(0, FRAMES, events))
        found.append(np.diff(np.concatenate([[0.0], times, [float(FRAMES)]])))
    found[5][0] = 0.0  # as windows of the code begin
    return found


def log_density(network: Network, gaps: Float[Tensor, " L"]) -> Tensor:
    """Log-density of a window (eq. 5) by torch: of gaps that end with an event, and the rest."""
    log_gap = gaps.clamp_min(TINY).log()
    states = network.initial[None]
    if len(gaps) > 1:
        inputs = torch.stack([gaps, log_gap], dim=-1)[:-1]
        states = torch.cat([states, network.gru(inputs, states)[0]])
    if network.hidden is not None:
        states = torch.tanh(network.hidden(states))
    rate, shape = softplus(network.out(states)).unbind(-1)
    hazard = rate * torch.exp(shape * log_gap)
    logs = rate.log() + shape.log() + (shape - 1) * log_gap
    return logs[:-1].sum() - hazard.sum()


def loss_of(network: Network, found: list[Float[np.ndarray, " _"]]) -> Tensor:
    """The loss of a network by torch."""
    each = [log_density(network, torch.tensor(gaps, dtype=torch.float32)) for gaps in found]
    return -torch.stack(each).mean() / FRAMES


def network(code: bool, spread: float = 1.0) -> Network:
    torch.manual_seed(1)
    net = Network(code)
    with torch.no_grad():
        for tensor in net.parameters():
            tensor *= spread
    return net


@pytest.mark.parametrize("code", [False, True])
@pytest.mark.parametrize("spread", [0.3, 1.0, 2.0])
def test_the_loss_of_batches_is_that_of_their_windows(
    code: bool, spread: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(training, "_ROWS", 60)
    net, found = network(code, spread), windows()
    batches = training._batches(found, FRAMES)
    assert len(batches) > 1
    loss, expected = sum(training._loss(net, b) for b in batches), loss_of(net, found)
    assert loss.item() == pytest.approx(expected.item(), rel=1e-5)
    expected.backward()
    gradient = {name: tensor.grad.clone() for name, tensor in net.named_parameters()}
    net.zero_grad()
    loss.backward()
    for name, tensor in net.named_parameters():
        scale = float(gradient[name].abs().max())
        assert scale > 0
        np.testing.assert_allclose(tensor.grad, gradient[name], rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("count", [1, 3])
def test_windows_without_events_have_a_gradient_by_the_head_alone(count: int) -> None:
    net = network(False)
    found = [np.array([100.0 * (k + 1)]) for k in range(count)]
    losses = training.train(net, found, PaperSettings(epochs=1))
    assert losses == [pytest.approx(loss_of(network(False), found).item(), rel=1e-5)]
    moved = {
        name for name, w in net.weights().items() if (w != network(False).weights()[name]).any()
    }
    assert moved == {"hidden_weight", "hidden_bias", "out_weight", "out_bias"}


@pytest.mark.long
@pytest.mark.parametrize("code", [False, True])
def test_training_follows_that_by_torch(code: bool) -> None:
    settings = PaperSettings(epochs=30, published_code=code)
    found, net = windows(count=40), network(code)
    adam = torch.optim.Adam(net.parameters(), lr=settings.learning_rate)
    expected = []
    for _ in range(settings.epochs):
        adam.zero_grad()
        loss = loss_of(net, found)
        loss.backward()
        adam.step()
        expected.append(loss.item())
    np.testing.assert_allclose(training.train(network(code), found, settings), expected, rtol=1e-4)


def test_training_is_deterministic() -> None:
    nets = [network(False), network(False)]
    found = windows()
    first, second = (training.train(net, found, PaperSettings(epochs=5)) for net in nets)
    assert first == second
    for one, other in zip(*(net.weights().values() for net in nets), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("code", [False, True])
def test_torch_and_the_kernels_of_the_density_agree(code: bool) -> None:
    net = network(code)
    arrays = {name: array[None] for name, array in net.weights().items()}
    model = NtppPaper(AREAS, arrays, load_scene("eth-v0").dt_s, GRID_S, {"published_code": code})
    gaps = np.random.default_rng(0).exponential(4.0, 12)
    of_torch = float(log_density(net, torch.tensor(gaps, dtype=torch.float32)).detach())
    assert of_torch == pytest.approx(density(gaps, model.of_area(0), code)[0].sum(), rel=1e-4)


def test_batches_hold_each_window_once() -> None:
    gaps = [np.array([7.0]), np.array([1.0, 2.0, 3.0]), np.array([4.0, 0.0]), np.array([7.0])]
    (batch,) = training._batches(gaps, 10)
    assert batch.gap.tolist() == [[7, 1, 1], [4, 0, 1], [1, 2, 3]]
    assert batch.event.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0]]
    np.testing.assert_allclose(batch.log_gap[1, :2], np.log([4, TINY]), rtol=1e-6)
    share = np.array([[2, 0, 0], [1, 1, 0], [1, 1, 1]]) / 40
    np.testing.assert_allclose(batch.share, share, rtol=1e-6)
