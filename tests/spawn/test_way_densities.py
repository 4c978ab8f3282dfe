"""Densities of ways, and samples that agree with them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binomtest, chi2, kstest, multivariate_normal, norm

from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plan_fitting import fit_plans, marks_of, trips_alone
from crowdbench.spawn.way_fitting import fit_ways
from crowdbench.spawn.ways import Trips, Ways, log_gaussian

PLAZA = load_scene("plaza-v0")
NUMBER = 4_000


@pytest.fixture(scope="module")
def ways() -> Ways:
    crowd = recording_of(PLAZA)
    return fit_plans(crowd, blocks_of(crowd, PLAZA), read_areas(PLAZA)).ways


@pytest.fixture(scope="module")
def drawn(ways: Ways) -> Trips:
    """Ways from the west to the east: hardly any of them has to be drawn again."""
    a, g = np.zeros(NUMBER, np.int64), np.zeros(NUMBER, np.int64)
    a[:], g[:] = widest(ways)
    found = ways.draw(a, g, PLAZA, np.random.default_rng(0))
    stop = np.column_stack([found[:, 5:7], found[:, 7]])
    stop[np.isnan(found[:, 7])] = np.nan
    return Trips(np.ones(NUMBER), a, g, found[:, :5], np.zeros((NUMBER, 2)), stop)


def widest(ways: Ways) -> tuple[int, int]:
    """The pair of areas with the longest trips."""
    length = np.linalg.norm(ways.trip_mean[..., 2:4] - ways.trip_mean[..., :2], axis=-1)
    a, g = np.unravel_index(length.argmax(), length.shape)
    return int(a), int(g)


def test_a_density_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    mean, x = rng.normal(size=(7, 3)), rng.normal(size=(7, 3))
    root = rng.normal(size=(7, 3, 3))
    covariance = root @ root.swapaxes(1, 2) + np.eye(3)
    expected = [
        multivariate_normal(m, c).logpdf(v) for m, c, v in zip(mean, covariance, x, strict=True)
    ]
    np.testing.assert_allclose(log_gaussian(x, mean, covariance), expected)
    one = multivariate_normal(mean[0], covariance[0]).logpdf(x)
    np.testing.assert_allclose(log_gaussian(x, mean[0], covariance[0]), one)


def test_trips_have_the_density_of_the_model(ways: Ways, drawn: Trips) -> None:
    """The log density of a Gaussian is a constant minus half of a chi-squared number."""
    at = widest(ways)
    root = np.linalg.cholesky(ways.trip_covariance[at])
    highest = -np.log(np.diagonal(root)).sum() - 2.5 * np.log(2 * np.pi)
    squared = 2 * (highest - ways.log_trips(drawn))
    assert kstest(squared, chi2(5).cdf).statistic < 0.03


def test_people_stop_with_the_probability_of_the_model(ways: Ways, drawn: Trips) -> None:
    p = float(ways.stopping[widest(ways)])
    assert 0.02 < p < 0.5
    assert binomtest(int(drawn.stops.sum()), NUMBER, p).pvalue > 1e-3
    told = ways.log_stopping(drawn)
    np.testing.assert_allclose(np.exp(told[drawn.stops]), p)
    np.testing.assert_allclose(np.exp(told[~drawn.stops]), 1 - p)


def test_waits_have_the_density_of_the_model(ways: Ways, drawn: Trips) -> None:
    a, g = widest(ways)
    share = ways.from_area[:, a] * ways.to_area[:, g]
    spread = np.sqrt(ways.stop_covariance[:, 2, 2])
    log_wait = drawn.stop[drawn.stops, 2]
    cdf = norm.cdf((log_wait[:, None] - ways.stop_mean[:, 2]) / spread) @ share / share.sum()
    assert kstest(cdf, "uniform").pvalue > 1e-3


def test_the_density_of_stops_is_that_of_the_mixture(ways: Ways, drawn: Trips) -> None:
    a, g = widest(ways)
    share = ways.from_area[:, a] * ways.to_area[:, g]
    x = drawn.stop[drawn.stops]
    parts = zip(share / share.sum(), ways.stop_mean, ways.stop_covariance, strict=True)
    expected = sum(w * multivariate_normal(m, c).pdf(x) for w, m, c in parts)
    np.testing.assert_allclose(np.exp(ways.log_stops(drawn)), expected)


def test_those_who_join_somebody_have_no_trip_of_their_own() -> None:
    crowd = recording_of(PLAZA)
    marks = marks_of(crowd, blocks_of(crowd, PLAZA))
    joined = marks.earlier >= 0
    assert (marks.group[joined] == marks.group[marks.earlier[joined]]).all()
    assert (marks.time_s[joined] >= marks.time_s[marks.earlier[joined]]).all()
    assert marks.first(crowd).sum() == (~joined).sum()
    alone = trips_alone(crowd, marks, np.log(0.9))
    as_seen = trips_alone(crowd, marks, 0.0)
    assert len(alone.weight) <= (~joined).sum()
    faster = alone.trip[:, 4] - as_seen.trip[:, 4]
    assert set(np.unique(faster.round(9))) == {0.0, round(-np.log(0.9), 9)}


def test_few_people_stop_half_way_for_a_time_that_is_mixed_with_usual_ones() -> None:
    areas = read_areas(PLAZA)
    rng = np.random.default_rng(0)
    number, few = 300, 4
    trip = rng.normal(size=(number, 5)) * 0.1 + [-10, 0, 10, 2, 0]
    stop = np.full((number, 3), np.nan)
    stop[:few] = [3.0, 9.0, np.log(40.0)]  # far off the way of the others
    zeros = np.zeros(number, np.int64)
    trips = Trips(np.ones(number), zeros, zeros, trip, np.zeros((number, 2)), stop)
    ways = fit_ways(trips, areas)
    assert ways.stop_mean.shape == (1, 3)
    np.testing.assert_allclose(ways.stop_mean[0, :2], [0, 1], atol=0.05)
    expected = 0.4 * np.log(40) + 0.6 * np.log(10)
    assert ways.stop_mean[0, 2] == pytest.approx(expected)
    expected = 0.6 * 1 + 0.4 * 0.6 * np.log(4) ** 2
    assert ways.stop_covariance[0, 2, 2] == pytest.approx(expected)
    assert ways.stopping[0, 0] == pytest.approx(few / number)
    nobody = fit_ways(replace(trips, stop=np.full((number, 3), np.nan)), areas)
    assert len(nobody.stop_mean) == 0
    assert not nobody.stopping.any()
