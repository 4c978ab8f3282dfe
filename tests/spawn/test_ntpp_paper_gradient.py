"""The compiled loss and gradient of the paper's model against torch's automatic differentiation."""

import numpy as np
import pytest
import torch
from jaxtyping import Float
from models import AREAS, GRID_S
from numba import njit
from torch import Tensor
from torch.nn.functional import softplus

from crowdbench.scene import load_scene
from crowdbench.spawn import NtppPaper
from crowdbench.spawn.paper import gradient as kernels
from crowdbench.spawn.paper import training
from crowdbench.spawn.paper.kernels import TINY, density
from crowdbench.spawn.paper.model import HIDDEN, SHAPES
from crowdbench.spawn.paper.training import Settings

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


def gradient_of(net: Network, found: list[Float[np.ndarray, " _"]], code: bool) -> tuple:
    """The loss by the kernels, and its gradient by name."""
    weights = kernels.Weights(*net.weights().values())
    gradient = kernels.Weights(*map(np.zeros_like, weights))
    batches = training._batches(found, FRAMES)
    assert len(batches) > 1
    scratch = kernels.Scratch.of(batches)
    loss = sum(kernels.add_gradient(b, weights, code, gradient, scratch) for b in batches)
    return loss, gradient._asdict()


@pytest.mark.parametrize("code", [False, True])
@pytest.mark.parametrize("spread", [0.3, 1.0, 2.0])
def test_loss_and_gradient_are_those_of_torch(code: bool, spread: float) -> None:
    net, found = network(code, spread), windows()
    loss, gradient = gradient_of(net, found, code)
    expected = loss_of(net, found)
    assert loss == pytest.approx(expected.item(), rel=1e-5)
    expected.backward()
    for name, tensor in net.tensors().items():
        if tensor.grad is None:
            assert name in ("initial", "hidden_weight", "hidden_bias")
            assert not gradient[name].any()
        else:
            scale = float(tensor.grad.abs().max())
            assert scale > 0
            np.testing.assert_allclose(gradient[name], tensor.grad, rtol=1e-4, atol=1e-5 * scale)


@pytest.mark.parametrize("count", [1, 3])
def test_windows_without_events_have_a_gradient_by_the_head_alone(count: int) -> None:
    net = network(False)
    found = [np.array([100.0 * (k + 1)]) for k in range(count)]
    losses = training.train(net, found, Settings(epochs=1))
    assert losses == [pytest.approx(loss_of(network(False), found).item(), rel=1e-5)]
    moved = {
        name for name, w in net.weights().items() if (w != network(False).weights()[name]).any()
    }
    assert moved == {"hidden_weight", "hidden_bias", "out_weight", "out_bias"}


@pytest.mark.parametrize("code", [False, True])
def test_training_follows_that_by_torch(code: bool) -> None:
    settings = Settings(epochs=30, published_code=code)
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
    first, second = (training.train(net, found, Settings(epochs=5)) for net in nets)
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


def test_batches_hold_each_gap_once_by_step() -> None:
    found = [np.array([7.0]), np.array([1.0, 2.0, 3.0]), np.array([4.0, 0.0])]
    batch = kernels.pack(found, np.array([0.5, 0.2, 0.3]))
    assert batch.offsets.tolist() == [0, 3, 5, 6]
    assert batch.inputs[:, 0].tolist() == [1, 4, 7, 2, 0, 3]
    np.testing.assert_allclose(batch.log_gap, np.log([1, 4, 7, 2, TINY, 3]), rtol=1e-6)
    assert batch.event.tolist() == [1, 1, 0, 1, 0, 0]
    np.testing.assert_allclose(batch.share, [0.2, 0.3, 0.5, 0.2, 0.3, 0.2], rtol=1e-6)


def test_weights_have_the_names_of_the_files() -> None:
    assert kernels.Weights._fields == tuple(SHAPES)


def test_products_are_small_enough_for_one_thread() -> None:
    # OpenBLAS, interface/gemm.c: more threads above 65,536 times 4 multiplications.
    assert kernels.ROWS * HIDDEN * 3 * HIDDEN <= 65_536 * 4


@njit
def each_of(function, x):  # type: ignore[no-untyped-def]
    out = np.empty_like(x)
    for i in range(len(x)):
        out[i] = function(x[i])
    return out


def test_the_exponential_is_exact_to_the_last_bits_of_a_float32() -> None:
    x = np.linspace(-87, 87, 1_000_001).astype(np.float32)
    np.testing.assert_allclose(each_of(kernels.exponential, x), np.exp(x.astype(float)), rtol=2e-7)
    beyond = np.array([-np.inf, -1e30, -100.0, 100.0, 1e30, np.inf], np.float32)
    ends = np.exp(np.array([-87.0, 87.0]))
    np.testing.assert_allclose(each_of(kernels.exponential, beyond), np.repeat(ends, 3), rtol=2e-7)


def test_softplus_is_exact_to_the_last_bits_of_a_float32() -> None:
    x = np.linspace(-80, 80, 1_000_001).astype(np.float32)
    expected = np.logaddexp(0.0, x.astype(float))
    np.testing.assert_allclose(each_of(kernels.softplus, x), expected, rtol=4e-7)
