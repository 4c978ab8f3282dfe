"""The neural model without torch: its density, its samples, its start."""

import math
from dataclasses import replace

import numpy as np
import pytest
from models import AREAS, GRID_S, arrivals_at, parameters, random_ntpp

from crowdbench.scene import load_scene
from crowdbench.spawn import Areas, NtppGMM, PoissonGMM, arrivals_in
from crowdbench.spawn.ntpp.model import SHAPES
from crowdbench.spawn.times.groups import Spells, spells_of

ETH = load_scene("eth-v0")
OF_TWO = arrivals_at([1, 4, 4, 5, 12, 12, 12, 13], [0, 0, 0, 1, 0, 0, 0, 1], [(0, 8), (11, 19)])


def silent(scale: float = 6.0, more: float = 0.25) -> NtppGMM:
    """A network whose head says nothing: a Poisson process of groups on the grid."""
    model = random_ntpp()
    weights = {**model.weights, "out_weight": np.zeros((2, *SHAPES["out_weight"]), np.float32)}
    base = [0.0, np.log(scale), np.log(more / (1 - more))]
    weights["base"] = np.tile(np.array(base, np.float32), (2, 1))
    return replace(model, weights=weights)


def test_a_silent_head_is_a_memoryless_process_by_hand() -> None:
    scale, more = 6.0, 0.25
    some = 1 - math.exp(-1 / scale)  # P(a group at a grid point)
    points, groups, persons = 2 * 16, 5, 8
    by_hand = groups * math.log(some) + (points - groups) * math.log(1 - some)
    by_hand += (persons - groups) * math.log(more) + groups * math.log(1 - more)
    assert 8 * silent(scale, more).log_likelihood(OF_TWO) == pytest.approx(by_hand, rel=1e-6)


def test_time_without_arrivals_costs_its_survival_and_no_more() -> None:
    scale = 6.0
    longer = replace(OF_TWO, windows=np.array([[0, 8], [11, 49]]))
    cost = silent(scale).log_likelihood(OF_TWO) - silent(scale).log_likelihood(longer)
    assert 8 * cost == pytest.approx(2 * 30 / scale, rel=1e-6)


def test_what_the_head_says_depends_on_gaps_and_on_sizes() -> None:
    model = random_ntpp()
    after = [
        parameters(model, arrivals_at([*ticks, 15], [0] * (len(ticks) + 1), [(0, 20)]))[-1]
        for ticks in ([3], [4], [3, 3])
    ]
    assert not np.allclose(after[0], after[1], rtol=1e-3)
    assert not np.allclose(after[0], after[2], rtol=1e-3)


def test_the_sampler_walks_through_the_states_of_the_likelihood() -> None:
    # Of each drawn gap and size the random number is known: what the likelihood's walk says
    # there must turn it into the same gap and size. A clamped state would not.
    model = random_ntpp()
    one = replace(model, areas=_one(AREAS), weights={k: w[:1] for k, w in model.weights.items()})
    points = 3000
    events = one.sample(points * GRID_S, ETH, np.random.default_rng(8))
    arrivals = arrivals_in(events, points * GRID_S, GRID_S, 1)
    spells = spells_of(arrivals)
    u = np.random.default_rng(8).random(2 * len(spells.gap)).reshape(-1, 2)
    shape, scale, more = parameters(one, arrivals).T
    gap = np.maximum(1, np.ceil(scale * (-np.log1p(-u[:, 0])) ** (1 / shape)))
    size = 1 + np.floor(-np.log1p(-u[:, 1]) / more)
    assert len(gap) > 100
    assert spells.gap.tolist() == gap.tolist()
    assert spells.size.tolist() == size.tolist()


def _one(areas: Areas) -> Areas:
    gaussians = replace(areas.spawn, mean=areas.spawn.mean[:1], covariance=np.eye(2)[None])
    return replace(areas, spawn=gaussians, goal=gaussians, flow=np.ones((1, 1)))


def test_groups_of_a_sample_are_bounded_by_what_the_head_can_say() -> None:
    # No weights, however wild, let in more than the bounds around the base allow.
    wild = random_ntpp(spread=30.0)
    assert all(np.isfinite(parameters(wild, OF_TWO)).ravel())
    shape, scale, more = parameters(wild, OF_TWO).T
    area = spells_of(OF_TWO).area[spells_of(OF_TWO).of_group]
    base = wild.weights["base"][area]
    assert (np.abs(np.log(shape) - base[:, 0]) <= 2 + 1e-6).all()
    assert (np.abs(np.log(scale) - base[:, 1]) <= 4 + 1e-6).all()
    assert (np.abs(-np.log(np.expm1(more)) - base[:, 2]) <= 4 + 1e-6).all()


