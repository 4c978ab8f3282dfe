"""Waves and Cox arrivals: factors, likelihood and fit agree with each other."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS, GRID_S
from numba import njit
from scipy.special import comb, logsumexp
from scipy.stats import poisson

from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, CoxGMM, arrivals_in
from crowdbench.spawn.times.cox_kernels import filtered, log_probability
from crowdbench.spawn.times.waves import Waves, fit_waves, in_steps, mean_correlations, pairs_of

ETH = load_scene("eth-v0")
B = np.array([[[0.5, 0.3], [0.3, 0.4]], [[0.2, 0.1], [0.1, 0.3]]])
WAVES = Waves(np.array([12.0, 60.0]), B)


FOLLOWERS = np.array([0.1, 0.05, 0.0, 0.05, 0.0])
CALM = Waves(np.zeros(0), np.zeros((0, 2, 2)))


def cox(waves: Waves = WAVES, followers: np.ndarray = FOLLOWERS) -> CoxGMM:
    return CoxGMM(AREAS, np.array([0.3, 0.2]), np.array([0.2, 0.05]), followers, waves, GRID_S)


def sampled(horizon_s: float, seed: int = 0, model: CoxGMM | None = None) -> Arrivals:
    events = (model or cox()).sample(horizon_s, ETH, np.random.default_rng(seed))
    return arrivals_in(events, horizon_s, GRID_S, 2)


def test_factors_have_mean_one_and_the_covariances_of_the_model() -> None:
    steps, step_s = 400_000, 0.8
    factors = WAVES.factors(steps, step_s, np.random.default_rng(0))
    np.testing.assert_allclose(factors.mean(axis=0), 1.0, atol=0.05)
    logs = np.log(factors)
    np.testing.assert_allclose(np.cov(logs.T), B.sum(axis=0), atol=0.06)
    lag = round(12.0 / step_s)
    expected = sum(
        b * (1 + lag * step_s / t) * np.exp(-lag * step_s / t)
        for b, t in zip(B, WAVES.tau_s.tolist(), strict=True)
    )
    off = logs - logs.mean(axis=0)
    np.testing.assert_allclose(off[:-lag].T @ off[lag:] / (steps - lag), expected, atol=0.06)


def test_roots_of_covariances_without_full_rank() -> None:
    waves = Waves(np.array([5.0]), np.array([[[1.0, 2.0], [2.0, 4.0]]]))
    root = waves.roots()[0]
    np.testing.assert_allclose(root @ root.T, waves.covariance[0], atol=1e-12)


@given(st.floats(1e-4, 5.0), st.floats(1e-6, 0.9), st.integers(0, 12))
def test_the_number_of_persons_is_a_poisson_number_of_geometric_groups(
    rate: float, more: float, number: int
) -> None:
    expected = sum(
        poisson.pmf(k, rate) * comb(number - 1, k - 1) * (1 - more) ** k * more ** (number - k)
        for k in range(1, number + 1)
    )
    expected = np.exp(-rate) if number == 0 else expected
    assert np.exp(log_probability(number, rate, more)) == pytest.approx(expected, rel=1e-8)


@pytest.mark.long
def test_without_waves_the_filter_is_exact() -> None:
    counts = np.random.default_rng(0).poisson(0.1, (200, 2))
    rate, more = np.array([0.1, 0.15]), np.array([0.2, 0.1])
    none, after = np.zeros((0, 2, 2)), np.random.default_rng(1).random((200, 2))
    rng = np.random.default_rng(0)
    found = filtered(counts, after, 2, rate, more, none, np.zeros((0, 4)), np.zeros(2), 5, rng)
    expected = sum(
        log_probability(int(counts[t, a]), rate[a] + after[t, a], more[a])
        for t in range(200)
        for a in (0, 1)
    )
    assert found == pytest.approx(expected)


@njit
def log_likelihoods(
    counts: np.ndarray, rate: np.ndarray, more: np.ndarray, factors: np.ndarray
) -> np.ndarray:
    """Of counts by step and area, under each of many waves."""
    found = np.zeros(len(factors))
    for i in range(len(factors)):
        for t in range(len(counts)):
            for a in range(len(rate)):
                found[i] += log_probability(counts[t, a], rate[a] * factors[i, t, a], more[a])
    return found


def test_the_filter_agrees_with_the_mean_over_many_waves() -> None:
    counts = np.random.default_rng(1).poisson(0.4, (12, 2))
    rate, more = np.array([0.35, 0.3]), np.array([0.1, 0.2])
    draws, step_s = 40_000, 6.0
    waves = replace(WAVES, tau_s=np.array([5.0, 20.0]))
    factors = waves.factors(12 * draws, step_s, np.random.default_rng(2))
    each = log_likelihoods(counts, rate, more, factors.reshape(draws, 12, 2))
    found = [
        filtered(
            counts, np.zeros((12, 2)), 1, rate, more, waves.roots(), waves.recursion(step_s),
            0.5 * waves.variance(), 2_000, np.random.default_rng(seed),
        )
        for seed in range(5)
    ]  # fmt: skip
    assert np.mean(found) == pytest.approx(logsumexp(each) - np.log(draws), abs=0.1)


def test_samples_have_the_rates_and_more_variance_than_poisson() -> None:
    horizon_s = 40_000.0
    found = sampled(horizon_s)
    rate = np.bincount(found.area) / horizon_s
    np.testing.assert_allclose(rate, [0.3, 0.2], rtol=0.15)
    (minutes,) = in_steps(found, round(60.0 / GRID_S))
    assert (minutes.var(axis=0) / minutes.mean(axis=0) > 3).all()
    assert np.corrcoef(minutes.T)[0, 1] > 0.3


def test_what_was_sampled_is_found_again() -> None:
    found = CoxGMM.fit(sampled(40_000.0, seed=1), AREAS)
    np.testing.assert_allclose(found.waves.variance(), B.sum(axis=0).diagonal(), atol=0.2)
    of_pair = found.waves.covariance[:, 0, 1].sum()
    assert of_pair == pytest.approx(0.4, abs=0.15)
    np.testing.assert_allclose(found.rate_per_s, [0.3, 0.2], rtol=0.15)
    np.testing.assert_allclose(found.next_member, [0.2, 0.05], atol=0.1)
    np.testing.assert_allclose(found.followers, FOLLOWERS, atol=0.05)
    assert (np.linalg.eigvalsh(found.waves.covariance) > -1e-9).all()


def test_poisson_arrivals_have_hardly_any_waves() -> None:
    found = CoxGMM.fit(sampled(20_000.0, model=cox(CALM, np.zeros(5))), AREAS)
    assert (found.waves.variance() < 0.1).all()
    assert found.followers.sum() < 0.02


def test_the_truth_is_likelier_than_a_process_without_waves() -> None:
    arrivals = sampled(4_000.0, seed=2)
    assert cox().log_likelihood(arrivals) > cox(CALM).log_likelihood(arrivals) + 0.05
    nobody_follows = cox(followers=np.zeros(5))
    assert cox().log_likelihood(arrivals) > nobody_follows.log_likelihood(arrivals) + 0.01


@pytest.mark.long
def test_followers_come_as_often_as_the_model_says() -> None:
    """Without waves the likelihood is exact: the mean of its slope over samples is 0."""
    truth, step = cox(CALM), 0.01
    slopes = []
    for seed in range(20):
        arrivals = sampled(2_000.0, seed=seed, model=truth)
        each = [
            cox(CALM, FOLLOWERS + sign * step * np.eye(5)[0]).log_likelihood(arrivals)
            for sign in (1, -1)
        ]
        slopes.append((each[0] - each[1]) / (2 * step) * len(arrivals.tick))
    assert abs(np.mean(slopes)) < 3 * np.std(slopes) / np.sqrt(len(slopes))


def test_pair_correlations_are_those_of_a_direct_count() -> None:
    arrivals = replace(sampled(600.0), windows=np.array([[0, 700], [800, 1500]]))
    kept = (arrivals.tick < 700) | (arrivals.tick >= 800)
    arrivals = replace(arrivals, tick=arrivals.tick[kept], area=arrivals.area[kept])
    found = pairs_of(arrivals, longest_s=3.0)
    counts = in_steps(arrivals, 2)
    everyone = np.concatenate(counts)
    mean, persons = everyone.mean(axis=0), everyone.sum(axis=0)
    products = sum(n[:-1].T @ n[1:] for n in counts)
    pairs = sum(len(n) - 1 for n in counts)
    ratio = products / (pairs * np.outer(mean, mean))
    same = np.eye(2, dtype=bool)
    expected = pairs * np.outer(mean, mean)
    pooled = np.where(
        same,
        products[same].sum() / expected[same].sum(),
        products[~same].sum() / expected[~same].sum(),
    )
    weight = np.sqrt(np.outer(persons, persons))
    np.testing.assert_allclose(
        found.correlation[0], (weight * ratio + 100 * pooled) / (weight + 100), rtol=1e-6
    )
    assert found.lag_s[0] == pytest.approx(0.8)


def test_mean_correlations_are_those_of_all_pairs_of_observed_times() -> None:
    arrivals = replace(sampled(600.0), windows=np.array([[100, 700], [800, 1500]]))
    seen_s = np.concatenate([np.arange(100, 700, 2), np.arange(800, 1500, 2)]) * GRID_S
    apart = np.abs(seen_s[:, None] - seen_s).ravel()
    expected = WAVES.correlations(apart).mean(axis=0)
    np.testing.assert_allclose(mean_correlations(WAVES, arrivals), expected, rtol=1e-6)


def test_waves_are_found_again_from_many_short_recordings() -> None:
    """Their own means contain a part of the waves, which would be missing without a correction."""
    one = Waves(np.array([30.0]), np.full((1, 2, 2), 0.4))
    model = replace(cox(one, np.zeros_like(FOLLOWERS)), rate_per_s=np.array([3.0, 2.0]))
    found, apparent = [], []
    for seed in range(40):
        arrivals = sampled(320.0, seed, model)
        waves = fit_waves(arrivals)
        total = np.einsum("jab,a,b->j", waves.covariance, [0.6, 0.4], [0.6, 0.4])
        found.append(waves.correlations(np.array([10.0])) @ total)
        shortened = waves.correlations(np.array([10.0])) - mean_correlations(waves, arrivals)
        apparent.append(shortened @ total)
    truth = 0.4 * one.correlations(np.array([10.0])).item()
    error = np.std(found) / np.sqrt(len(found))
    assert abs(np.mean(found) - truth) < 2 * error
    assert np.mean(apparent) < truth - 2 * error


def test_too_short_a_recording_has_no_waves() -> None:
    found = fit_waves(sampled(20.0))
    assert found.covariance.shape == (0, 2, 2)
    none = replace(sampled(600.0), tick=np.empty(0, np.int64), area=np.empty(0, np.int64))
    assert CoxGMM.fit(none, AREAS).sample(100.0, ETH, np.random.default_rng(0)).time_s.size == 0
