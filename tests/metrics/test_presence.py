import math

import numpy as np
import pytest
from comparisons import any_crowds, nobody, sample, score, whole
from hypothesis import given
from strategies import crowd_of, crowds

from crowdbench.data.blocks import cut
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Place
from crowdbench.metrics.metric import total
from crowdbench.metrics.presence import (
    AgentsOverTime,
    AgentsSpread,
    Autocorrelation,
    SlowAutocorrelation,
    StandingShare,
)

TEN = whole(10)
PLACE = Place(spawn_areas=0, goal_areas=0, bounds_m=(0.0, 1.0, 0.0, 1.0))
# N is 1 in four frames, 2 in four and 3 in two.
SOME = crowd_of([(0, 3), (2, 5), (2, 9), (6, 7)], frames=10)


def n_of(crowd: Trajectories) -> list[int]:
    """N(t) as its definition has it."""
    return [int((crowd.first <= t).sum() - (crowd.last < t).sum()) for t in range(crowd.frames)]


def series(values: list[int], dt_s: float = 1.0) -> Trajectories:
    """A crowd with this N(t), of trips of one frame."""
    trips = [(t, t) for t, n in enumerate(values) for _ in range(n)]
    return crowd_of(trips, frames=len(values), dt_s=dt_s)


@given(crowds())
def test_who_is_present_has_come_and_not_gone(crowd):
    assert crowd.present().tolist() == n_of(crowd)


@given(crowd=crowds(dt_s=1.0))
def test_agents_over_time_counts_the_frames_with_n_persons(crowd):
    blocks = cut(crowd.observed, block_s=8.0, dt_s=1.0, grid_s=1.0)
    n = n_of(crowd)
    expected = [sorted(n[start:stop]) for start, stop in blocks.frames]
    assert sample(AgentsOverTime(), crowd, blocks) == expected
    assert sample(AgentsSpread(), crowd, blocks) == expected


def test_agents_over_time_compares_the_distributions_of_n():
    result = score(AgentsOverTime(), SOME, crowd_of([(0, 9)]), TEN)
    assert result.recorded == pytest.approx(1.8)
    assert result.simulated == pytest.approx(1.0)
    assert result.distance == pytest.approx(0.8 / 1.8)
    assert (result.n, result.unit) == (10, "persons")


def test_agents_over_time_counts_empty_frames():
    result = score(AgentsOverTime(), SOME, crowd_of([(1, 5)], frames=10), TEN)
    assert result.simulated == pytest.approx(0.5)


def test_agents_over_time_takes_a_crowd_as_empty_beyond_its_end():
    result = score(AgentsOverTime(), SOME, crowd_of([(0, 4)], frames=5), TEN)
    assert result.simulated == pytest.approx(0.5)