def test_a_memoryless_process_starts_as_it_goes_on() -> None:
    model, points, samples = silent(), 30, 1500
    count = np.zeros(points)
    rng = np.random.default_rng(9)
    for _ in range(samples):
        events = model.sample(points * GRID_S, ETH, rng)
        count += np.bincount(np.round(events.time_s / GRID_S).astype(int), minlength=points)
    expected = 2 * samples * (1 - math.exp(-1 / 6)) / 0.75
    error = math.sqrt(expected * 1.25 / 0.75)
    assert (np.abs(count - expected) < 4.5 * error).all()


def test_events_lie_on_the_grid_inside_the_horizon() -> None:
    time_s = random_ntpp().sample(100.1, ETH, np.random.default_rng(2)).time_s
    assert np.allclose(time_s / GRID_S, np.round(time_s / GRID_S))
    assert time_s.min() >= 0
    assert time_s.max() < 100.1


def test_the_same_seed_gives_the_same_people() -> None:
    one, two = (random_ntpp().sample(100.0, ETH, np.random.default_rng(3)) for _ in range(2))
    assert np.array_equal(one.time_s, two.time_s)
    assert np.array_equal(one.start, two.start)


def test_another_seed_gives_other_people() -> None:
    one, two = (random_ntpp().sample(100.0, ETH, np.random.default_rng(k)) for k in (3, 4))
    assert not np.array_equal(one.time_s, two.time_s)


def test_an_empty_sample_is_no_error() -> None:
    model = silent(scale=1e9)
    assert len(model.sample(10.0, ETH, np.random.default_rng(0))) == 0


def test_spells_of_an_area_without_arrivals_survive() -> None:
    only_one = arrivals_at([3], [0], [(0, 9)])
    spells: Spells = spells_of(only_one)
    hazards = silent(scale=6.0).hazards(only_one)
    assert hazards.rest[spells.area == 1] == pytest.approx(9 / 6, rel=1e-6)


def test_without_dependence_it_agrees_with_poisson_where_groups_are_single() -> None:
    # With hardly any pairs, a Poisson process on the grid is the same thing.
    rate = 0.01 / GRID_S
    arrivals = arrivals_at([100, 450], [0, 1], [(0, 1000)])
    poisson = PoissonGMM(AREAS, np.full(2, rate)).log_likelihood(arrivals)
    assert silent(scale=100.0, more=0.005).log_likelihood(arrivals) == pytest.approx(
        poisson, abs=0.02
    )


def test_after_a_silence_as_long_as_its_memory_the_network_starts_anew() -> None:
    model = replace(random_ntpp(), memory=7)
    busy = [3, 4, 4, 6]
    for silence in (7, 8, 14, 15, 40):
        ticks = [*busy, busy[-1] + silence]
        said = parameters(model, arrivals_at(ticks, [0] * len(ticks), [(0, 60)]))[-1]
        at_first = parameters(model, arrivals_at([3], [0], [(0, 60)]))[0]
        assert np.array_equal(said, at_first) == (silence > 7)


def test_a_forgotten_silence_costs_what_each_of_its_parts_costs() -> None:
    # 17 = 7 + 7 + 3 steps, of which the first part follows a group and the others nothing.
    model = replace(random_ntpp(), memory=7)
    hazards = model.hazards(arrivals_at([3, 20], [0, 0], [(0, 60)]))
    shape, scale, _ = parameters(model, arrivals_at([3, 4], [0, 0], [(0, 60)])).T
    anew = (7 / scale[0]) ** shape[0]
    for step, until in enumerate(hazards.gap[1]):
        parts = (7 / scale[1]) ** shape[1] + anew + ((2 + step) / scale[0]) ** shape[0]
        assert until == pytest.approx(parts, rel=1e-12)
    # And 39 = 5 · 7 + 4 steps at the end, in the same way.
    rest = model.hazards(arrivals_at([3], [0], [(0, 43)])).rest[0]
    parts = (7 / scale[1]) ** shape[1] + 4 * anew + (4 / scale[0]) ** shape[0]
    assert rest == pytest.approx(parts, rel=1e-12)


def test_a_memory_longer_than_any_silence_changes_nothing() -> None:
    arrivals = arrivals_at([1, 4, 4, 12, 30], [0, 0, 0, 0, 1], [(0, 40)])
    model = random_ntpp()
    for memory, same in ((40, True), (39, True), (5, False)):
        some = replace(model, memory=memory).log_likelihood(arrivals)
        assert (some == model.log_likelihood(arrivals)) == same


def test_a_memoryless_process_has_nothing_to_forget() -> None:
    forgetful = replace(silent(), memory=2)
    expected = silent().log_likelihood(OF_TWO)
    assert forgetful.log_likelihood(OF_TWO) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("memory", [1, 3, 12])
def test_samples_of_forgetful_networks_end_at_the_horizon(memory: int) -> None:
    model, points = replace(random_ntpp(), memory=memory), 12
    ticks = [
        np.round(model.sample(points * GRID_S, ETH, np.random.default_rng(seed)).time_s / GRID_S)
        for seed in range(300)
    ]
    found = np.concatenate(ticks)
    assert (found.min(), found.max()) == (0, points - 1)
