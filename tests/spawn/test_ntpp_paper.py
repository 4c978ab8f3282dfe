"""The paper's model to the letter, and what its published code does otherwise."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from models import AREAS, GRID_S, arrivals_at, learned, renewal
from scipy.integrate import quad
from scipy.stats import kstest

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, NtppPaper, PoissonGMM, PoissonPaper, arrivals_in
from crowdbench.spawn.ntpp.model import HIDDEN
from crowdbench.spawn.paper import training
from crowdbench.spawn.paper.kernels import density, draw
from crowdbench.spawn.paper.model import SHAPES
from crowdbench.spawn.paper.training import DEFAULT, PaperSettings, sequences
from studies.paper.study import residuals_of

ETH = load_scene("eth-v0")
BRIEF = PaperSettings(window_frames=100, epochs=20, learning_rate=1e-2)


def network(seed: int = 0, spread: float = 0.3, *, code: bool = False) -> NtppPaper:
    """Random weights as large as trained ones; the past matters."""
    rng = np.random.default_rng(seed)
    weights = {name: spread * rng.standard_normal((2, *shape)) for name, shape in SHAPES.items()}
    weights["input_weight"][..., 0] *= 0.02  # gaps are some tens of frames
    weights["out_bias"] = np.array([[-2.0, 0.5], [-2.5, 0.2]])
    if code:
        weights["initial"][:] = 0
    arrays = {name: array.astype(np.float32) for name, array in weights.items()}
    return NtppPaper(AREAS, arrays, ETH.dt_s, GRID_S, {"published_code": code})


def bursty(horizon_s: float = 600.0) -> Arrivals:
    events = renewal().sample(horizon_s, ETH, np.random.default_rng(0))
    return arrivals_in(events, horizon_s, GRID_S, 2)


def test_the_density_of_a_gap_integrates_to_its_hazard() -> None:
    weights = network().of_area(0)
    past = np.array([3.0, 0.5, 20.0])

    def after(gap: float) -> float:
        return float(np.exp(density(np.append(past, [gap, 1.0]), weights, False)[0][3]))

    until = density(np.append(past, 12.0), weights, False)[1][3]
    assert quad(after, 0, 12.0)[0] == pytest.approx(1 - np.exp(-until), rel=1e-5)


def test_the_literal_sampler_follows_its_density_and_that_of_the_code_does_not() -> None:
    rng = np.random.default_rng(3)
    literal, code = network(), network(code=True)
    residuals = residuals_of(literal, 20_000.0, rng)
    assert len(residuals) > 2000
    assert kstest(residuals, "uniform").pvalue > 0.01
    # The clamp matters as soon as a component of the state is negative, which is always.
    assert kstest(residuals_of(code, 20_000.0, rng), "uniform").pvalue < 1e-6


def test_without_the_clamp_the_codes_sampler_follows_its_density() -> None:
    weights = network(code=True).of_area(0)
    times = draw(20_000.0, 10**6, weights, True, False, np.random.default_rng(0))
    hazard = density(np.diff(times, prepend=0.0), weights, True)[1]
    assert kstest(-np.expm1(-hazard[:-1]), "uniform").pvalue > 0.01


def test_a_likelihood_bounds_that_of_counts_from_below() -> None:
    # A constant rate b per frame, k = 1: Poisson counts, whose probability is known.
    model = network()
    zeros = {name: np.zeros_like(array) for name, array in model.weights.items()}
    rate = 0.3
    inverse = np.log(np.expm1([rate, 1.0]))  # of softplus
    zeros["out_bias"][:] = inverse
    constant = replace(model, weights=zeros)
    arrivals = bursty()
    expected = PoissonGMM(AREAS, np.full(2, rate / ETH.dt_s)).log_likelihood(arrivals)
    assert constant.log_likelihood(arrivals) == pytest.approx(expected, rel=1e-5)
    varying = model.log_likelihood(arrivals)
    assert np.isfinite(varying)


def test_every_person_is_an_event_unless_the_code_counts_frames() -> None:
    arrivals = arrivals_at([2, 2, 2, 7], [0, 0, 0, 0], [(0, 20)])
    rng = np.random.default_rng(0)
    (gaps,) = sequences(arrivals, 0, ETH, DEFAULT, rng)
    assert len(gaps) == 5
    assert (gaps > 0).all()
    assert gaps.sum() == pytest.approx(20)
    of_code = sequences(arrivals, 0, ETH, PaperSettings(published_code=True), rng)
    # A window begins at its first event, with a gap of 0, and lasts for 1,000 frames from there.
    assert [gaps.tolist() for gaps in of_code] == [[0, 5, 995]]


def test_windows_overlap_and_end_with_their_stretch() -> None:
    arrivals = arrivals_at([5, 60, 119], [0, 0, 0], [(0, 120)])
    settings = PaperSettings(window_frames=100, stride_frames=50)
    found = sequences(arrivals, 0, ETH, settings, np.random.default_rng(0))
    assert [len(gaps) for gaps in found] == [3, 3]
    np.testing.assert_allclose([gaps.sum() for gaps in found], 100)


@pytest.mark.long
def test_training_lowers_the_loss_and_is_reproducible() -> None:
    arrivals = bursty()
    net = training._Network(linear=False)
    found = sequences(arrivals, 0, ETH, BRIEF, np.random.default_rng(0))
    losses = training.train(net, found, BRIEF)
    assert len(losses) == BRIEF.epochs
    assert losses[-1] < losses[0]
    first, again, other = (
        training.fit(arrivals, AREAS, ETH, seed=s, settings=BRIEF) for s in (0, 0, 1)
    )
    for name in SHAPES:
        np.testing.assert_array_equal(first.weights[name], again.weights[name])
    assert (first.weights["out_weight"] != other.weights["out_weight"]).any()
    assert (first.weights["initial"] != other.weights["initial"]).any()


def test_the_settings_are_those_of_the_paper_and_of_its_code() -> None:
    assert (DEFAULT.learning_rate, DEFAULT.epochs) == (1e-4, 500)
    assert PaperSettings(published_code=True).learning_rate == 5e-3
    assert PaperSettings(published_code=True, learning_rate=0.1).learning_rate == 0.1


def test_nobody_enters_areas_without_arrivals() -> None:
    arrivals = arrivals_at([1, 9, 14], [0, 0, 0], [(0, 30)])
    model = training.fit(arrivals, AREAS, ETH, seed=0, settings=BRIEF)
    events = model.sample(3600.0, ETH, np.random.default_rng(0))
    assert len(events) > 0
    assert (events.spawn_area == 0).all()


def test_a_fit_is_what_its_file_gives_back(tmp_path: Path) -> None:
    arrivals = bursty()
    fitted = training.fit(arrivals, AREAS, ETH, seed=0, settings=BRIEF)
    NtppPaper.write(tmp_path, {split: [fitted] for split in SPLITS})
    back = NtppPaper.read(replace(ETH, folder=tmp_path), AREAS)
    for name in SHAPES:
        np.testing.assert_array_equal(back.weights[name], fitted.weights[name])
    assert back.log_likelihood(arrivals) == fitted.log_likelihood(arrivals)


def test_samples_that_explode_are_refused() -> None:
    model = network()
    loud = {**model.weights, "out_bias": np.full((2, 2), [80.0, 0.5], np.float32)}
    with pytest.raises(SettingError, match="more than 50 events per frame"):
        replace(model, weights=loud).sample(60.0, ETH, np.random.default_rng(0))


def test_samples_of_the_code_enter_at_frames() -> None:
    events = network(code=True).sample(600.0, ETH, np.random.default_rng(0))
    frames = events.time_s / ETH.dt_s
    np.testing.assert_allclose(frames, frames.round(), atol=1e-6)


def test_fits_come_back_from_their_file(tmp_path: Path) -> None:
    place = replace(ETH, folder=tmp_path)
    fits = {split: [network(k), network(k + 10)] for k, split in enumerate(SPLITS)}
    NtppPaper.write(tmp_path, fits)
    found = NtppPaper.read(place, AREAS, "fold1", fit=3)
    for name in SHAPES:
        np.testing.assert_array_equal(found.weights[name], fits["fold1"][1].weights[name])
    assert learned(found) == 2 * sum(
        np.prod(shape) for name, shape in SHAPES.items() if name != "initial"
    )
    assert learned(network(code=True)) == learned(found) - 2 * (HIDDEN * HIDDEN + HIDDEN)
    one_empty = {name: array.copy() for name, array in found.weights.items()}
    one_empty["out_weight"][1] = 0.0  # as training leaves an area in which nobody enters
    assert learned(replace(found, weights=one_empty)) == learned(found) // 2
    too_large = {**found.weights, "state_weight": 1e6 * found.weights["state_weight"]}
    with pytest.raises(WeightsError, match=r"^ntpp-paper of eth-v0, state_weight of area 0: "):
        replace(found, weights=too_large)
    with pytest.raises(WeightsError, match="ntpp-paper of zara1-v0"):
        NtppPaper.read(replace(place, id="zara1-v0"), AREAS)


def test_the_codes_poisson_rate_counts_frames_between_the_first_and_the_last() -> None:
    arrivals = arrivals_at([2, 2, 2, 7, 9], [0, 0, 0, 0, 1], [(0, 50)])
    model = PoissonPaper.fit_frames(arrivals, AREAS, ETH)
    np.testing.assert_allclose(model.rate, [2 / (5 * 0.4), 1 / 20.0])


def test_the_codes_poisson_rates_come_back_from_their_own_file(tmp_path: Path) -> None:
    model = PoissonPaper(AREAS, np.array([0.5, 0.25]))
    PoissonPaper.write(tmp_path, {split: [model] for split in SPLITS})
    assert [path.name for path in tmp_path.iterdir()] == ["poisson-paper.json"]
    found = PoissonPaper.read(replace(ETH, folder=tmp_path), AREAS)
    assert found.name == "poisson-paper"
    np.testing.assert_array_equal(found.rate, model.rate)
