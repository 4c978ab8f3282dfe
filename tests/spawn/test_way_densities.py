"""Densities of ways, and samples that agree with them."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import binomtest, ks_2samp, kstest, multivariate_normal, norm

from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plans.fitting import fit_plans, marks_of, trips_alone
from crowdbench.spawn.plans.mixtures import log_gaussians
from crowdbench.spawn.plans.way_fitting import Trips, fit_ways
from crowdbench.spawn.plans.ways import SAME, SPEED, Ways, ranked
from studies.plans import log_stopping, log_stops, log_trips

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
    mean, _ = ways.trips.gaussians
    length = np.linalg.norm(mean[..., 2:4] - mean[..., :2], axis=-1)
    i, j = np.unravel_index(length.argmax(), length.shape)
    return int(ways.trips.starts.area[i]), int(ways.trips.goals.area[j])


def test_a_density_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    mean, x = rng.normal(size=(7, 3)), rng.normal(size=(7, 3))
    root = rng.normal(size=(7, 3, 3))
    covariance = root @ root.swapaxes(1, 2) + np.eye(3)
    expected = [multivariate_normal(m, c).logpdf(x) for m, c in zip(mean, covariance, strict=True)]
    np.testing.assert_allclose(log_gaussians(x, mean, covariance).T, expected)


def test_trips_have_the_density_of_the_model(ways: Ways, drawn: Trips) -> None:
    """Ranks of trips by the density are those of trips drawn from the mixture itself."""
    a, g = widest(ways)
    mean, covariance = (x[ways.trips.between(a, g)] for x in ways.trips.gaussians)
    weight = ways.trips.weight[ways.trips.between(a, g)]
    rng = np.random.default_rng(1)
    number = rng.choice(len(weight), NUMBER, p=weight / weight.sum())
    trip = np.stack([rng.multivariate_normal(mean[k], covariance[k]) for k in number])
    expected = log_trips(ways.trips, replace(drawn, trip=trip))
    trip[:, 4] = ranked(trip[:, 4], ways.ranks)
    of_ranked = log_trips(ways.trips, replace(drawn, trip=trip), ways.ranks)
    found = log_trips(ways.trips, drawn, ways.ranks)
    assert ks_2samp(found, of_ranked).statistic < 0.04
    assert not np.allclose(of_ranked, expected)
    before = ranked(trip[:, 4], ways.ranks[:, ::-1])
    step = 1e-6
    slope = (ranked(before + step, ways.ranks) - ranked(before, ways.ranks)) / step
    smooth = np.isclose(slope, (trip[:, 4] - ranked(before - step, ways.ranks)) / step, rtol=1e-3)
    assert smooth.mean() > 0.99
    np.testing.assert_allclose(of_ranked[smooth], (expected - np.log(slope))[smooth], atol=1e-5)


@given(
    st.lists(st.tuples(st.floats(0.01, 1), st.floats(0.01, 1)), min_size=2, max_size=8),
    st.lists(st.floats(-5, 5), min_size=1, max_size=20),
)
def test_ranks_keep_the_order_and_are_undone_by_their_inverse(
    steps: list[tuple[float, float]], numbers: list[float]
) -> None:
    ranks, x = np.cumsum(steps, axis=0) - 1.0, np.sort(numbers)
    moved = ranked(x, ranks)
    assert (np.diff(moved) >= 0).all()
    np.testing.assert_allclose(ranked(moved, ranks[:, ::-1]), x, atol=1e-9)
    np.testing.assert_allclose(ranked(ranks[:, 0], ranks), ranks[:, 1])
    np.testing.assert_array_equal(ranked(x, SAME), x)


def test_drawn_speeds_are_as_skewed_as_recorded_ones() -> None:
    """Recorded speeds, not their logarithms, are Gaussian here, with slow people besides."""
    crowd = recording_of(PLAZA)
    areas = read_areas(PLAZA)
    marks = marks_of(crowd, blocks_of(crowd, PLAZA))
    trips = trips_alone(crowd, marks, 0.0)
    rng = np.random.default_rng(0)
    speed = np.where(rng.random(len(trips.trip)) < 0.1, 0.6, rng.normal(1.4, 0.15, len(trips.trip)))
    skewed = trips.trip.copy()
    skewed[:, SPEED] = np.log(speed * rng.uniform(0.99, 1.01, len(speed)))
    fitted = fit_ways(replace(trips, trip=skewed), areas)
    rows = rng.choice(len(skewed), NUMBER, p=trips.weight / trips.weight.sum())
    a, g = trips.spawn_area[rows], trips.goal_area[rows]

    def apart(ways: Ways) -> float:
        found = ways.draw(a, g, PLAZA, np.random.default_rng(1))
        return float(ks_2samp(found[:, SPEED], skewed[rows, SPEED]).statistic)

    assert apart(fitted) < 0.05 < 0.1 < apart(replace(fitted, ranks=SAME))


def test_few_people_have_no_ranks() -> None:
    crowd = recording_of(PLAZA)
    marks = marks_of(crowd, blocks_of(crowd, PLAZA))
    trips = trips_alone(crowd, marks, 0.0)
    few = trips.chosen(np.arange(len(trips.weight)) < 15)
    assert fit_ways(few, read_areas(PLAZA)).ranks is SAME
    alike = replace(few, trip=np.where(np.arange(5) == SPEED, 0.2, few.trip))
    assert fit_ways(alike, read_areas(PLAZA)).ranks is SAME


def test_people_stop_with_the_probability_of_the_model(ways: Ways, drawn: Trips) -> None:
    p = float(ways.stopping[widest(ways)])
    assert 0.02 < p < 0.5
    assert binomtest(int(drawn.stops.sum()), NUMBER, p).pvalue > 1e-3
    told = log_stopping(ways, drawn)
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
    np.testing.assert_allclose(np.exp(log_stops(ways, drawn)), expected)


def test_those_who_join_somebody_have_no_trip_of_their_own() -> None:
    crowd = recording_of(PLAZA)
    marks = marks_of(crowd, blocks_of(crowd, PLAZA))
    joined = marks.earlier >= 0
    assert (marks.group[joined] == marks.group[marks.earlier[joined]]).all()
    assert (marks.time_s[joined] >= marks.time_s[marks.earlier[joined]]).all()
    assert marks.first.sum() == (~joined).sum()
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
    expected = 0.6 * 1 + 0.4 * 0.6 * np.log(4) ** 2 + 1e-4  # room for rounding
    assert ways.stop_covariance[0, 2, 2] == pytest.approx(expected)
    assert ways.stopping[0, 0] == pytest.approx(few / number)
    nobody = fit_ways(replace(trips, stop=np.full((number, 3), np.nan)), areas)
    assert len(nobody.stop_mean) == 0
    assert not nobody.stopping.any()


def test_as_many_people_stop_as_were_seen_to() -> None:
    areas = read_areas(PLAZA)
    rng = np.random.default_rng(0)
    number = 500
    # Most of those who stop come from an area of few people, and have other weights.
    a = (rng.random(number) < 0.05).astype(np.int64)
    weight = rng.uniform(1, 3, number)
    stop = np.full((number, 3), np.nan)
    who = rng.random(number) < np.where(a == 1, 0.9, 0.02)
    stop[who] = rng.normal(size=(who.sum(), 3))
    trip = rng.normal(size=(number, 5))
    zeros = np.zeros(number, np.int64)
    trips = Trips(weight, a, zeros, trip, np.zeros((number, 2)), stop)
    ways = fit_ways(trips, areas)
    expected = weight @ ways.stopping[a, zeros] / weight.sum()
    assert expected == pytest.approx(weight[who].sum() / weight.sum(), rel=1e-6)
    assert ways.stopping[1, 0] > 3 * ways.stopping[0, 0]
    everybody = fit_ways(replace(trips, stop=rng.normal(size=(number, 3))), areas)
    np.testing.assert_allclose(everybody.stopping, 1)
