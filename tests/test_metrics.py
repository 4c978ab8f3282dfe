import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import wasserstein_distance
from strategies import crowd_of, crowds, later, reordered

from crowdbench.blocks import TimeBlocks, cut
from crowdbench.metrics import METRICS, AgentsOverTime, Dwell, InterSpawn, Metric, distance
from crowdbench.metrics.lattice import (
    histograms,
    kaplan_meier,
    mean,
    normalised,
    relative_wasserstein1,
    wasserstein1,
)
from crowdbench.trajectories import Trajectories

COUNTS = arrays(np.int64, st.integers(1, 12), elements=st.integers(0, 9))
BLOCK = cut(np.array([[0, 10]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
# One is there at the start, one stays to the end.
SOME = crowd_of([(0, 3), (2, 5), (2, 9), (6, 7)], frames=10)

each_metric = pytest.mark.parametrize("metric", METRICS, ids=lambda metric: metric.name)


def blocks_of(crowd: Trajectories, block_s: float = 8.0) -> TimeBlocks:
    return cut(crowd.observed, block_s=block_s, dt_s=crowd.dt_s, grid_s=crowd.grid_s)


def nobody() -> Trajectories:
    return replace(
        SOME,
        person_id=np.empty(0, np.int64),
        first=np.empty(0, np.int64),
        offsets=np.zeros(1, np.int64),
        xy=np.empty((0, 2), np.float32),
        **{
            name: getattr(SOME, name)[:0]
            for name in ("spawn_area", "goal_area", "entered", "left", "requested_s", "spawn_s")
        },
        outcome=SOME.outcome[:0],
    )


def test_agents_over_time_compares_the_distributions_of_n():
    # SOME has N = 1 in four frames, 2 in four and 3 in two; the other has 1 in all.
    result = distance(AgentsOverTime(), SOME, crowd_of([(0, 9)]), BLOCK)
    assert result.recorded == pytest.approx(1.8)
    assert result.simulated == pytest.approx(1.0)
    assert result.distance == pytest.approx(0.8 / 1.8)
    assert result.n == 10


def test_agents_over_time_counts_empty_frames():
    result = distance(AgentsOverTime(), SOME, crowd_of([(1, 5)], frames=10), BLOCK)
    assert result.simulated == pytest.approx(0.5)


def test_agents_over_time_takes_a_crowd_as_empty_beyond_its_end():
    result = distance(AgentsOverTime(), SOME, crowd_of([(0, 4)], frames=5), BLOCK)
    assert result.simulated == pytest.approx(0.5)


def test_agents_over_time_looks_at_observed_frames_only():
    blocks = cut(np.array([[0, 2], [8, 10]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
    assert distance(AgentsOverTime(), SOME, SOME, blocks).recorded == 1.0


def test_inter_spawn_compares_gaps_between_arrivals():
    # Arrivals at 2, 2, 6: gaps 0 and 4. The other's at 1, 4, 7: gaps 3 and 3.
    other = crowd_of([(1, 2), (4, 5), (7, 8)], frames=10)
    result = distance(InterSpawn(), SOME, other, BLOCK)
    assert result.recorded == pytest.approx(2.0)
    assert result.simulated == pytest.approx(3.0)
    assert result.distance == pytest.approx(((3 - 0) + (4 - 3)) / 2 / 2.0)
    assert result.n == 2


def test_inter_spawn_takes_no_gap_between_two_blocks():
    crowd = crowd_of([(2, 9), (4, 9), (11, 12), (12, 13)], frames=20)
    blocks = cut(crowd.observed, block_s=10.0, dt_s=1.0, grid_s=1.0)
    assert InterSpawn().summarise(crowd, blocks)["gaps"].tolist() == [[0, 0, 1], [0, 1, 0]]


def test_inter_spawn_is_in_seconds():
    crowd = crowd_of([(2, 9), (6, 9)], frames=10, dt_s=0.4)
    assert distance(InterSpawn(), crowd, crowd, blocks_of(crowd)).recorded == pytest.approx(1.6)


def test_dwell_is_kaplan_meiers_over_those_who_enter():
    # Lives of 3 and 1, and one of 7 that is cut off: a third of the mass each.
    result = distance(Dwell(), SOME, crowd_of([(1, 3)], frames=10), BLOCK)
    assert result.recorded == pytest.approx(11 / 3)
    assert result.simulated == pytest.approx(2.0)
    assert result.distance == pytest.approx((1 + 1 + 5) / 3 / (11 / 3))
    assert result.n == 1


def test_dwell_follows_lives_past_their_block():
    crowd = crowd_of([(2, 15), (11, 12)], frames=20)
    blocks = cut(crowd.observed, block_s=10.0, dt_s=1.0, grid_s=1.0)
    ended = Dwell().summarise(crowd, blocks)["ended"]
    assert [np.flatnonzero(row).tolist() for row in ended] == [[13], [1]]


@each_metric
@given(crowd=crowds())
def test_a_crowd_has_no_distance_to_itself(metric: Metric, crowd: Trajectories):
    assert distance(metric, crowd, crowd, blocks_of(crowd)).distance == 0


@each_metric
@given(crowd=crowds(dt_s=0.4), data=st.data())
def test_the_order_of_persons_changes_nothing(metric: Metric, crowd: Trajectories, data):
    shuffled = reordered(crowd, data.draw(st.permutations(range(len(crowd)))))
    assert distance(metric, crowd, shuffled, blocks_of(crowd)).distance == 0


@each_metric
@given(crowd=crowds(dt_s=0.4), other=crowds(dt_s=0.4), half=st.integers(0, 5000))
def test_a_shift_of_both_sides_and_blocks_changes_nothing(metric, crowd, other, half):
    frames = 2 * half  # whole steps of an annotation grid of two frames
    here = distance(metric, crowd, other, blocks_of(crowd))
    there = distance(
        metric, later(crowd, frames), later(other, frames), blocks_of(later(crowd, frames))
    )
    assert here == there


@each_metric
def test_a_crowd_that_differs_has_a_distance(metric: Metric):
    other = crowd_of([(1, 1), (8, 8)], frames=10)
    assert distance(metric, SOME, other, BLOCK).distance > 0


def test_nobody_counts_as_gaps_of_a_block():
    assert distance(InterSpawn(), SOME, nobody(), BLOCK).simulated == 9.0  # the opening frame
    assert distance(InterSpawn(), SOME, nobody(), BLOCK).n == 0


def test_nobody_counts_as_dwelling_a_block():
    assert distance(Dwell(), SOME, nobody(), BLOCK).simulated == 10.0
    assert distance(Dwell(), SOME, nobody(), BLOCK).n == 0


def test_nobody_is_there_at_any_time():
    assert distance(AgentsOverTime(), SOME, nobody(), BLOCK).distance == pytest.approx(1.0)


@each_metric
def test_nobody_has_no_distance_to_nobody(metric: Metric):
    assert distance(metric, nobody(), nobody(), BLOCK).distance == 0


@given(COUNTS.filter(np.any), COUNTS.filter(np.any))
def test_wasserstein_is_that_of_scipy(p, q):
    expected = wasserstein_distance(np.arange(len(p)), np.arange(len(q)), p, q)
    got = wasserstein1(normalised(p, if_empty=0), normalised(q, if_empty=0))
    assert got == pytest.approx(expected, abs=1e-12)


def test_a_distance_relative_to_nothing_is_infinite():
    assert relative_wasserstein1(np.array([1.0]), np.array([0.0, 1.0])) == math.inf


def test_histograms_count_per_block():
    counts = histograms(np.array([0, 2, 2, 1]), np.array([0, 0, 2, 2]), 3)
    assert counts.tolist() == [[1, 0, 1], [0, 0, 0], [0, 1, 1]]


def test_an_empty_sample_is_a_point_mass():
    assert normalised(np.zeros(4, dtype=np.int64), if_empty=2).tolist() == [0, 0, 1]


def test_kaplan_meier_gives_the_textbooks_survival_curve():
    # Weeks of remission under 6-MP (Freireich et al. 1963; table 1.1 of Cox & Oakes 1984).
    ended = [6, 6, 6, 7, 10, 13, 16, 22, 23]
    censored = [6, 9, 10, 11, 17, 19, 20, 25, 32, 32, 34, 35]
    p = kaplan_meier(np.bincount(ended, minlength=36), np.bincount(censored, minlength=36))
    survival = 1 - np.cumsum(p)
    textbook = {6: 0.857, 7: 0.807, 10: 0.753, 13: 0.690, 16: 0.627, 22: 0.538, 23: 0.448}
    assert {week: round(float(survival[week]), 3) for week in textbook} == textbook


def test_mass_that_no_event_claims_stands_at_the_longest_life():
    assert kaplan_meier(np.array([0, 1, 0]), np.array([0, 0, 1])).tolist() == [0, 0.5, 0.5]


@given(COUNTS.filter(np.any))
def test_kaplan_meier_without_censoring_is_the_empirical_distribution(ended):
    np.testing.assert_allclose(
        kaplan_meier(ended, np.zeros_like(ended)), ended / ended.sum(), atol=1e-12
    )


@given(COUNTS, st.data())
def test_kaplan_meier_is_a_distribution_that_censoring_moves_up(ended, data):
    elements = st.integers(0, 9)
    censored = data.draw(arrays(np.int64, len(ended), elements=elements).filter(np.any))
    p = kaplan_meier(ended, censored)
    assert p.sum() == pytest.approx(1)
    lives = (ended + censored) / (ended + censored).sum()
    assert mean(p) >= mean(lives) - 1e-9  # a censored life is at least as long as it was seen
