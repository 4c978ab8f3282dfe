import math

import numpy as np
import pytest
from comparisons import nobody, sample, score, whole
from strategies import crowd_of

from crowdbench.data.blocks import cut
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Place, total
from crowdbench.metrics.arrivals import (
    FanoFactor10,
    FanoFactor60s,
    InterSpawn,
    InterSpawnPerArea,
    SpawnCounts,
    burstiness,
    memory,
)

TEN = whole(10)
TWENTY = whole(20, block_s=10.0)
TWO_AREAS = Place(spawn_areas=2, goal_areas=0, bounds_m=(0.0, 1.0, 0.0, 1.0))


def arriving(
    frames: int, at: list[int], area: list[int] | None = None, **options: float
) -> Trajectories:
    """People who enter at these frames, each for one frame."""
    persons = {"spawn_area": [0] * len(at) if area is None else area}
    return crowd_of([(t, t) for t in at], frames=frames, persons=persons, **options)


def entering_at(spawn_s: list[float], *, frames: int, dt_s: float, grid_s: float) -> Trajectories:
    first = [math.ceil(s / dt_s) for s in spawn_s]
    return crowd_of(
        [(t, t) for t in first],
        frames=frames,
        dt_s=dt_s,
        grid_s=grid_s,
        persons={"spawn_s": spawn_s},
    )


def poisson(seed: int, frames: int, rate: float) -> Trajectories:
    at = np.flatnonzero(np.random.default_rng(seed).poisson(rate, frames - 1)) + 1
    number = np.random.default_rng(seed).poisson(rate, frames - 1)[at - 1]
    return arriving(frames, np.repeat(at, number).tolist())


# Inter-spawn times


def test_inter_spawn_compares_gaps_between_arrivals():
    # One is there at the start. Arrivals at 2, 2, 6: gaps 0 and 4; at 1, 4, 7: gaps 3 and 3.
    some, other = arriving(10, [0, 2, 2, 6]), arriving(10, [1, 4, 7])
    assert sample(InterSpawn(), some, TEN) == [[0, 4]]
    assert sample(InterSpawn(), other, TEN) == [[3, 3]]
    result = score(InterSpawn(), some, other, TEN)
    assert result.recorded == pytest.approx(2.0)
    assert result.simulated == pytest.approx(3.0)
    assert result.distance == pytest.approx(((3 - 0) + (4 - 3)) / 2 / 2.0)
    assert (result.n, result.unit) == (2, "s")


def test_inter_spawn_takes_no_gap_between_two_blocks():
    crowd = arriving(20, [2, 4, 11, 12])
    assert sample(InterSpawn(), crowd, TWENTY) == [[2], [1]]


def test_inter_spawn_takes_no_gap_across_a_block_that_is_left_out():
    blocks = whole(30, block_s=10.0).take(np.array([0, 2]))
    assert sample(InterSpawn(), arriving(30, [2, 4, 15, 21, 24]), blocks) == [[2], [3]]


