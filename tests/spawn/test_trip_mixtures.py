"""TripMixtures: mixtures of places in areas, their densities, draws and fits."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from crowdbench.scene import load_scene
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.plans.mixtures import (
    DECIMALS,
    FEWEST,
    NARROWEST_M,
    PRIOR,
    mixed,
    moments,
    responsibilities,
    widened,
)
from crowdbench.spawn.plans.way_fitting import Trips, fit_trips, log_speeds
from crowdbench.spawn.plans.ways import Places, TripMixtures
from studies.plans import log_trips

PLAZA = load_scene("plaza-v0")
DOORS = np.array([[-10.0, -4.0], [-10.0, 4.0]])
COUNTERS = np.array([[10.0, -4.0], [10.0, 4.0]])


@pytest.fixture(scope="module")
def areas() -> Areas:
    return read_areas(PLAZA)


def of_two_doors(number: int, straight: float = 0.9) -> np.ndarray:
    """People who enter by two doors and go to two counters, most of them to the nearer one."""
    rng = np.random.default_rng(0)
    door = rng.integers(0, 2, number)
    counter = np.where(rng.random(number) < straight, door, 1 - door)
    ends = np.concatenate([DOORS[door], COUNTERS[counter]], axis=1)
    return np.column_stack([ends + rng.normal(size=ends.shape), 0.2 * rng.normal(size=number)])


def trips_of(trip: np.ndarray, **known: np.ndarray) -> Trips:
    """Trips of people who do not stop, by default from the first area to the first one."""
    number = len(trip)
    nowhere = np.zeros(number, np.int64)
    given = {"weight": np.ones(number), "spawn_area": nowhere, "goal_area": nowhere} | known
    nothing = {"bend": np.zeros((number, 2)), "stop": np.full((number, 3), np.nan)}
    return Trips(trip=trip, **given, **nothing)


def fit(trip: np.ndarray, areas: Areas, **known: np.ndarray) -> TripMixtures:
    return fit_trips(trips_of(trip, **known), areas)


@pytest.fixture(scope="module")
def fitted(areas: Areas) -> TripMixtures:
    return fit(of_two_doors(600), areas)


def two_by_two() -> TripMixtures:
    """Two places of each kind in one area each; one pair of them has a Gaussian of its own."""
    starts, goals = (
        Places(np.zeros(2, np.int64), np.array([0.3, 0.7]), mean, np.stack([np.eye(2)] * 2))
        for mean in (DOORS / 4, COUNTERS / 4)
    )
    root = np.tril(np.random.default_rng(0).normal(size=(5, 5))) + 2 * np.eye(5)
    return replace(
        TripMixtures.apart(starts, goals, np.array([0.1, 0.3])),
        weight=np.array([[0.1, 0.2], [0.4, 0.3]]),
        own=np.array([[1, 0]]),
        mean=np.array([[1.0, -1.0, 0.5, 2.0, 0.0]]),
        covariance=root[None] @ root[None].swapaxes(1, 2) / 4,
    )


def test_a_density_is_that_of_the_mixture() -> None:
    trips, x = two_by_two(), np.random.default_rng(1).normal(size=(50, 5))
    expected = np.zeros(50)
    for i in range(2):
        for j in range(2):
            if (i, j) == (1, 0):
                each = multivariate_normal(trips.mean[0], trips.covariance[0]).pdf(x)
            else:
                start = multivariate_normal(trips.starts.mean[i], np.eye(2)).pdf(x[:, :2])
                goal = multivariate_normal(trips.goals.mean[j], np.eye(2)).pdf(x[:, 2:4])
                each = start * goal * multivariate_normal(0.1, 0.3).pdf(x[:, 4])
            expected += trips.weight[i, j] * each
    np.testing.assert_allclose(np.exp(log_trips(trips, trips_of(x))), expected)


def test_a_density_integrates_to_one() -> None:
    """By importance sampling with a wide Gaussian."""
    trips, number = two_by_two(), 200_000
    mean, covariance = trips.gaussians
    wide = multivariate_normal(mean.mean(axis=(0, 1)), 3 * covariance.max(axis=(0, 1)) * np.eye(5))
    x = wide.rvs(number, random_state=0)
    ratio = np.exp(log_trips(trips, trips_of(x)) - wide.logpdf(x))
    assert ratio.mean() == pytest.approx(1, abs=4 * ratio.std() / np.sqrt(number))
    assert ratio.std() / np.sqrt(number) < 0.02


def test_draws_have_the_moments_and_the_density_of_the_mixture() -> None:
    trips, number = two_by_two(), 100_000
    zeros = np.zeros(number, np.int64)
    rng = np.random.default_rng(0)
    x = trips.draw(trips.choose(zeros, zeros, rng), rng)
    weight, (mean, covariance) = trips.weight.ravel(), trips.gaussians
    mean, covariance = mean.reshape(-1, 5), covariance.reshape(-1, 5, 5)
    centre, between = moments(mean, weight)
    np.testing.assert_allclose(x.mean(axis=0), centre, atol=0.05)
    expected = between + np.einsum("c,cij->ij", weight, covariance)
    np.testing.assert_allclose(np.cov(x.T), expected, atol=0.03 * expected.max())
    # The mean of 1 / density over draws in a box is the volume of the box.
    low, high = centre - 0.5, centre + 0.5
    inside = ((x > low) & (x < high)).all(axis=1)
    density = np.exp(log_trips(trips, trips_of(x[inside])))
    assert (1 / density).sum() / number == pytest.approx(1, abs=4 / np.sqrt(inside.sum()))


def test_draws_keep_to_the_places_of_their_areas() -> None:
    rng = np.random.default_rng(0)
    area = np.array([0, 1, 1, 2])
    starts = Places(
        area, np.array([1, 0.5, 0.5, 1]), 100.0 * np.eye(4)[:, :2], np.stack([np.eye(2)] * 4)
    )
    starts.mean[:, 0] = [0, 100, 200, 300]
    goals = Places(
        np.array([0, 0, 1]), np.array([0.2, 0.8, 1]), starts.mean[:3], starts.covariance[:3]
    )
    trips = TripMixtures.apart(starts, goals, np.array([0.0, 0.1]))
    a, g = rng.integers(0, 3, 5000), rng.integers(0, 2, 5000)
    x = trips.draw(trips.choose(a, g, rng), rng)
    nearest = np.abs(x[:, :1] - starts.mean[:, 0]).argmin(axis=1)
    np.testing.assert_array_equal(area[nearest], a)
    assert (nearest[a == 1] == 1).mean() == pytest.approx(0.5, abs=0.05)
    to = np.abs(x[:, 2:3] - goals.mean[:, 0]).argmin(axis=1)
    np.testing.assert_array_equal(goals.area[to], g)
    assert (to[g == 0] == 1).mean() == pytest.approx(0.8, abs=0.05)


def test_two_doors_are_two_places_and_the_nearer_counter_is_the_usual_one(
    fitted: TripMixtures,
) -> None:
    mine = fitted.starts.area == 0
    assert mine.sum() == 3  # both doors, and the area itself
    assert fitted.starts.weight[mine][-1] == pytest.approx(PRIOR / (600 + PRIOR))
    doors = fitted.starts.mean[mine][:2]
    np.testing.assert_allclose(doors[doors[:, 1].argsort()], DOORS, atol=0.3)
    i, j = fitted.between(0, 0)
    mean, weight = fitted.gaussians[0][i, j], fitted.weight[i, j]
    straight = mean[:, 1] * mean[:, 3] > 4
    across = mean[:, 1] * mean[:, 3] < -4
    assert weight[straight].sum() == pytest.approx(0.9, abs=0.06)
    assert weight[across].sum() == pytest.approx(0.1, abs=0.06)


def test_who_is_held_out_is_likelier_than_with_places_apart(fitted: TripMixtures) -> None:
    trip = of_two_doors(1200)[600:]
    speed = fitted.log_speed
    apart = TripMixtures.apart(fitted.starts, fitted.goals, speed)
    gain = log_trips(fitted, trips_of(trip)) - log_trips(apart, trips_of(trip))
    assert gain.mean() > 0.2  # 0.37 nats are known from the door


def test_few_people_of_a_pair_have_the_usual_trips(areas: Areas) -> None:
    trip = of_two_doors(300)
    g = np.zeros(300, np.int64)
    g[: int(FEWEST) - 1] = 1
    trips = fit(trip, areas, goal_area=g)
    at = trips.between(0, 1)
    np.testing.assert_array_equal(
        trips.weight[at], np.outer(trips.starts.weight, trips.goals.weight)[at]
    )
    assert (trips.goals.area[trips.own[:, 1]] == 0).all()


def test_one_place_has_the_moments_of_the_people_and_of_as_many_usual_ones(areas: Areas) -> None:
    rng = np.random.default_rng(0)
    trip, weight = rng.normal(size=(30, 5)), rng.uniform(1, 2, 30)
    trips = fit(trip, areas, weight=weight)
    usual = TripMixtures.apart(
        Places.of(areas.spawn), Places.of(areas.goal), log_speeds(trips_of(trip, weight=weight))
    )
    mean, covariance = (x[0, 0] for x in usual.gaussians)
    expected = mixed(
        moments(trip, weight), weight.sum() / (weight.sum() + PRIOR), (mean, covariance)
    )
    np.testing.assert_array_equal(trips.own, [[0, 0]])
    np.testing.assert_allclose(trips.mean[0], expected[0])
    np.testing.assert_allclose(trips.covariance[0], expected[1], atol=2e-4)


def test_mixed_moments_are_those_of_both_together() -> None:
    rng = np.random.default_rng(0)
    few, usual = rng.normal(size=(7, 3)), rng.normal(size=(40, 3)) + 1
    weight = np.concatenate([np.ones(7), np.full(40, PRIOR / 40)])
    expected = moments(np.concatenate([few, usual]), weight)
    found = mixed(moments(few, np.ones(7)), 7 / (7 + PRIOR), moments(usual, np.ones(40)))
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other)


def test_components_stand_for_ten_people_or_more() -> None:
    rng = np.random.default_rng(0)
    x = np.concatenate([rng.normal(size=(200, 2)), rng.normal(size=(6, 2)) + 50])
    for few in (x[:30], x):
        shares = responsibilities(few, 0.05)
        np.testing.assert_allclose(shares.sum(axis=1), 1)
        assert shares.sum(axis=0).min() >= FEWEST
    assert responsibilities(x[:30], 0.05).shape == (30, 1)


def test_rounding_leaves_places_wide_and_covariances_definite() -> None:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 5, 1)) * 10
    flat = direction @ direction.swapaxes(1, 2)  # no width at all in four directions
    covariance = widened(flat, slice(0, 2), slice(2, 4)).round(DECIMALS)
    for place in (slice(0, 2), slice(2, 4)):
        assert np.linalg.eigvalsh(covariance[:, place, place]).min() >= NARROWEST_M**2
    assert np.linalg.eigvalsh(widened(flat).round(DECIMALS)).min() > 0