def test_agents_over_time_looks_at_the_frames_of_the_blocks_only():
    blocks = cut(np.array([[0, 2], [8, 10]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
    assert sample(AgentsOverTime(), SOME, blocks) == [[1, 1], [1, 1]]


def test_nobody_is_there_at_any_time():
    result = score(AgentsOverTime(), SOME, nobody(), TEN)
    assert result.simulated == 0
    assert result.distance == pytest.approx(1.0)


def test_agents_spread_is_the_standard_deviation_of_n():
    result = score(AgentsSpread(), SOME, crowd_of([(0, 4)], frames=10), TEN)
    assert result.recorded == pytest.approx(math.sqrt(0.56))
    assert result.simulated == pytest.approx(0.5)
    assert result.distance == pytest.approx(math.log((math.sqrt(0.56) + 0.05) / 0.55))


def test_a_constant_n_has_no_spread():
    assert score(AgentsSpread(), SOME, crowd_of([(0, 9)] * 7), TEN).simulated == 0


@given(any_crowds)
def test_autocorrelation_is_numpys_over_the_pairs_of_each_block(crowd):
    blocks = whole(130, block_s=200.0, dt_s=4.0)  # blocks of 43 or 44 frames
    n = np.r_[crowd.present(), np.zeros(130, int)]
    lags = []
    for lag_s in (10.0, 30.0, 60.0):
        lag = round(lag_s / 4.0)
        x = np.concatenate([n[start : stop - lag] for start, stop in blocks.frames])
        y = np.concatenate([n[start + lag : stop] for start, stop in blocks.frames])
        lags.append(np.corrcoef(x, y)[0, 1] if np.ptp(x) and np.ptp(y) else 0.0)
    result = score(Autocorrelation(), crowd, crowd, blocks)
    assert result.recorded == pytest.approx(np.mean(lags), abs=1e-9)
    assert result.n == 130 - 3 * round(10 / 4)


def test_autocorrelation_averages_the_differences_over_the_lags():
    # N alternates by 5 s: after 10 s it is the same again, after 15 s it would be the other.
    same = series([0, 1] * 8, dt_s=5.0)
    # N alternates by 10 s.
    other = series([0, 0, 1, 1] * 4, dt_s=5.0)
    result = score(Autocorrelation(), same, other, whole(16, dt_s=5.0))
    assert result.recorded == pytest.approx(1.0)  # at lags of 2, 6 and 12 frames
    assert result.simulated == pytest.approx((-1 - 1 + 1) / 3)
    assert result.distance == pytest.approx((2 + 2 + 0) / 3)


def test_a_constant_n_has_no_autocorrelation():
    crowd = crowd_of([(0, 99)] * 3)
    assert score(Autocorrelation(), crowd, crowd, whole(100)).recorded == 0


@pytest.mark.parametrize(
    ("block_s", "lags"), [(9.0, 0), (10.0, 0), (20.0, 1), (30.0, 1), (60.0, 2), (120.0, 3)]
)
def test_autocorrelation_takes_lags_shorter_than_the_blocks(block_s, lags):
    # Blocks are a frame longer or shorter than asked for: that must not let a lag in.
    blocks = whole(1813, block_s=block_s, dt_s=0.4)
    assert Autocorrelation().applies(blocks) == (lags > 0)
    if lags:
        statistics = Autocorrelation().summarise(SOME, blocks, PLACE)
        sums = {name: values.sum(axis=0) for name, values in statistics.items()}
        support = np.zeros(1, np.int64)
        weights = Autocorrelation().weights(sums, support, blocks)
        assert Autocorrelation().embed(sums, support, blocks).shape == (lags,)
        assert weights.tolist() == [1 / lags]


def test_one_long_block_among_short_ones_lets_no_lag_in():
    # A correlation at 60 s would stand on the pairs of a single block.
    short = [(start, start + 20) for start in range(0, 1000, 25)]
    blocks = cut(np.array([*short, (1000, 1064)]), block_s=80.0, dt_s=1.0, grid_s=1.0)
    crowd = series(np.random.default_rng(0).integers(0, 9, 1064).tolist())
    n = crowd.present()
    x = np.concatenate([n[a : b - 10] for a, b in blocks.frames])
    y = np.concatenate([n[a + 10 : b] for a, b in blocks.frames])
    assert score(Autocorrelation(), crowd, crowd, blocks).recorded == pytest.approx(
        np.corrcoef(x, y)[0, 1]
    )


def test_slow_correlations_go_beyond_the_blocks() -> None:
    values = np.random.default_rng(0).integers(0, 4, 700)
    values[120:] += values[:-120]
    crowd = series(values.tolist())
    blocks = cut(crowd.observed, block_s=50.0, dt_s=1.0, grid_s=1.0)
    metric = SlowAutocorrelation()
    sums = total(metric.summarise(crowd, blocks, PLACE))
    for lag in (120, 300):
        assert sums[f"lag {lag} s"][0] == 700 - lag
    found = metric.embed(sums, np.zeros(1, np.int64), blocks)
    expected = [np.corrcoef(values[lag:], values[:-lag])[0, 1] for lag in (120, 300)]
    np.testing.assert_allclose(found, expected)


def test_slow_correlations_leave_out_what_was_not_observed_even_of_simulated_crowds() -> None:
    values = np.random.default_rng(0).integers(0, 4, 900)
    crowd = series(values.tolist())  # all of it is observed
    gap = np.array([[0, 400], [450, 900]])
    blocks = cut(gap, block_s=50.0, dt_s=1.0, grid_s=1.0)
    sums = total(SlowAutocorrelation().summarise(crowd, blocks, PLACE))
    for lag in (120, 300):
        assert sums[f"lag {lag} s"][0] == 400 - lag + 450 - lag


def test_standing_is_a_share_of_the_time() -> None:
    walks = np.stack([0.48 * np.arange(20), np.zeros(20)], axis=1)
    xy = np.concatenate([walks, np.tile([0.0, 5.0], (20, 1))])
    crowd = crowd_of([(0, 19)] * 2, dt_s=0.4, xy=xy)
    found = StandingShare().summarise(crowd, whole(20, dt_s=0.4), PLACE)["share"]
    assert found.tolist() == [[20, 40]]
