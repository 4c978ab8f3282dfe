"""Arrivals as groups, and probabilities from cumulative hazards: the same for every model."""

import itertools
import math

import numpy as np
import pytest
from hypothesis import given
from models import GRID_S, arrivals_at, poisson, random_ntpp, renewal
from strategies import arrivals_of_two_areas

from crowdbench.errors import SettingError
from crowdbench.spawn import Arrivals, SpawnModel
from crowdbench.spawn.times.groups import HasHazards, Hazards, group_size, spells_of

# Area 0: a pair at point 1 and one at point 2 of the first stretch; area 1: one at point 11.
FEW = arrivals_at([1, 1, 2, 11], [0, 0, 0, 1], [(0, 4), (10, 13)])


def test_who_enters_at_one_grid_point_and_area_is_one_group() -> None:
    spells = spells_of(FEW)
    assert spells.size.tolist() == [2, 1, 1]
    assert spells.area.tolist() == [0, 0, 1, 1]
    assert spells.of_group.tolist() == [0, 0, 3]


def test_gaps_count_from_the_point_before_the_stretch_and_rests_to_its_end() -> None:
    spells = spells_of(FEW)
    assert spells.gap.tolist() == [2, 1, 2]
    assert spells.rest.tolist() == [1, 3, 4, 1]
    assert spells.opens.tolist() == [1, 0, 1]


@given(arrivals_of_two_areas())
def test_gaps_and_rests_fill_the_stretches(arrivals: Arrivals) -> None:
    spells = spells_of(arrivals)
    filled = np.bincount(spells.of_group, spells.gap, minlength=len(spells.rest)) + spells.rest
    length = np.tile(np.diff(arrivals.windows, axis=1)[:, 0], arrivals.areas)
    assert filled.tolist() == length.tolist()
    assert spells.size.sum() == len(arrivals.tick)
    assert len(spells.gap) == (arrivals.counts() > 0).sum()


@given(arrivals_of_two_areas())
def test_poissons_hazards_give_its_likelihood_in_closed_form(arrivals: Arrivals) -> None:
    model = poisson()
    by_hazards = HasHazards.log_likelihood(model, arrivals)
    assert by_hazards == pytest.approx(model.log_likelihood(arrivals), rel=1e-9)


def test_probabilities_come_from_hazards_as_by_hand() -> None:
    # P(gap) = e^−1 − e^−3, P(size) = 1 − e^−½, and e^−2 for the rest.
    hazards = Hazards(np.array([[1.0, 3.0]]), np.array([[0.0, 0.5]]), np.array([2.0]))
    by_hand = math.log(math.exp(-1) - math.exp(-3)) + math.log(1 - math.exp(-0.5)) - 2
    assert hazards.log_probability() == pytest.approx(by_hand)


def test_sizes_have_one_more_group_of_the_mean_size() -> None:
    arrivals = arrivals_at([1, 1, 2, 5], [0, 0, 0, 1], [(0, 10)])
    more, groups = group_size(arrivals)
    mean = 4 / 3  # of the scene's three groups
    sizes = np.array([(3 + mean) / 3, (1 + mean) / 2])
    np.testing.assert_allclose(1 / (1 - more), sizes)
    np.testing.assert_allclose(groups * sizes * 10, [3, 1])


def test_where_nobody_enters_a_group_is_as_good_as_impossible() -> None:
    more, groups = group_size(arrivals_at([1], [0], [(0, 10)]))
    assert 0 < groups[1] < 1e-9
    assert 0 < more[1] < 1


MODELS = {"poisson": poisson, "renewal": renewal, "ntpp": random_ntpp}


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_probabilities_of_all_counts_sum_to_one(make: object) -> None:
    # A window of four points in which only one area is looked at, up to five persons a point.
    model: SpawnModel = make(next_member=0.004)  # type: ignore[operator]
    nobody = arrivals_at([], [], [(0, 4)])
    other = _without(model, nobody, 1)
    total = 0.0
    for counts in itertools.product(range(6), repeat=4):
        ticks = np.repeat(np.arange(4), counts).tolist()
        arrivals = arrivals_at(ticks, [0] * len(ticks), [(0, 4)])
        nats = model.log_likelihood(arrivals) * max(1, len(ticks))
        total += math.exp(nats - other)
    assert total == pytest.approx(1, abs=2e-6)


def _without(model: SpawnModel, nobody: Arrivals, area: int) -> float:
    """Log-probability of no arrivals in one area."""
    spells = spells_of(nobody)
    return -float(model.hazards(nobody).rest[spells.area == area].sum())  # type: ignore[attr-defined]


@pytest.mark.parametrize("make", MODELS.values(), ids=MODELS)
def test_stretches_are_independent(make: object) -> None:
    model: SpawnModel = make()  # type: ignore[operator]
    parts = [
        arrivals_at([1, 1, 2], [0, 0, 0], [(0, 4)]),
        arrivals_at([11], [1], [(10, 13)]),
    ]
    total = sum(model.log_likelihood(part) * len(part.tick) for part in parts)
    assert model.log_likelihood(FEW) * 4 == pytest.approx(total)


@pytest.mark.parametrize("make", [renewal, random_ntpp], ids=["renewal", "ntpp"])
def test_a_tie_is_a_group_with_one_member_more(make: object) -> None:
    model: SpawnModel = make()  # type: ignore[operator]
    one, pair = arrivals_at([8], [0], [(0, 9)]), arrivals_at([8, 8], [0, 0], [(0, 9)])
    hazards = model.hazards(one).size  # type: ignore[attr-defined]
    more = 2 * model.log_likelihood(pair) - model.log_likelihood(one)
    assert more == pytest.approx(-(hazards[0, 1] - hazards[0, 0]))


@pytest.mark.parametrize("make", [renewal, random_ntpp], ids=["renewal", "ntpp"])
def test_arrivals_of_another_grid_are_refused(make: object) -> None:
    model: SpawnModel = make()  # type: ignore[operator]
    other = Arrivals(np.array([1]), np.array([0]), np.array([[0, 4]]), 2, GRID_S / 2)
    with pytest.raises(SettingError, match=r"a grid of 0\.2 s"):
        model.log_likelihood(other)
