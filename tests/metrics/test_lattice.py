import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import wasserstein_distance

from crowdbench.metrics.lattice import (
    cdf,
    cdfs,
    correlation,
    counted,
    histograms,
    kaplan_meier_cdf,
    lagged_sums,
    mean_of_cdf,
    moments,
    rounded,
    share,
    widths,
)

SIZE = 12
COUNTS = arrays(np.int64, SIZE, elements=st.integers(0, 9))
SUPPORT = np.array([0, 1, 2, 3, 5, 6, 10, 20, 21, 40, 99, 100])  # ascending, with holes
SERIES = arrays(np.int64, st.integers(2, 30), elements=st.integers(0, 300))


def sample_of(counts: np.ndarray) -> np.ndarray:
    return np.repeat(SUPPORT, counts)


def kaplan_meier(ended: np.ndarray, censored: np.ndarray) -> np.ndarray:
    return kaplan_meier_cdf(ended, censored, np.arange(ended.shape[-1]), if_empty=0)


def test_histograms_count_per_block():
    counts = histograms(np.array([0, 2, 2, 1]), np.array([0, 0, 2, 2]), 3)
    assert counts.tolist() == [[1, 0, 1], [0, 0, 0], [0, 1, 1]]


def test_histograms_of_nothing_have_one_column():
    assert histograms(np.empty(0, np.int64), np.empty(0, np.int64), 2).tolist() == [[0], [0]]


def test_values_are_rounded_to_the_nearest_lattice_point_and_halves_up():
    assert rounded(np.array([0.0, 0.49, 0.5, 1.49, 2.5]), 1.0).tolist() == [0, 0, 1, 1, 3]


def test_functions_of_several_histograms_stand_next_to_each_other_in_every_batch():
    rng = np.random.default_rng(0)
    counts = [rng.integers(0, 9, (3, 2, SIZE)).astype(float) for _ in range(2)]
    counts[1][2, 1] = 0  # an empty sample
    found = cdfs(counts, SUPPORT, if_empty=10)
    for k, c in enumerate(counts):
        part = found[..., k * SIZE : (k + 1) * SIZE]
        expected = c.cumsum(axis=-1) / np.maximum(c.sum(axis=-1, keepdims=True), 1)
        expected[c.sum(axis=-1) == 0] = SUPPORT >= 10
        assert part.tolist() == expected.tolist() == cdf(c, SUPPORT, if_empty=10).tolist()


@given(COUNTS.filter(np.any), COUNTS.filter(np.any))
def test_the_area_between_two_distribution_functions_is_scipys_wasserstein_distance(p, q):
    difference = np.abs(cdf(p, SUPPORT, if_empty=0) - cdf(q, SUPPORT, if_empty=0))
    expected = wasserstein_distance(sample_of(p), sample_of(q))
    assert difference @ widths(SUPPORT) == pytest.approx(expected, abs=1e-12)


@given(COUNTS.filter(np.any))
def test_the_mean_by_the_distribution_function_is_that_of_the_sample(counts):
    mean = mean_of_cdf(cdf(counts, SUPPORT, if_empty=0), SUPPORT)
    assert mean == pytest.approx(sample_of(counts).mean(), abs=1e-12)


@given(COUNTS.filter(np.any))
def test_moments_are_numpys_mean_and_variance(counts):
    mean, variance = moments(counts, SUPPORT)
    assert mean == pytest.approx(sample_of(counts).mean())
    assert variance == pytest.approx(sample_of(counts).var(), abs=1e-9)


def test_a_sample_of_one_value_has_exactly_no_variance():
    assert moments(np.array([0, 0, 7]), np.array([0, 1, 321]))[1] == 0


def test_an_empty_sample_is_a_point_mass():
    assert cdf(np.zeros(SIZE, np.int64), SUPPORT, if_empty=10).tolist() == [0] * 6 + [1] * 6


@given(st.lists(COUNTS, min_size=1, max_size=4))
def test_leading_axes_are_batches(rows):
    ended, censored = np.array(rows), np.array(rows[::-1])
    for batched, each in (
        (cdf(ended, SUPPORT, if_empty=5), lambda k: cdf(ended[k], SUPPORT, if_empty=5)),
        (kaplan_meier(ended, censored), lambda k: kaplan_meier(ended[k], censored[k])),
        (moments(ended, SUPPORT)[1], lambda k: moments(ended[k], SUPPORT)[1]),
        (correlation(ended[:, :6]), lambda k: correlation(ended[k, :6])),
    ):
        # In which order matrix products add depends on the shape.
        one_by_one = np.array([each(k) for k in range(len(rows))])
        np.testing.assert_allclose(batched, one_by_one, rtol=1e-12, atol=0)


def test_kaplan_meier_gives_the_textbooks_survival_curve():
    # Weeks of remission under 6-MP (Freireich et al. 1963; table 1.1 of Cox & Oakes 1984).
    ended = [6, 6, 6, 7, 10, 13, 16, 22, 23]
    censored = [6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    survival = 1 - kaplan_meier(
        np.bincount(ended, minlength=36), np.bincount(censored, minlength=36)
    )
    textbook = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    assert {week: round(float(survival[week]), 3) for week in textbook} == textbook


def test_mass_that_no_event_claims_stands_at_the_longest_life():
    values = kaplan_meier_cdf(
        np.array([0, 1, 0, 0]), np.array([0, 0, 1, 0]), np.array([0, 4, 9, 50]), if_empty=50
    )
    assert values.tolist() == [0, 0.5, 1, 1]


def test_kaplan_meier_of_nobody_is_a_point_mass():
    none = np.zeros(3, np.int64)
    values = kaplan_meier_cdf(none, none, np.array([0, 4, 9]), if_empty=4)
    assert values.tolist() == [0, 1, 1]


@given(COUNTS.filter(np.any))
def test_kaplan_meier_without_censoring_is_the_empirical_distribution(ended):
    values = kaplan_meier(ended, np.zeros_like(ended))
    np.testing.assert_allclose(values, ended.cumsum() / ended.sum(), atol=1e-12)


@given(COUNTS, COUNTS.filter(np.any))
def test_censoring_makes_lives_longer_than_they_were_seen(ended, censored):
    values = kaplan_meier(ended, censored)
    assert (np.diff(values, prepend=0.0) >= -1e-12).all()
    assert values[-1] == 1
    seen = (ended + censored).cumsum() / (ended + censored).sum()
    assert (values <= seen + 1e-12).all()


@given(SERIES, st.data())
def test_correlation_is_numpys(x, data):
    y = data.draw(arrays(np.int64, len(x), elements=st.integers(0, 300)))
    sums = lagged_sums(x, y, np.zeros(len(x), np.int64), 1)[0]
    expected = np.corrcoef(x, y)[0, 1] if np.ptp(x) and np.ptp(y) else 0.0
    assert correlation(sums) == pytest.approx(expected, abs=1e-9)


def test_lagged_sums_are_kept_per_block():
    sums = lagged_sums(np.array([2, 3, 4]), np.array([5, 6, 7]), np.array([1, 1, 0]), 3)
    assert sums.tolist() == [[1, 4, 7, 28, 16, 49], [2, 5, 11, 28, 13, 61], [0] * 6]


def test_hits_are_counted_per_block():
    hits = np.array([True, False, True, True])
    assert counted(hits, np.array([0, 0, 0, 2]), 3).tolist() == [[2, 3], [0, 0], [1, 1]]


def test_a_share_of_none_is_zero():
    assert share(np.array([[0, 0], [1, 4]])).tolist() == [0, 0.25]