def test_inter_spawn_does_not_take_who_stands_in_an_opening_frame_for_an_arrival():
    blocks = cut(np.array([[0, 10], [12, 20]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
    crowd = crowd_of([(t, t) for t in (3, 12, 14, 17)], persons={"entered": [True] * 4})
    assert sample(InterSpawn(), crowd, blocks) == [[], [3]]


def test_inter_spawn_is_in_seconds():
    crowd = arriving(10, [2, 6], dt_s=0.4)
    assert score(InterSpawn(), crowd, crowd, whole(10, dt_s=0.4)).recorded == pytest.approx(1.6)


def test_inter_spawn_stands_on_an_annotation_grid_coarser_than_frames():
    # Frames 1, 2, 3, 5 of 0.4 s are seen at grid points 1, 1, 2, 3 of 0.8 s.
    crowd = arriving(10, [1, 2, 3, 5], dt_s=0.4, grid_s=0.8)
    blocks = whole(10, dt_s=0.4, grid_s=0.8)
    assert sample(InterSpawn(), crowd, blocks) == [[0, 1, 1]]
    assert score(InterSpawn(), crowd, crowd, blocks).recorded == pytest.approx(2 / 3 * 0.8)


def test_inter_spawn_stands_on_an_annotation_grid_finer_than_frames():
    # Grid points 6 (1.5 s), 8 and 12 (3 s) of 0.25 s.
    crowd = entering_at([1.3, 2.0, 2.9], frames=10, dt_s=1.0, grid_s=0.25)
    assert sample(InterSpawn(), crowd, whole(10, grid_s=0.25)) == [[2, 4]]


def test_both_crowds_stand_on_the_grid_of_the_blocks():
    recorded = arriving(10, [2, 4, 6], dt_s=0.4, grid_s=0.8)
    rollout = arriving(10, [1, 3, 5], dt_s=0.4)  # each half a grid step earlier
    assert score(InterSpawn(), recorded, rollout, whole(10, dt_s=0.4, grid_s=0.8)).distance == 0


def test_a_crowd_without_a_gap_has_gaps_of_a_block():
    result = score(InterSpawn(), arriving(10, [2, 4]), nobody(), TEN)
    assert result.simulated == 9.0  # without the opening frame
    assert result.distance == pytest.approx((9 - 2) / 2)
    assert result.n == 0


def test_a_distance_relative_to_nothing_is_infinite():
    assert score(InterSpawn(), arriving(10, [2, 2]), arriving(10, [2, 3]), TEN).distance == math.inf


def shape(crowd: Trajectories) -> tuple[float, float]:
    """Burstiness and memory."""
    blocks = whole(crowd.frames)
    statistics = InterSpawn().summarise(crowd, blocks, TWO_AREAS)
    (aligned,), support = InterSpawn().aligned([statistics], blocks)
    return burstiness(total(aligned), support), memory(total(aligned))


def test_clockwork_has_burstiness_minus_one():
    assert shape(arriving(100, list(range(5, 100, 5)))) == (-1.0, 0.0)


def test_poisson_arrivals_have_neither_burstiness_nor_memory():
    # About 20,000 gaps of 20 frames: standard errors are 0.004 and 0.007.
    b, m = shape(poisson(0, 400_000, 0.05))
    assert b == pytest.approx(0.0, abs=0.02)
    assert m == pytest.approx(0.0, abs=0.03)


def test_a_crowd_that_comes_at_once_and_once_more_is_bursty():
    # 99 gaps of 0 and one of 100: mean 1, standard deviation sqrt(99).
    b, _ = shape(arriving(200, [1] * 100 + [101]))
    assert b == pytest.approx((math.sqrt(99) - 1) / (math.sqrt(99) + 1))


def test_gaps_that_alternate_have_memory_minus_one():
    _, m = shape(arriving(20, [1, 2, 5, 6, 9, 10, 13]))
    assert m == pytest.approx(-1.0)


def test_memory_takes_no_pair_of_gaps_from_two_blocks():
    pairs = InterSpawn().summarise(arriving(20, [1, 3, 6, 11, 15, 16]), TWENTY, TWO_AREAS)["pairs"]
    assert pairs.tolist() == [[1, 2, 3, 6, 4, 9], [1, 4, 1, 4, 16, 1]]


# Inter-spawn times per area


def test_inter_spawn_per_area_weights_areas_by_their_share_of_recorded_gaps():
    # Area 0: gaps 2, 4 against 3, 3. Area 1: gap 6 against none, a block of 9.
    recorded = arriving(10, [1, 3, 7, 2, 8], [0, 0, 0, 1, 1])
    simulated = arriving(10, [1, 4, 7, 5], [0, 0, 0, 1])
    result = score(InterSpawnPerArea(), recorded, simulated, TEN, TWO_AREAS)
    assert result.distance == pytest.approx((2 / 3 * 1 + 1 / 3 * 3) / 4)
    assert (result.recorded, result.simulated) == (4.0, 3.0)
    assert result.n == 2


def test_inter_spawn_per_area_keeps_gaps_within_blocks_and_leaves_out_unknown_areas():
    crowd = arriving(20, [2, 3, 4, 8, 11, 12, 14], [0, 1, 0, -1, 0, -1, 0])
    metric = InterSpawnPerArea()
    assert sample(metric, crowd, TWENTY, TWO_AREAS, "area 0") == [[2], [3]]
    assert sample(metric, crowd, TWENTY, TWO_AREAS, "area 1") == [[], []]
    assert set(metric.summarise(crowd, TWENTY, TWO_AREAS)) == {"area 0", "area 1"}


def test_inter_spawn_per_area_is_inter_spawn_where_there_is_one_area():
    one = Place(spawn_areas=1, goal_areas=0, bounds_m=(0.0, 1.0, 0.0, 1.0))
    a, b = arriving(10, [1, 2, 7]), arriving(10, [2, 5, 9, 9])
    assert score(InterSpawnPerArea(), a, b, TEN, one).distance == pytest.approx(
        score(InterSpawn(), a, b, TEN).distance
    )


def test_a_recording_without_a_gap_in_any_area_has_gaps_of_a_block():
    lonely, other = arriving(10, [3, 5], [0, 1]), arriving(10, [2, 5, 3, 6], [0, 0, 1, 1])
    result = score(InterSpawnPerArea(), lonely, other, TEN, TWO_AREAS)
    assert result.recorded == 9.0
    assert result.distance == pytest.approx((9 - 3) / 9)


# Persons in ten frames


def test_spawn_counts_compare_arrivals_in_ten_frames():
    # After the opening frame three bins, from 1, 11 and 21; frame 31 is no whole bin.
    recorded = arriving(32, [1, 10, 20, 31])
    blocks = whole(32)
    assert sample(SpawnCounts(), recorded, blocks) == [[0, 1, 2]]
    simulated = arriving(32, [1, 1, 1, 1, 11, 21])
    result = score(SpawnCounts(), recorded, simulated, blocks)
    assert (result.recorded, result.simulated) == (1.0, 2.0)
    assert result.distance == pytest.approx((1 + 0 + 2) / 3)
    assert (result.n, result.unit) == (3, "persons")


def test_spawn_counts_begin_afresh_with_each_block():
    blocks = whole(30, block_s=15.0)  # bins from 1 and from 15
    crowd = arriving(30, [10, 11, 14, 15, 24, 25])
    assert sample(SpawnCounts(), crowd, blocks) == [[1], [2]]


def test_spawn_counts_of_a_block_too_short_for_a_bin_are_none():
    assert sample(SpawnCounts(), arriving(10, [3]), TEN) == [[]]


def test_ten_frames_are_five_steps_of_a_grid_twice_as_coarse():
    # Frames 9 and 10 stand at grid point 5, frame 11 at 6, the first of the second bin.
    crowd = arriving(22, [1, 9, 10, 11], dt_s=0.4, grid_s=0.8)
    blocks = whole(22, dt_s=0.4, grid_s=0.8)
    assert sample(SpawnCounts(), crowd, blocks) == [[1, 3]]


def test_ten_frames_are_forty_steps_of_the_forums_grid():
    # Arrivals count from 4/9 s, grid point 4, on: a bin is 4 to 43.
    crowd = entering_at([4 / 9, 43 / 9, 44 / 9], frames=21, dt_s=4 / 9, grid_s=1 / 9)
    assert sample(SpawnCounts(), crowd, whole(21, dt_s=4 / 9, grid_s=1 / 9)) == [[1, 2]]


# Fano factors


def test_the_fano_factor_is_variance_over_mean():
    recorded = arriving(31, [12, 12, 21, 22, 23, 24])  # 0, 2, 4
    steady = arriving(31, [1, 11, 21])
    result = score(FanoFactor10(), recorded, steady, whole(31))
    assert result.recorded == pytest.approx(8 / 3 / 2)
    assert result.simulated == 0
    assert result.distance == pytest.approx(math.log((4 / 3 + 0.05) / 0.05))
    assert result.n == 3


def test_where_nobody_enters_the_fano_factor_is_zero():
    assert score(FanoFactor10(), arriving(31, [1, 1, 11]), nobody(), whole(31)).simulated == 0


@pytest.mark.parametrize("metric", [FanoFactor10(), FanoFactor60s()], ids=lambda m: m.name)
def test_poisson_arrivals_have_fano_factor_one(metric):
    # 10,000 and 1,666 bins: standard errors are 0.014 and 0.035.
    crowd = poisson(1, 100_000, 0.5)
    result = score(metric, crowd, crowd, whole(100_000))
    assert result.recorded == pytest.approx(1.0, abs=0.1)
    assert result.distance == 0


def test_the_fano_factor_of_60_s_counts_minutes():
    # Minutes from 1 and 61 in the first block, from 130 and 190 in the second.
    blocks = whole(260, block_s=130.0)
    crowd = arriving(260, [1, 60, 61, 121, 130, 189, 190, 249, 250])
    assert sample(FanoFactor60s(), crowd, blocks) == [[1, 2], [2, 2]]
    assert score(FanoFactor60s(), crowd, crowd, blocks).recorded == pytest.approx(
        np.var([2, 1, 2, 2]) / np.mean([2, 1, 2, 2])
    )


def test_the_fano_factor_of_60_s_applies_from_blocks_of_two_minutes_on():
    assert not FanoFactor60s().applies(whole(1800, block_s=60.0, dt_s=0.4))
    assert FanoFactor60s().applies(whole(10_000, block_s=120.0, dt_s=0.4))
    assert FanoFactor60s().applies(whole(900, block_s=120.0, dt_s=0.4))


def test_areas_are_compared_with_themselves_in_whatever_order_a_file_has_them():
    rng = np.random.default_rng(0)
    place = Place(spawn_areas=12, goal_areas=1, bounds_m=(-1.0, 1.0, -1.0, 1.0))
    trips = [(int(t), int(t)) for t in np.sort(rng.integers(1, 400, 200))]
    crowd = crowd_of(
        trips, frames=400, persons={"spawn_area": (rng.integers(0, 12, 200) ** 2 // 12).tolist()}
    )
    blocks = cut(crowd.observed, block_s=100.0, dt_s=1.0, grid_s=1.0)
    metric = InterSpawnPerArea()
    statistics = metric.summarise(crowd, blocks, place)
    sorted_by_name = {name: statistics[name] for name in sorted(statistics)}
    assert list(sorted_by_name) != list(statistics)
    assert metric.compare(sorted_by_name, statistics, blocks).distance == 0


def test_areas_with_a_handful_of_gaps_do_not_count_beside_busy_ones():
    place = Place(spawn_areas=2, goal_areas=1, bounds_m=(-1.0, 1.0, -1.0, 1.0))
    blocks = cut(np.array([[0, 100]]), block_s=100.0, dt_s=1.0, grid_s=1.0)

    def crowd(*few: int) -> Trajectories:
        busy = list(range(2, 60, 4))
        trips = [(t, t) for t in sorted([*busy, *few])]
        area = [int(first in few) for first, _ in trips]
        return crowd_of(trips, frames=100, persons={"spawn_area": area})

    metric = InterSpawnPerArea()
    here, there = (metric.summarise(crowd(*few), blocks, place) for few in ((3, 5), (3, 95)))
    assert metric.compare(here, there, blocks).distance == 0
    assert metric.compare({"area 0": here["area 1"]}, {"area 0": there["area 1"]}, blocks).distance
