"""Energy scores, floors, resamples, scores and ranks."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.distance import cdist

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.metrics import Statistics
from crowdbench.metrics.arrivals import FanoFactor10
from crowdbench.metrics.presence import AgentsOverTime, Autocorrelation
from crowdbench.scoring.energy import RESAMPLES, Draws, Energy, FloorDraws, energy, floor
from crowdbench.scoring.l1_kernel import l1_distances
from crowdbench.scoring.score import (
    Score,
    combined,
    crowd_score,
    family_scores,
    overall_score,
    ranks,
    score_of,
    total_score,
    walk_score,
)

N = AgentsOverTime()


def blocks_of(count: int) -> TimeBlocks:
    return cut(np.array([[0, 10 * count]]), block_s=10.0, dt_s=1.0, grid_s=1.0)


def draws_of(blocks: TimeBlocks, resample_s: float = 10.0) -> Draws:
    return Draws.of(blocks, resample_s=resample_s, block_s=10.0, seed=(0,))


def floor_draws(blocks: TimeBlocks) -> FloorDraws:
    draws = draws_of(blocks)
    return FloorDraws.of(draws, [(np.arange(len(blocks)), draws)])


def steady(*persons: int) -> Statistics:
    """A crowd with so many persons all through each block."""
    counts = np.zeros((len(persons), max(persons) + 1), dtype=np.int64)
    counts[np.arange(len(persons)), persons] = 10
    return {"counts": counts}


def flat(value: float, spread: float = 0.0, seed: int = 0) -> Energy:
    """An energy score whose resamples scatter around it."""
    noise = np.random.default_rng(seed).standard_normal(RESAMPLES)
    return Energy(value, value + spread * noise)


def test_the_energy_score_is_the_mean_distance_less_half_the_rollouts_own():
    # d(2, 1) = 1, d(4, 1) = 3, d(2, 4) = 2, in units of the recorded mean of 1.
    blocks = blocks_of(1)
    es = energy(N, steady(1), [[steady(2), steady(4)]], blocks, draws_of(blocks))
    assert es is not None
    assert es.centre == pytest.approx((1 + 3) / 2 - 2 / 2)


def test_a_coin_between_two_wrong_ways_gains_nothing_without_the_second_term():
    blocks = blocks_of(1)
    draws = draws_of(blocks)
    one, other = steady(2), steady(4)
    es = [
        energy(N, steady(3), [rollouts], blocks, draws, spread=False)
        for rollouts in ([one, one], [one, other])
    ]
    assert es[0] is not None
    assert es[1] is not None
    assert es[1].centre == pytest.approx(es[0].centre)
    np.testing.assert_allclose(es[1].resampled, es[0].resampled)


def test_only_rollouts_of_one_fit_are_compared_with_each_other():
    blocks = blocks_of(1)
    fits = [[steady(2), steady(2)], [steady(4), steady(4)]]
    es = energy(N, steady(1), fits, blocks, draws_of(blocks))
    assert es is not None
    assert es.centre == pytest.approx((1 + 3) / 2)


def test_a_single_rollout_stands_for_a_model_without_chance():
    blocks = blocks_of(1)
    es = energy(N, steady(1), [[steady(3)]], blocks, draws_of(blocks))
    assert es is not None
    assert es.centre == pytest.approx(2.0)
    np.testing.assert_allclose(es.resampled, 2.0)


def test_resamples_count_blocks_as_often_as_they_were_drawn():
    blocks = blocks_of(2)
    draws = draws_of(blocks)
    es = energy(N, steady(1, 3), [[steady(1, 5)]], blocks, draws)
    assert es is not None
    assert es.centre == pytest.approx((0 + 2) / 2 / 2)
    # W1 grows with the share of the second block; the divisor stays the whole recording's mean.
    np.testing.assert_allclose(es.resampled, draws.blocks[:, 1] / 2 * 2 / 2)


def test_resamples_of_rollouts_and_fits_scatter_around_the_centre():
    blocks = blocks_of(1)
    fits = [[steady(1 + i), steady(2 + i), steady(3 + i)] for i in range(5)]
    es = energy(N, steady(1), fits, blocks, draws_of(blocks))
    assert es is not None
    means = [np.mean([i, i + 1, i + 2]) for i in range(5)]
    assert es.centre == pytest.approx(np.mean(means) - (4 / 3) / 2)
    # The five fits' means differ by 1 each: resampling them has that standard error at least.
    assert es.resampled.std() > 0.9 * np.std(means) / np.sqrt(5)


def test_a_metric_without_a_scale_has_no_energy():
    blocks = blocks_of(1)
    nobody = {"counts": np.array([[10]])}
    assert energy(N, nobody, [[steady(1)]], blocks, draws_of(blocks)) is None
    assert floor(N, nobody, nobody, blocks, floor_draws(blocks)) is None


def test_the_floor_is_half_the_mean_distance_of_two_resamples():
    blocks = blocks_of(2)
    draws = floor_draws(blocks)
    found = floor(N, steady(1, 3), steady(1, 3), blocks, draws)
    assert found is not None
    # Drawn twice out of {1, 3}, the mean is 1, 2, 2 or 3: E|a − b| = 3/4, divided by the mean 2.
    assert found.centre == pytest.approx(0.75 / 2 / 2, rel=0.1)
    # Of a resample that is one block twice there is nothing to vary.
    alone = (draws.blocks == 2).any(axis=1)
    assert (found.resampled[alone] == 0).all()
    assert found.resampled[~alone].mean() == pytest.approx(0.75 / 2 / 2, rel=0.1)


def test_a_steady_recording_has_no_floor():
    blocks = blocks_of(3)
    two = steady(2, 2, 2)
    found = floor(N, two, two, blocks, floor_draws(blocks))
    assert found is not None
    assert found.centre == 0


def test_the_floor_of_a_fold_is_the_true_process_s_energy_score():
    """Six blocks are resampled from all eighteen: from six alone F would be a sixth too small."""
    rng = np.random.default_rng(3)
    whole = blocks_of(18)
    fold = np.arange(18) % 3 == 0
    blocks = whole.take(fold)
    folds = [np.flatnonzero(np.arange(18) % 3 == k) for k in range(3)]
    everyone = [(index, draws_of(whole.take(index))) for index in folds]
    of_floor = FloorDraws.of(everyone[0][1], everyone)
    floors, truth = [], []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench.scoring.energy.RESAMPLES", 1)
        for _ in range(150):
            y, x = (crowd_like(rng, 18, 2.0, 18.0) for _ in range(2))
            in_fold = {"counts": y["counts"][fold]}
            found = floor(N, y, in_fold, blocks, of_floor)
            assert found is not None
            floors.append(found.centre)
            truth.append(N.compare(in_fold, {"counts": x["counts"][fold]}, blocks).distance / 2)
    assert np.mean(floors) == pytest.approx(np.mean(truth), rel=0.1)


def test_a_fold_s_floor_is_drawn_from_all_folds_as_long_as_the_fold():
    whole = blocks_of(7)
    folds = [np.flatnonzero(np.arange(7) % 3 == k) for k in range(3)]
    everyone = [(index, draws_of(whole.take(index))) for index in folds]
    draws = FloorDraws.of(everyone[1][1], everyone)
    assert draws.order.tolist() == [0, 3, 6, 1, 4, 2, 5]
    assert (draws.centre().sum(axis=1) == 2).all()
    assert (draws.centre().sum(axis=0) > 0).all()
    for r in range(20):
        nested = draws.nested(r)
        assert (nested.sum(axis=1) == 2).all()
        assert (nested[:, draws.blocks[r] == 0] == 0).all()


def test_runs_are_drawn_whole_and_as_many_as_there_are():
    blocks = blocks_of(7)
    draws = draws_of(blocks, resample_s=30.0)
    assert draws.runs.tolist() == [3, 3, 1]
    for start, stop in ((0, 3), (3, 6), (6, 7)):
        assert (draws.blocks[:, start:stop] == draws.blocks[:, [start]]).all()
    assert (draws.blocks[:, [0, 3, 6]].sum(axis=1) == 3).all()
    np.testing.assert_allclose(draws.blocks.mean(axis=0), 1, atol=0.1)


def test_everyone_is_measured_on_the_same_resamples():
    a, b = draws_of(blocks_of(5)), draws_of(blocks_of(5))
    assert (a.blocks == b.blocks).all()
    assert (a.fits(5) == b.fits(5)).all()
    assert (a.rollouts(5, 6) == b.rollouts(5, 6)).all()


def test_parts_have_resamples_of_their_own():
    blocks = blocks_of(5)
    other = Draws.of(blocks, resample_s=10.0, block_s=10.0, seed=(1,))
    assert (other.blocks != draws_of(blocks).blocks).any()


@given(arrays(np.float64, (3, 2, 4, 5), elements=st.floats(-9, 9)), st.data())
def test_the_kernel_computes_city_block_distances(x, data):
    y = data.draw(arrays(np.float64, (3, 5), elements=st.floats(-9, 9)))
    to_y, between = l1_distances(y, x)
    for r in range(3):
        for g in range(2):
            np.testing.assert_allclose(to_y[r, g], cdist(x[r, g], y[[r]], "cityblock")[:, 0])
            np.testing.assert_allclose(between[r, g], cdist(x[r, g], x[r, g], "cityblock"))


def crowd_like(rng: np.random.Generator, blocks: int, low: float, high: float) -> Statistics:
    """N in each of a block's ten frames about a level that differs from block to block."""
    level = rng.uniform(low, high, blocks)
    values = rng.poisson(np.repeat(level, 10)).reshape(blocks, 10)
    return {"counts": np.stack([np.bincount(v, minlength=40) for v in values])}


