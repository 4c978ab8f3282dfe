"""The renewal model: its likelihood by hand, its stationary start, its fit."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS, GRID_S, arrivals_at, renewal

from crowdbench.scene import load_scene
from crowdbench.spawn import RenewalGMM, arrivals_in
from crowdbench.spawn.times.renewal import _log_tail

ETH = load_scene("eth-v0")


def survival(g: int, shape: float, scale: float) -> float:
    return math.exp(-((g / scale) ** shape))


def mean_rate(model: RenewalGMM) -> np.ndarray:
    """Expected persons per second for each area."""
    gap = np.exp(_log_tail(np.zeros(1), model.shape, model.scale_s / GRID_S))
    return 1 / (gap * GRID_S * (1 - model.next_member))


def test_the_likelihood_is_that_of_gaps_waits_and_sizes_by_hand() -> None:
    model = renewal()
    shape, scale, more = 0.6, 1.1 / GRID_S, 0.3
    s = [survival(g, shape, scale) for g in range(200_000)]
    mean = math.fsum(s)
    # A pair at point 2 and one at point 5 of area 0, in a stretch of 9 points; none in area 1.
    arrivals = arrivals_at([2, 2, 5], [0, 0, 0], [(0, 9)])
    wait = s[2] / mean
    gap = s[2] - s[3]
    sizes = (1 - more) * more * (1 - more)
    other = [survival(g, 1.7, 4.0 / GRID_S) for g in range(1000)]
    nobody = 1 - math.fsum(other[:9]) / math.fsum(other)
    by_hand = math.log(wait * gap * s[3] * sizes * nobody)
    assert 3 * model.log_likelihood(arrivals) == pytest.approx(by_hand, rel=1e-9)


@given(shape=st.floats(0.3, 3.0), scale=st.floats(0.05, 300.0), steps=st.integers(0, 2000))
def test_tails_are_sums_of_the_survival_function(shape: float, scale: float, steps: int) -> None:
    # Below a survival of e^−60 nothing adds up; for slow tails that takes the longest here.
    last = int(scale * 60 ** (1 / shape)) + 1
    if last > 300_000 or (steps / scale) ** shape > 60:
        return
    j = np.arange(steps, steps + last + 1)
    exact = np.logaddexp.reduce(-((j / scale) ** shape))
    assert float(_log_tail(np.array([steps]), shape, scale)[0]) == pytest.approx(exact, abs=1e-6)


def test_tails_far_out_do_not_underflow() -> None:
    far = _log_tail(np.array([5_000, 5_001, 5_002]), 1.0, 2.0)
    # Geometric: each step costs 1 / scale.
    np.testing.assert_allclose(np.diff(far), -0.5, rtol=1e-6)


def test_shape_one_is_memoryless() -> None:
    model = replace(renewal(), shape=np.ones(2))
    one = model.log_likelihood(arrivals_at([2], [0], [(0, 9)]))
    other = model.log_likelihood(arrivals_at([6], [0], [(0, 9)]))
    assert one == pytest.approx(other)


def test_every_grid_point_lets_in_the_same_number_from_the_first_on() -> None:
    model, points, samples = renewal(), 40, 1500
    count = np.zeros((2, points))
    rng = np.random.default_rng(1)
    for _ in range(samples):
        events = model.sample(points * GRID_S, ETH, rng)
        tick = np.round(events.time_s / GRID_S).astype(int)
        np.add.at(count, (events.spawn_area, tick), 1)
    expected = mean_rate(model) * GRID_S * samples
    # Sizes are geometric: a count's variance is more than its mean, by (1 + q) / (1 − q) at most.
    error = np.sqrt(expected * 1.3 / 0.7)
    assert (np.abs(count - expected[:, None]) < 4.5 * error[:, None]).all()


def test_events_lie_on_the_grid_inside_the_horizon() -> None:
    time_s = renewal().sample(100.1, ETH, np.random.default_rng(2)).time_s
    assert np.allclose(time_s / GRID_S, np.round(time_s / GRID_S))
    assert time_s.min() >= 0
    assert time_s.max() < 100.1


def test_the_same_seed_gives_the_same_people() -> None:
    one, two = (renewal().sample(100.0, ETH, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.time_s, two.time_s)
    assert np.array_equal(one.goal, two.goal)


def test_the_fit_recovers_the_model() -> None:
    truth, horizon_s = renewal(), 40_000.0
    events = truth.sample(horizon_s, ETH, np.random.default_rng(4))
    fitted = RenewalGMM.fit(arrivals_in(events, horizon_s, GRID_S, 2), AREAS)
    np.testing.assert_allclose(fitted.shape, truth.shape, rtol=0.05)
    np.testing.assert_allclose(fitted.scale_s, truth.scale_s, rtol=0.1)
    np.testing.assert_allclose(fitted.next_member, truth.next_member, atol=0.02)


def test_a_fit_expects_exactly_the_recorded_persons() -> None:
    arrivals = arrivals_at([1, 1, 4, 5, 5, 5, 30, 33], [0, 0, 0, 0, 0, 0, 1, 0], [(0, 40)])
    expected = mean_rate(RenewalGMM.fit(arrivals, AREAS)) * arrivals.exposure_s()
    np.testing.assert_allclose(expected, [7, 1], rtol=1e-9)


def test_no_other_shape_with_these_persons_is_more_likely() -> None:
    truth = renewal()
    events = truth.sample(4000.0, ETH, np.random.default_rng(5))
    arrivals = arrivals_in(events, 4000.0, GRID_S, 2)
    fitted = RenewalGMM.fit(arrivals, AREAS)
    mean = 1 / mean_rate(fitted)
    for factor in (0.9, 1.1):
        other = replace(fitted, shape=fitted.shape * factor)
        # The scale that keeps the number of persons: a few steps of a fixed-point iteration.
        for _ in range(60):
            other = replace(other, scale_s=other.scale_s * mean * mean_rate(other))
        np.testing.assert_allclose(mean_rate(other), mean_rate(fitted), rtol=1e-6)
        assert other.log_likelihood(arrivals) < fitted.log_likelihood(arrivals)


def test_an_area_of_a_single_group_is_all_but_poisson() -> None:
    shape = RenewalGMM.fit(arrivals_at([3, 30], [0, 1], [(0, 60)]), AREAS).shape
    assert (np.abs(np.log(shape)) < 0.5).all()


def test_where_nobody_entered_nobody_ever_enters() -> None:
    model = RenewalGMM.fit(arrivals_at([1, 4, 9], [0, 0, 0], [(0, 20)]), AREAS)
    events = model.sample(20_000.0, ETH, np.random.default_rng(6))
    assert set(events.spawn_area) == {0}
    nowhere = arrivals_at([1], [1], [(0, 20)])
    assert -np.inf < model.log_likelihood(nowhere) < -20
