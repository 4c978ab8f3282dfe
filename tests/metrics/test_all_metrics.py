"""What holds for all metrics. What each of them measures, the tests of its family say."""

from dataclasses import asdict, replace
from functools import partial

import numpy as np
import pytest
from comparisons import (
    BLOCKS,
    BUSY,
    BUSY_TOO,
    PLACE,
    any_crowds,
    mingling,
    mingling_crowds,
    nobody,
    score,
    whole,
)
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from strategies import later, reordered

from crowdbench.data.table import Trajectories
from crowdbench.metrics import (
    FAMILIES,
    METRICS,
    Metric,
    Place,
    Statistics,
    Sums,
    Support,
    metrics_for,
    total,
)
from crowdbench.metrics.forms import TotalVariation

NOBODY = nobody()
FEW = settings(max_examples=15)

each_metric = pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)
two_crowds = st.tuples(any_crowds, any_crowds)


def aligned(metric: Metric, *crowds: Trajectories) -> tuple[list[Statistics], Support]:
    """The crowds' statistics on one support."""
    return metric.aligned([metric.summarise(crowd, BLOCKS, PLACE) for crowd in crowds], BLOCKS)


def weighted(metric: Metric, x: Sums, y: Sums, recorded: Sums, support: Support) -> float:
    """The distance of x and y with the weights of a third crowd."""
    weights = metric.weights(recorded, support, BLOCKS)
    difference = metric.embed(x, support, BLOCKS) - metric.embed(y, support, BLOCKS)
    return float((np.abs(difference) * weights).sum())


def test_names_are_unique_and_families_in_order():
    assert len({metric.name for metric in METRICS}) == len(METRICS)
    assert list(dict.fromkeys(metric.family for metric in METRICS)) == list(FAMILIES)


def test_short_blocks_can_tell_nothing_by_some_metrics():
    missing = {m.name for m in METRICS} - {m.name for m in metrics_for(whole(20, block_s=10.0))}
    assert missing == {"fano_60_s", "autocorrelation", "slow_autocorrelation"}
    assert metrics_for(BLOCKS) == METRICS


@each_metric
def test_the_crowds_of_these_tests_give_each_metric_something_to_see(metric):
    # Otherwise what follows would hold of nothing.
    for crowd in (BUSY, BUSY_TOO):
        for values in metric.summarise(crowd, BLOCKS, PLACE).values():
            assert values[:, 1:].any()
    assert 0 < score(metric, BUSY, BUSY_TOO).distance < np.inf
    assert 0 < score(metric, BUSY, NOBODY).distance < np.inf


@each_metric
@FEW
@example(crowd=BUSY)
@given(crowd=any_crowds)
def test_a_crowd_has_no_distance_to_itself(metric, crowd):
    assert score(metric, crowd, crowd).distance == 0


@each_metric
def test_nobody_has_no_distance_to_nobody(metric):
    assert score(metric, NOBODY, NOBODY).distance == 0


@each_metric
@FEW
@example(crowds=(BUSY, NOBODY))
@given(crowds=two_crowds)
def test_no_distance_is_negative_or_undefined(metric, crowds):
    result = score(metric, *crowds)
    assert result.distance >= 0
    assert result.n >= 0
    shows_nothing = isinstance(metric, TotalVariation)
    assert np.isnan([result.recorded, result.simulated]).all() == shows_nothing


@each_metric
@FEW
@given(crowd=any_crowds, data=st.data())
def test_the_order_of_persons_changes_nothing(metric, crowd, data):
    shuffled = reordered(crowd, data.draw(st.permutations(range(len(crowd)))))
    assert score(metric, crowd, shuffled).distance == 0


@each_metric
@FEW
@example(crowds=(BUSY, BUSY_TOO), frames=9_999)
@given(crowds=two_crowds, frames=st.integers(0, 10_000))
def test_a_shift_in_time_of_both_crowds_and_the_blocks_changes_nothing(metric, crowds, frames):
    blocks = replace(BLOCKS, frames=BLOCKS.frames + frames, since=BLOCKS.since + frames)
    moved = score(metric, *(later(crowd, frames) for crowd in crowds), blocks)
    np.testing.assert_equal(asdict(moved), asdict(score(metric, *crowds)))


def turned(xy: np.ndarray, quarters: int, by: tuple[int, int]) -> np.ndarray:
    """Points turned about the origin by quarters of a circle, then moved by metres."""
    for _ in range(quarters):
        xy = np.stack([-xy[:, 1], xy[:, 0]], axis=1)
    return xy + np.array(by, dtype=xy.dtype)


def turned_place(quarters: int, by: tuple[int, int]) -> Place:
    x0, x1, y0, y1 = PLACE.bounds_m
    corners = turned(np.array([(x0, y0), (x1, y1)]), quarters, by)
    (x0, y0), (x1, y1) = corners.min(axis=0).tolist(), corners.max(axis=0).tolist()
    walls = tuple(
        tuple((x, y) for x, y in turned(np.array(wall), quarters, by).tolist())
        for wall in PLACE.walls
    )
    return replace(PLACE, bounds_m=(x0, x1, y0, y1), walls=walls)