def test_the_energy_score_prefers_the_truth_where_the_plain_distance_does_not():
    rng = np.random.default_rng(1)
    blocks = blocks_of(4)
    draws = draws_of(blocks)

    def scores(low: float, high: float) -> tuple[float, float]:
        """Mean plain distance and energy score of a model against recordings of the truth."""
        plain, proper = [], []
        for y in recordings:
            x = [crowd_like(rng, 4, low, high) for _ in range(8)]
            plain.append(np.mean([N.compare(y, one, blocks).distance for one in x]))
            es = energy(N, y, [x], blocks, replace(draws, blocks=draws.blocks[:1]))
            assert es is not None
            proper.append(es.centre)
        return float(np.mean(plain)), float(np.mean(proper))

    recordings = [crowd_like(rng, 4, 2.0, 18.0) for _ in range(60)]
    with pytest.MonkeyPatch.context() as patch:  # the resamples are not looked at
        patch.setattr("crowdbench.scoring.energy.RESAMPLES", 1)
        true_plain, true_proper = scores(2.0, 18.0)
        narrow_plain, narrow_proper = scores(7.0, 13.0)
    assert narrow_plain < true_plain
    assert true_proper < narrow_proper


def test_the_anchor_scores_zero_in_every_resample():
    anchor, floor_ = flat(0.5, 0.1), flat(0.1, 0.02, seed=1)
    score = score_of(anchor, floor_, anchor)
    assert score is not None
    assert score.value == pytest.approx(0)
    np.testing.assert_allclose(score.resampled, 0, atol=1e-12)


