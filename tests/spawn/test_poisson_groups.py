"""Groups at constant rates: the likelihood by hand, the samples, and its kin."""

import math

import numpy as np
import pytest
from models import AREAS, GRID_S, arrivals_at, groups, learned

from crowdbench.errors import SettingError
from crowdbench.scene import load_scene
from crowdbench.spawn import PoissonGMM, PoissonGroups, RenewalGMM, arrivals_in
from crowdbench.spawn.ntpp import training as ntpp_training
from crowdbench.spawn.ntpp.model import NtppGMM

ETH = load_scene("eth-v0")
OF_TWO = arrivals_at([1, 4, 4, 5, 12, 12, 12, 13], [0, 0, 0, 1, 0, 0, 0, 1], [(0, 8), (11, 19)])


def test_the_likelihood_is_that_of_grid_points_and_sizes_by_hand() -> None:
    model, more = groups(), 0.3
    some = model.rate_per_s * GRID_S
    by_hand = 3 * math.log(some[0]) + 13 * math.log(1 - some[0])
    by_hand += 2 * math.log(some[1]) + 14 * math.log(1 - some[1])
    by_hand += 5 * math.log(1 - more) + 3 * math.log(more)
    assert 8 * model.log_likelihood(OF_TWO) == pytest.approx(by_hand, rel=1e-9)


def test_it_is_a_renewal_process_of_shape_one() -> None:
    model = groups()
    scale = -GRID_S / np.log(1 - model.rate_per_s * GRID_S)
    same = RenewalGMM(AREAS, np.ones(2), scale, model.next_member, GRID_S)
    assert model.log_likelihood(OF_TWO) == pytest.approx(same.log_likelihood(OF_TWO), rel=1e-6)


def test_an_area_of_ntpp_without_a_trained_network_is_it() -> None:
    weights = ntpp_training.start_weights(OF_TWO, seed=0)
    untrained = NtppGMM(AREAS, weights, GRID_S, memory=7)
    assert untrained.trained().tolist() == [False, False]
    assert learned(untrained) == 4
    fitted = PoissonGroups.fit(OF_TWO, AREAS)
    for arrivals in (OF_TWO, arrivals_at([3], [1], [(0, 60)])):
        expected = fitted.log_likelihood(arrivals)
        assert untrained.log_likelihood(arrivals) == pytest.approx(expected, rel=1e-5)


def test_a_fit_expects_exactly_the_recorded_persons() -> None:
    fitted, poisson = PoissonGroups.fit(OF_TWO, AREAS), PoissonGMM.fit(OF_TWO, AREAS)
    persons_per_s = fitted.rate_per_s / (1 - fitted.next_member)
    np.testing.assert_allclose(persons_per_s, poisson.rate, rtol=1e-9)


def test_no_other_rate_is_more_likely() -> None:
    fitted = PoissonGroups.fit(OF_TWO, AREAS)
    for factor in (0.5, 2.0):
        other = PoissonGroups(AREAS, factor * fitted.rate_per_s, fitted.next_member, GRID_S)
        assert other.log_likelihood(OF_TWO) < fitted.log_likelihood(OF_TWO)


def test_the_fit_recovers_the_model_from_its_samples() -> None:
    truth, horizon_s = groups(), 40_000.0
    events = truth.sample(horizon_s, ETH, np.random.default_rng(4))
    assert events.time_s.max() < horizon_s
    assert np.allclose(events.time_s / GRID_S, np.round(events.time_s / GRID_S))
    fitted = PoissonGroups.fit(arrivals_in(events, horizon_s, GRID_S, 2), AREAS)
    np.testing.assert_allclose(fitted.rate_per_s, truth.rate_per_s, rtol=0.1)
    np.testing.assert_allclose(fitted.next_member, truth.next_member, atol=0.03)


def test_the_same_seed_gives_the_same_people() -> None:
    one, two = (groups().sample(100.0, ETH, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.time_s, two.time_s)
    assert np.array_equal(one.goal, two.goal)


def test_another_grid_is_refused() -> None:
    arrivals = arrivals_in(groups().sample(100.0, ETH, np.random.default_rng(0)), 100.0, 0.8, 2)
    with pytest.raises(SettingError, match=r"a grid of 0\.4 s"):
        groups().hazards(arrivals)