@each_metric
@FEW
@example(crowds=(BUSY, BUSY_TOO), quarters=1, by=(3, -17))
@given(
    crowds=st.tuples(mingling_crowds, mingling_crowds),
    quarters=st.integers(0, 3),
    by=st.tuples(st.integers(-100, 100), st.integers(-100, 100)),
)
def test_a_rigid_motion_of_everything_changes_nothing(metric, crowds, quarters, by):
    moved = [replace(crowd, xy=turned(crowd.xy, quarters, by)) for crowd in crowds]
    there = score(metric, *moved, place=turned_place(quarters, by))
    here = score(metric, *crowds)
    # Cells are counted in another order, which their sum may feel in its last digit.
    assert there.distance == pytest.approx(here.distance, abs=1e-12)
    assert (there.n, there.unit) == (here.n, here.unit)
    np.testing.assert_equal([there.recorded, there.simulated], [here.recorded, here.simulated])


@each_metric
@FEW
@example(crowds=(BUSY, BUSY_TOO, mingling(4)))
@given(crowds=st.tuples(any_crowds, any_crowds, any_crowds))
def test_under_the_recordings_weights_each_distance_is_a_metric(metric, crowds):
    statistics, support = aligned(metric, BUSY, *crowds)
    recorded, x, y, z = map(total, statistics)

    def d(a: Sums, b: Sums) -> float:
        return weighted(metric, a, b, recorded, support)

    assert d(x, y) == d(y, x)
    assert d(x, z) <= d(x, y) + d(y, z) + 1e-9


@each_metric
def test_the_weights_are_those_of_the_recording(metric):
    statistics, support = aligned(metric, BUSY, BUSY_TOO)
    y, x = map(total, statistics)
    expected = weighted(metric, x, y, y, support)
    assert score(metric, BUSY, BUSY_TOO).distance == pytest.approx(expected, abs=1e-12)


@each_metric
@FEW
@given(
    seeds=st.lists(st.integers(0, 2**32 - 1), min_size=2, max_size=6, unique=True),
    data=st.data(),
)
def test_distances_are_of_negative_type(metric, seeds, data):
    # Σ wᵢ wⱼ d(xᵢ, xⱼ) ≤ 0 for weights that sum to zero: what makes the energy score proper.
    statistics, support = aligned(metric, BUSY, *map(mingling, seeds))
    recorded, *sums = map(total, statistics)
    w = data.draw(arrays(np.float64, len(sums), elements=st.floats(-1, 1)))
    w = w - w.mean()
    d = np.array([[weighted(metric, a, b, recorded, support) for b in sums] for a in sums])
    assert w @ d @ w <= 1e-9


@each_metric
@FEW
@example(crowd=BUSY, chosen=np.array([True, False, True, True]))
@given(crowd=any_crowds, chosen=arrays(np.bool_, len(BLOCKS)).filter(np.any))
def test_some_blocks_have_the_statistics_that_they_have_among_all(metric, crowd, chosen):
    # Folds rely on it. Blocks of different lengths, so that no subset looks like the whole.
    blocks = replace(BLOCKS, frames=np.array([[0, 14], [14, 60], [66, 91], [91, 126]]))
    every = metric.summarise(crowd, blocks, PLACE)
    some = metric.summarise(crowd, blocks.take(chosen), PLACE)
    (a, b), _ = metric.aligned([{k: v[chosen] for k, v in every.items()}, some], blocks)
    assert a.keys() == b.keys()
    for name, values in a.items():
        assert np.array_equal(values, b[name]), name


def dense(metric: Metric, statistics: Statistics, size: int) -> Statistics:
    """The histograms of one crowd on the values 0, 1, … up to `size`."""
    return {
        name: np.pad(values, ((0, 0), (0, size - values.shape[1])))
        if metric.on_lattice(name)
        else values
        for name, values in statistics.items()
    }


@each_metric
@FEW
@example(crowd=BUSY_TOO)
@given(crowd=any_crowds)
def test_the_support_leaves_out_nothing_that_counts(metric, crowd):
    statistics = [metric.summarise(c, BLOCKS, PLACE) for c in (BUSY, crowd)]
    widest = max(values.shape[1] for s in statistics for values in s.values())
    size = max(widest, metric.if_empty(BLOCKS) + 1)
    y, x = (total(dense(metric, s, size)) for s in statistics)
    result = score(metric, BUSY, crowd)
    assert result.distance == pytest.approx(weighted(metric, x, y, y, np.arange(size)), abs=1e-9)
    assert result.n == metric.size(x)


@each_metric
@FEW
@example(crowds=(BUSY, BUSY_TOO))
@given(crowds=two_crowds)
def test_vectors_of_many_sums_at_once_are_those_of_each(metric, crowds):
    statistics, support = aligned(metric, *crowds, NOBODY)
    each = [total(s) for s in statistics]
    batch = {name: np.stack([sums[name] for sums in each]) for name in each[0]}
    expected = np.stack([metric.embed(sums, support, BLOCKS) for sums in each])
    # Products of matrices may add up in another order: the last digits differ.
    same = partial(np.testing.assert_allclose, rtol=1e-12, atol=1e-12)
    same(metric.embed(batch, support, BLOCKS), expected)
    nested = {name: values[:, None] for name, values in batch.items()}
    same(metric.embed(nested, support, BLOCKS), expected[:, None])