def test_the_floor_scores_one():
    score = score_of(flat(0.1), flat(0.1), flat(0.5))
    assert score is not None
    assert score.value == pytest.approx(1)


def test_scores_are_cut_below_and_never_above():
    below = score_of(flat(9.0), flat(0.1), flat(0.5))
    above = score_of(flat(0.0), flat(0.3), flat(0.5))
    assert below is not None
    assert above is not None
    assert below.value == -1
    assert (below.resampled == -1).all()
    assert above.value == pytest.approx(2.5)


def test_a_score_that_is_cut_is_certain_however_the_anchor_scatters():
    score = score_of(flat(5.0, 0.5), flat(0.1, 0.05, 1), flat(0.5, 0.2, 2))
    assert score is not None
    assert score.interval == (-1, -1)


def test_a_rollout_drawn_twice_is_no_pair():
    # Two rollouts 2 apart: half the resamples draw one of them twice, and pairs stay 2 apart.
    blocks = blocks_of(1)
    es = energy(N, steady(3), [[steady(2), steady(4)]], blocks, draws_of(blocks))
    assert es is not None
    np.testing.assert_allclose(es.resampled, es.centre)


def test_an_anchor_at_the_floor_tells_nothing():
    assert score_of(flat(0.1), flat(0.5), flat(0.5)) is None


@given(st.floats(0.01, 0.2), st.floats(0.3, 0.9), st.floats(0.0, 1.0))
def test_for_small_scatter_resamples_follow_the_ratio(f, a, es):
    triple = [flat(v, 1e-6, seed) for seed, v in enumerate((es, f, a))]
    score = score_of(*triple)
    assert score is not None
    if score.value == -1:
        return
    e, f_r, a_r = (t.centre + t.deviations() for t in triple)
    np.testing.assert_allclose(
        score.resampled, np.maximum(-1, 1 - (e - f_r) / (a_r - f_r)), atol=1e-6
    )


def test_the_interval_holds_95_percent():
    score = Score(0.0, np.linspace(-1, 1, RESAMPLES))
    assert score.interval == pytest.approx((-0.95, 0.95), abs=0.01)


def test_families_are_means_of_their_scored_metrics():
    scores = {"inter_spawn": flat_score(0.2), "fano_10_frames": flat_score(0.6),
              "dwell": flat_score(1.0), "speed": None}  # fmt: skip
    families = family_scores(scores, ["inter_spawn", "fano_10_frames", "speed"])
    assert {f: s.value for f, s in families.items()} == {"arrivals": pytest.approx(0.4)}


