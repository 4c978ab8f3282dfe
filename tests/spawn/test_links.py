"""Companions as marks on arrivals: likelihood, fit, and samples that follow it."""

import itertools
from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import approx_fprime

from crowdbench.spawn.plans.links import (
    EDGES_S,
    Adjustment,
    Links,
    candidates,
    fit_links,
    log_likelihood,
    stages,
)

WEIGHT = np.array([1.0, -0.5, -1.0, -2.0, -2.5, -3.0])
LARGER = np.array([-0.8, 0.6, 0.1])


def links(tendency: tuple[float, ...] = (0.0, 0.5), larger: np.ndarray = LARGER) -> Links:
    zero = np.zeros((1, 5))
    covariance = 0.01 * np.eye(5)[None]
    return Links(WEIGHT, np.array(tendency), larger, np.ones(1), zero, covariance, np.zeros(5))


def arrivals(number: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Arrivals in two areas, some at the same time."""
    rng = np.random.default_rng(seed)
    time_s = np.sort(np.round(rng.uniform(0, 2.0 * number, number) / 0.4) * 0.4)
    return time_s, rng.integers(0, 2, number)


def grouped(joins: np.ndarray) -> np.ndarray:
    """Group of each person, −1 for people whom nobody joins and who join nobody."""
    leader = np.arange(len(joins))
    for i, j in enumerate(joins.tolist()):
        if j >= 0:
            leader[i] = leader[j]
    size = np.bincount(leader, minlength=len(joins))
    return np.where(size[leader] > 1, leader, -1)


@given(st.integers(0, 40), st.integers(0, 5))
def test_candidates_are_all_earlier_arrivals_of_the_area_within_six_seconds(
    number: int, seed: int
) -> None:
    time_s, area = arrivals(number, seed)
    found = candidates(time_s, area)
    expected = {
        (i, j)
        for i, j in itertools.product(range(number), repeat=2)
        if j < i and area[i] == area[j] and time_s[i] - time_s[j] <= 6.0 + 1e-6
    }
    pairs = list(zip(found.later.tolist(), found.earlier.tolist(), strict=True))
    assert len(pairs) == len(set(pairs))
    assert set(pairs) == expected
    assert (np.diff(found.later) >= 0).all()
    for (i, j), k in zip(pairs, found.bin.tolist(), strict=True):
        delay = time_s[i] - time_s[j]
        assert EDGES_S[k] <= delay < EDGES_S[k + 1] or (k == 5 and delay <= EDGES_S[-1])


def nats(model: Links, time_s: np.ndarray, area: np.ndarray, group: np.ndarray) -> float:
    pairs = candidates(time_s, area)
    x = np.concatenate([model.log_weight, model.larger, [model.crowded], model.tendency])
    return log_likelihood(x, pairs, area, pairs.same(group), stages(pairs, area, group))[0]


def test_the_probabilities_of_all_that_can_happen_sum_to_one() -> None:
    """For three people who come one after the other, over all partitions into groups."""
    time_s, area = np.array([0.0, 1.0, 2.5]), np.zeros(3, dtype=np.int64)
    partitions = ([-1, -1, -1], [0, 0, -1], [0, -1, 0], [-1, 1, 1], [0, 0, 0])
    model = links(tendency=(0.3,))
    total = sum(np.exp(nats(model, time_s, area, np.array(group))) for group in partitions)
    assert total == pytest.approx(1.0)


def test_the_gradient_is_that_of_the_likelihood() -> None:
    time_s, area = arrivals(60)
    group = grouped(links().draw(time_s, area, np.random.default_rng(1)))
    pairs = candidates(time_s, area)
    more = pairs.same(group), stages(pairs, area, group)
    x = np.concatenate([links().log_weight, LARGER, [0.4], links().tendency])
    value, slope = log_likelihood(x, pairs, area, *more)
    numeric = approx_fprime(x, lambda y: log_likelihood(y, pairs, area, *more)[0], 1e-6)
    assert np.isfinite(value)
    np.testing.assert_allclose(slope, numeric, rtol=1e-4, atol=1e-4)


@pytest.mark.long
def test_samples_have_the_probabilities_of_the_model() -> None:
    time_s, area = np.array([0.0, 0.0, 1.5]), np.zeros(3, dtype=np.int64)
    model, rng = links(tendency=(0.2,)), np.random.default_rng(0)
    drawn = np.array([model.draw(time_s, area, rng) for _ in range(20_000)])
    weight = np.exp(model.log_weight + 0.2)
    assert (drawn[:, 0] == -1).all()
    assert (drawn[:, 1] == 0).mean() == pytest.approx(weight[0] / (1 + weight[0]), abs=0.01)
    for apart in (True, False):
        of = drawn[(drawn[:, 1] == -1) == apart]
        third = weight[2] * (1.0 if apart else np.exp(LARGER[0]))
        for j in (0, 1):
            assert (of[:, 2] == j).mean() == pytest.approx(third / (1 + 2 * third), abs=0.015)


def test_the_fit_finds_the_weights_again_and_those_who_join_nobody() -> None:
    time_s, area = arrivals(6_000, seed=3)
    truth = links()
    group = grouped(truth.draw(time_s, area, np.random.default_rng(4)))
    offsets = np.random.default_rng(5).normal([0, 0.7, 0, 0.6, 0], 0.2, (200, 5))
    offsets[::2, [1, 3]] *= -1
    walked = np.random.default_rng(6).exponential(1.0, 200)
    offsets[:, 0] += 0.3 * walked
    found = fit_links(time_s, area, group, 2).with_offsets(offsets, walked)
    # The weights and the tendencies are determined together only.
    for a in (0, 1):
        np.testing.assert_allclose(
            (found.log_weight + found.tendency[a])[:4],
            (truth.log_weight + truth.tendency[a])[:4],
            atol=0.35,
        )
    np.testing.assert_allclose(found.larger, truth.larger, atol=0.3)
    assert nats(found, time_s, area, group) > nats(truth, time_s, area, group) - 5
    mean = found.share @ found.mean
    np.testing.assert_allclose(mean, [0, 0.7, 0, 0.6, 0], atol=0.06)
    np.testing.assert_allclose(found.slope, [0.3, 0, 0, 0, 0], atol=0.06)
    nobody = fit_links(time_s, area, np.full(6_000, -1), 2)
    assert (nobody.draw(time_s, area, np.random.default_rng(0)) >= 0).mean() < 0.01


def test_offsets_lie_on_both_sides_and_on_the_same_at_start_and_end() -> None:
    slope = np.array([0.5, 0, 0, 0, 0])
    mean = np.array([0.0, 0.7, 0.0, 0.6, 0.1])
    covariance = 0.001 * np.eye(5)[None]
    none = np.zeros(6), np.zeros(1), np.zeros(3)
    model = Links(*none, np.ones(1), mean[None], covariance, slope, same_side=0.9)
    rng = np.random.default_rng(0)
    drawn, side = model.offsets(np.full(2_000, 2.0), np.zeros(2_000), rng)
    assert drawn[:, 0].mean() == pytest.approx(1.0, abs=0.01)
    assert (drawn[:, 1] > 0).mean() == pytest.approx(0.5, abs=0.05)
    assert (np.sign(drawn[:, 1]) == np.sign(drawn[:, 3])).all()
    assert drawn[:, 4].mean() == pytest.approx(0.1, abs=0.01)
    assert (np.sign(drawn[:, 1]) == side).all()
    _, again = model.offsets(np.full(2_000, 2.0), side, rng)
    assert (again == side).mean() == pytest.approx(0.9, abs=0.03)


def test_offsets_are_those_of_one_kind_of_companions_or_the_other() -> None:
    rng = np.random.default_rng(0)
    kinds = np.array([[0.0, 0.7, 0.0, 0.7, 0.0], [-1.5, 0.2, -1.5, 0.2, 0.0]])
    of = (rng.random(600) < 0.25).astype(np.int64)
    offsets = kinds[of] + 0.1 * rng.standard_normal((600, 5))
    found = links().with_offsets(offsets, np.zeros(600))
    order = np.argsort(-found.share)
    np.testing.assert_allclose(found.share[order], [0.75, 0.25], atol=0.05)
    np.testing.assert_allclose(found.mean[order], kinds, atol=0.05)
    drawn, _ = found.offsets(np.zeros(4_000), np.zeros(4_000), rng)
    drawn[:, (1, 3)] *= np.sign(drawn[:, 1:2])
    behind = drawn[:, 0] < -0.75
    assert behind.mean() == pytest.approx(0.25, abs=0.03)
    np.testing.assert_allclose(drawn[behind].mean(axis=0), kinds[1], atol=0.05)


def test_a_stage_is_the_size_of_the_group_that_has_come_so_far() -> None:
    time_s = np.array([0.0, 0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 3.5])
    area, group = np.zeros(8, dtype=np.int64), np.array([7, -1, 7, 7, 7, -1, 7, 7])
    pairs = candidates(time_s, area)
    stage = {
        (i, j): k
        for i, j, k in zip(
            pairs.later.tolist(),
            pairs.earlier.tolist(),
            stages(pairs, area, group).tolist(),
            strict=True,
        )
    }
    assert stage[1, 0] == stage[2, 0] == stage[2, 1] == 0
    assert stage[3, 0] == stage[3, 2] == 1
    assert stage[4, 0] == stage[4, 2] == stage[4, 3] == 2
    assert stage[5, 3] == 3
    assert stage[7, 6] == 3
    assert stage[4, 1] == stage[5, 1] == 0
    other = stages(pairs, np.array([1, 0, 0, 0, 0, 0, 0, 0]), group)
    found = dict(zip(stage, other.tolist(), strict=True))
    assert (found[4, 3], found[6, 3], found[7, 3]) == (1, 2, 3)


def test_groups_that_take_in_nobody_have_two_people() -> None:
    time_s, area = arrivals(4_000)
    group = grouped(links(larger=np.full(3, -30.0)).draw(time_s, area, np.random.default_rng(0)))
    assert set(np.bincount(group[group >= 0]).tolist()) == {0, 2}


def test_fewer_people_join_where_many_enter() -> None:
    """Of two people who may join the same number of others, with weights divided by 3^c."""
    rng, area = np.random.default_rng(0), np.zeros(4, dtype=np.int64)
    none = np.full(6, -30.0)
    model = replace(links(larger=np.zeros(3)), log_weight=np.where(np.arange(6) == 5, 0.0, none))
    time_s = np.array([0.0, 0.0, 0.0, 5.0])  # the last one may join each of the others
    for crowded in (0.0, 1.0):
        found = replace(model, crowded=crowded)
        joins = np.mean([found.draw(time_s, area, rng)[3] >= 0 for _ in range(5_000)])
        weight = 3 * 3**-crowded
        assert joins == pytest.approx(weight / (1 + weight), abs=0.02)


def test_groups_have_at_most_ten_people() -> None:
    always = replace(links(larger=np.zeros(3)), log_weight=np.full(6, 20.0))
    time_s, area = np.zeros(30), np.zeros(30, dtype=np.int64)
    group = grouped(always.draw(time_s, area, np.random.default_rng(0)))
    assert [n for n in np.bincount(group[group >= 0]).tolist() if n] == [10, 10, 10]


def test_without_arrivals_nobody_joins() -> None:
    none = np.empty(0)
    assert len(links().draw(none, none.astype(np.int64), np.random.default_rng(0))) == 0


def test_links_are_adjusted_by_four_numbers() -> None:
    model = replace(links(), mean=np.array([[1.0, 2.0, 3.0, 4.0, 5.0]]))
    by = Adjustment(more=0.7, larger=0.4, along=0.5, across=2.0)
    other = model.adjusted(by)
    np.testing.assert_allclose(other.log_weight, WEIGHT + 0.7)
    np.testing.assert_allclose(other.larger, LARGER + np.array([0.2, 0.4, 0.4]))
    np.testing.assert_allclose(other.mean, [[0.5, 4.0, 1.5, 8.0, 2.5]])
    sd = np.sqrt(np.diagonal(other.covariance[0]))
    np.testing.assert_allclose(sd, 0.1 * np.array([0.5, 2.0, 0.5, 2.0, 0.5]))
    same = model.adjusted(Adjustment())
    for field in fields(model):
        np.testing.assert_array_equal(getattr(same, field.name), getattr(model, field.name))