def test_the_overall_score_is_the_mean_of_crowd_and_walk():
    families = {"arrivals": flat_score(0.0), "space": flat_score(1.0), "motion": flat_score(0.8)}
    crowd, walk = crowd_score(families), walk_score(families, passes=True)
    whole = overall_score(crowd, walk)
    assert crowd is not None
    assert whole is not None
    assert crowd.value == pytest.approx(0.5)
    assert whole.value == pytest.approx(0.65)
    assert overall_score(crowd, None) is None
    assert combined([]) is None


def test_walk_is_the_lesser_of_its_families_in_each_resample():
    families = {"motion": flat_score(0.8, 0.5, 1), "interaction": flat_score(0.6, 0.5, 2)}
    walk = walk_score(families, passes=True)
    assert walk is not None
    assert walk.value == 0.6
    both = np.stack([score.resampled for score in families.values()])
    np.testing.assert_array_equal(walk.resampled, both.min(axis=0))
    assert walk_score({"space": flat_score(0.5)}, passes=True) is None


@pytest.mark.parametrize(("value", "gated"), [(0.7, 0.0), (-0.4, -0.4)])
def test_beyond_the_gate_walk_is_at_most_0(value: float, gated: float):
    families = {"motion": flat_score(0.9), "interaction": flat_score(value, 0.5)}
    walk = walk_score(families, passes=False)
    assert walk is not None
    assert walk.value == gated
    assert walk.resampled.max() <= 0


def test_a_total_is_of_what_there_is():
    crowd = {"arrivals": flat_score(0.2), "space": flat_score(0.6)}
    walk = {"motion": flat_score(0.9), "interaction": flat_score(0.7)}
    totals = [total_score(f, passes=True) for f in (crowd, walk, crowd | walk, {})]
    assert [t and round(t.value, 6) for t in totals] == [0.4, 0.7, 0.55, None]


def flat_score(value: float, spread: float = 0.0, seed: int = 0) -> Score:
    return Score(value, flat(value, spread, seed).resampled)


def test_ranks_count_who_is_significantly_better():
    scores = [flat_score(v, 0.01, seed) for seed, v in enumerate((0.1, 0.5, 0.505, 0.9))]
    assert ranks(scores) == [4, 2, 2, 1]


def test_entries_are_compared_pair_by_pair():
    # Both scatter widely, but together: the difference is certain.
    low, noise = flat_score(0.5, 0.5), flat(0.0, 0.5).resampled
    assert ranks([low, Score(0.52, 0.52 + noise)]) == [2, 1]
    assert ranks([low, flat_score(0.52, 0.5, seed=1)]) == [1, 1]


def test_equals_are_tied():
    assert ranks([flat_score(0.3, 0.1), flat_score(0.3, 0.1)]) == [1, 1]
    assert ranks([flat_score(0.3)]) == [1]
    assert ranks([]) == []


def test_holm_asks_for_more_among_many():
    # 2.3 standard errors: p = .02 is enough for one comparison, not for one in six.
    pair = [flat_score(0.0), flat_score(2.3, 1.0)]
    assert ranks(pair) == [2, 1]
    middle = [flat_score(1.15, 1.0, seed) for seed in (1, 2)]
    assert ranks([*pair, *middle]) == [1, 1, 1, 1]


def test_every_block_is_in_one_run():
    assert draws_of(blocks_of(9), 40.0).runs.tolist() == [4, 4, 1]


@pytest.mark.parametrize("metric", [FanoFactor10(), Autocorrelation()], ids=lambda m: m.name)
def test_other_forms_have_energies_too(metric):
    blocks = cut(np.array([[0, 80]]), block_s=40.0, dt_s=1.0, grid_s=1.0)
    rng = np.random.default_rng(0)
    lags = {"lag 10 s", "lag 30 s"}

    def some() -> Statistics:
        if metric.name == "autocorrelation":
            x = rng.integers(0, 9, (2, 20))
            terms = np.stack([np.ones_like(x), x, x[:, ::-1], x * x[:, ::-1], x**2, x**2], axis=2)
            return {lag: terms.sum(axis=1) for lag in sorted(lags)}
        return {"counts": rng.integers(0, 9, (2, 6))}

    es = energy(metric, some(), [[some(), some()], [some(), some()]], blocks, draws_of(blocks))
    assert es is not None
    assert np.isfinite(es.resampled).all()
    assert es.resampled.std() > 0
