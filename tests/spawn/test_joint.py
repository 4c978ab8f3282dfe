"""`joint-gmm`: one network for the arrivals at all areas."""

from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Literal

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from models import AREAS, GRID_S
from worlds import square

from crowdbench.data.blocks import SPLITS
from crowdbench.errors import SettingError, WeightsError
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.joint.kernels import features_of, recent_of
from crowdbench.spawn.joint.model import WEIGHTS, JointGMM
from crowdbench.spawn.joint.traces import (
    BINS,
    FEATURES,
    HALF,
    TAU_S,
    mean_traces,
    width_of,
)
from crowdbench.spawn.times.cox import lags, spread
from crowdbench.spawn.times.groups import kolmogorov_smirnov, rescaled

ETH = load_scene("eth-v0")
HIDDEN = 8


def random_joint(seed: int = 0, areas: int = 2, *, grid_s: float = GRID_S) -> JointGMM:
    rng = np.random.default_rng(seed)
    shapes = {
        "in_weight": (HIDDEN, FEATURES), "in_bias": (HIDDEN,), "weight": (HIDDEN, HIDDEN),
        "bias": (HIDDEN,), "out_weight": (2, HIDDEN), "out_bias": (2,),
        "own_in": (areas, HIDDEN), "own_out": (areas, 2),
    }  # fmt: skip
    weights = {n: rng.normal(0, 0.5, shape).astype(np.float32) for n, shape in shapes.items()}
    return JointGMM(
        AREAS,
        weights,
        rng.dirichlet(np.ones(BINS + 1))[:-1].astype(np.float32) / 2,
        rate_per_s=rng.uniform(0.05, 0.5, areas).astype(np.float32),
        log_rate=np.log(rng.uniform(0.05, 0.3, areas)).astype(np.float32),
        log_odds=rng.normal(-1, 0.5, areas).astype(np.float32),
        grid_s=grid_s,
    )


def arrivals_of_counts(counts: np.ndarray, grid_s: float = GRID_S) -> Arrivals:
    tick, area = np.nonzero(counts)
    times = counts[tick, area]
    window = np.array([[0, len(counts)]])
    return Arrivals(np.repeat(tick, times), np.repeat(area, times), window, counts.shape[1], grid_s)


COUNTS = st.lists(st.lists(st.integers(0, 3), min_size=2, max_size=2), min_size=1, max_size=40)


@given(COUNTS, st.sampled_from([0.1, GRID_S, 0.8, 1.6]))
def test_traces_are_weighted_numbers_of_past_arrivals(
    numbers: list[list[int]], grid_s: float
) -> None:
    counts, width, rate = np.array(numbers), width_of(grid_s), np.array([0.3, 0.02])
    steps = -(-len(counts) // width)
    found = np.empty((steps, 2, FEATURES))
    features_of(counts, width, width * grid_s, mean_traces(rate), found)
    for s, a, k in product(range(steps), range(2), range(len(TAU_S))):
        of_step = counts[: s * width].reshape(s, width, 2).sum(axis=1)
        age_s = (s - np.arange(s)) * width * grid_s
        weight = np.exp(-age_s / TAU_S[k])
        begin = rate * TAU_S[k] * np.exp(-s * width * grid_s / TAU_S[k])
        trace, mean = begin + weight @ of_step, rate * TAU_S[k]
        assert found[s, a, k] == pytest.approx(np.log((trace[a] + HALF) / (mean[a] + HALF)))
        common = np.log((trace.sum() + HALF) / (mean.sum() + HALF))
        assert found[s, a, len(TAU_S) + k] == pytest.approx(common)


@given(COUNTS, st.sampled_from([0.1, GRID_S, 0.8, 1.6, 7.0]))
def test_people_who_entered_before_are_counted_by_delay(
    numbers: list[list[int]], grid_s: float
) -> None:
    counts, of_lag = np.array(numbers), lags(grid_s)
    assert len(of_lag) == int(6.0 / grid_s + 1e-6)
    recent = np.empty((*counts.shape, BINS))
    recent_of(counts, of_lag, recent)
    share = np.linspace(0.05, 0.15, BINS)
    following = spread(share, grid_s)
    for t in range(len(counts)):
        due = sum(
            (following[h] * counts[t - 1 - h] for h in range(min(t, len(following)))), np.zeros(2)
        )
        np.testing.assert_allclose(recent[t] @ share, due, atol=1e-12)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_probabilities_of_all_numbers_sum_to_one(seed: int) -> None:
    model = random_joint(seed)
    most, total = 12, 0.0
    for numbers in product(range(most), repeat=2):
        for later in ((0, 0), (1, 0), (0, 2)):
            counts = np.array([numbers, later])
            log = model.log_likelihood(arrivals_of_counts(counts)) * max(1, counts.sum())
            first = model.log_likelihood(arrivals_of_counts(counts[:1])) * max(1, sum(numbers))
            assert log <= first + 1e-9
        total += np.exp(first)
    # Groups of 12 and more are missing.
    tail = (1 / (1 + np.exp(-model.log_odds.astype(float) - 2))).max() ** (most - 1)
    assert 1 - 2 * tail - 1e-9 <= total <= 1 + 1e-9


def test_samples_are_as_likely_as_the_model_says() -> None:
    """The frequency of arrivals in a sample is the mean of their probabilities, also given rates.

    If a model is true, no change of its rates makes a long sample more likely.
    """
    model = random_joint(5)
    counts = model.counts(60_000, np.random.default_rng(1))
    arrivals = arrivals_of_counts(counts)
    own = model.log_likelihood(arrivals)
    for name in ("log_rate", "log_odds"):
        for by in (-0.1, 0.1):
            other = replace(model, **{name: getattr(model, name) + np.float32(by)})
            assert other.log_likelihood(arrivals) < own - 1e-4
    fewer = replace(model, followers=model.followers * np.float32(0.7))
    assert fewer.log_likelihood(arrivals) < own - 1e-4
    weights = {n: -w if n == "own_out" else w for n, w in model.weights.items()}
    assert replace(model, weights=weights).log_likelihood(arrivals) < own - 1e-4


@pytest.mark.parametrize("what", ["gap", "size"])
def test_gaps_and_sizes_of_samples_are_uniform_after_time_rescaling(
    what: Literal["gap", "size"],
) -> None:
    model, rng = random_joint(5), np.random.default_rng(1)
    arrivals = arrivals_of_counts(model.counts(30_000, rng))
    halves = replace(arrivals, windows=np.array([[0, 12_000], [12_000, 30_000]]))
    residuals = rescaled(model, halves, rng, what)
    assert len(residuals) > 3_000
    assert kolmogorov_smirnov(residuals).p > 0.005
    other = replace(model, log_rate=model.log_rate + 0.2, log_odds=model.log_odds + 0.2)
    assert kolmogorov_smirnov(rescaled(other, halves, rng, what)).p < 0.005


def test_samples_are_people_on_the_grid_in_the_areas() -> None:
    model = random_joint(3)
    events = model.sample(120.0, ETH, np.random.default_rng(0))
    assert len(events) > 10
    assert 0 <= events.time_s.min() < events.time_s.max() < 120.0
    ticks = events.time_s / GRID_S
    np.testing.assert_allclose(ticks, np.round(ticks), atol=1e-9)
    again = model.sample(120.0, ETH, np.random.default_rng(0))
    assert np.array_equal(again.time_s, events.time_s)
    assert np.array_equal(again.start, events.start)


def test_a_rate_stays_within_its_bounds_whatever_the_weights() -> None:
    model = random_joint(2)
    wild = {name: 100 * array for name, array in model.weights.items()}
    model = replace(model, weights=wild, followers=np.zeros(BINS, np.float32))
    counts = model.counts(20_000, np.random.default_rng(0))
    groups = (counts > 0).mean(axis=0)
    most = 1 - np.exp(-np.exp(model.log_rate.astype(float) + 3))
    assert (groups <= most + 0.02).all()


def test_another_grid_is_refused() -> None:
    with pytest.raises(SettingError, match="grid"):
        random_joint().log_likelihood(arrivals_of_counts(np.zeros((5, 2), int), grid_s=0.7))


@pytest.fixture
def place(tmp_path: Path) -> Scene:
    (tmp_path / "scene.toml").write_bytes((ETH.folder / "scene.toml").read_bytes())
    fits = {
        split: [replace(random_joint(10 * k + f), steps=10 * k + f) for f in range(2)]
        for k, split in enumerate(SPLITS)
    }
    JointGMM.write(tmp_path, fits)
    return load_scene(tmp_path)


def test_fits_come_back_as_they_were(place: Scene) -> None:
    for k, split in enumerate(SPLITS):
        for fit in range(2):
            back, written = JointGMM.read(place, AREAS, split, fit), random_joint(10 * k + fit)
            for name in WEIGHTS:
                assert np.array_equal(back.weights[name], written.weights[name])
            for name in ("followers", "rate_per_s", "log_rate", "log_odds"):
                assert np.array_equal(getattr(back, name), getattr(written, name))
            assert back.steps == 10 * k + fit


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"followers": np.full(BINS, 0.3, np.float32)}, "numbers ≥ 0 with a sum below 1"),
        ({"rate_per_s": np.full(2, -1, np.float32)}, "rates ≥ 0"),
        ({"grid_s": 0.7}, "the step of the scene's grid"),
        ({"log_rate": np.full(2, np.nan, np.float32)}, "NaN or infinity"),
    ],
)
def test_impossible_fits_are_refused(place: Scene, wrong: dict[str, Any], message: str) -> None:
    model = replace(random_joint(), **wrong)
    JointGMM.write(place.folder, {split: [model] for split in SPLITS})
    with pytest.raises(WeightsError, match=message):
        JointGMM.read(place, AREAS)


def waves(points: int, seed: int, grid_s: float = GRID_S) -> Arrivals:
    """Arrivals at two areas that are busy at the same times, for a minute each two minutes."""
    rng = np.random.default_rng(seed)
    busy = (np.arange(points) * grid_s // 60) % 2 == 0
    rate = np.where(busy, 0.25, 0.02)[:, None] * [1.0, 0.5]
    return arrivals_of_counts(rng.poisson(rate), grid_s)


class TestTraining:
    """What needs torch."""

    @pytest.fixture(autouse=True)
    def torch(self) -> None:
        pytest.importorskip("torch")

    @given(st.integers(0, 2**32 - 1), COUNTS)
    @settings(max_examples=20, deadline=None)
    def test_torch_computes_what_the_kernels_compute(
        self, seed: int, numbers: list[list[int]]
    ) -> None:
        import torch

        from crowdbench.spawn.joint import places, training

        model, arrivals = random_joint(seed), arrivals_of_counts(np.array(numbers))
        place = places.Place.of(arrivals, arrivals, None)
        of = replace(
            model,
            log_rate=place.log_rate.numpy(),
            log_odds=place.log_odds.numpy(),
            rate_per_s=place.rate_per_s.astype(np.float32),
        )
        now = {name: torch.tensor(array) for name, array in model.weights.items()}
        rest = 1 - model.followers.sum() / training._MOST_FOLLOWERS
        share = model.followers / training._MOST_FOLLOWERS
        now["followers"] = torch.tensor(np.log(share / rest))
        found = float(training._log_probability(now, now, place)) / max(1, len(arrivals.tick))
        assert found == pytest.approx(of.log_likelihood(arrivals), rel=2e-4, abs=2e-4)

    def test_waves_that_areas_share_are_learned(self) -> None:
        from crowdbench.spawn.joint.training import JointSettings, fit, untaught

        scene = replace(square(10.0), protocol=ETH.protocol)
        arrivals, fresh = waves(6_000, 0), waves(6_000, 1)
        model = fit(
            arrivals, AREAS, scene, seed=0, trunk=untaught(0), settings=JointSettings(steps=200)
        )
        plain = fit(
            arrivals, AREAS, scene, seed=0, trunk=untaught(0), settings=JointSettings(steps=0)
        )
        assert model.steps > 0
        assert plain.steps == 0
        assert model.log_likelihood(fresh) > plain.log_likelihood(fresh) + 0.1
        counts = model.counts(50_000, np.random.default_rng(0))
        both = counts.reshape(-1, 50, 2).sum(axis=1)
        assert np.corrcoef(both.T)[0, 1] > 0.3
        recorded = len(arrivals.tick) / 6_000
        assert counts.sum() / 50_000 == pytest.approx(recorded, rel=0.15)

    def test_the_same_seed_gives_the_same_weights(self) -> None:
        from crowdbench.spawn.joint.training import JointSettings, fit, pretrained

        quick = JointSettings(steps=20, pretraining=5)
        arrivals = waves(1_500, 0)
        trunks = [pretrained([waves(1_500, 2)], seed=k, settings=quick) for k in (0, 0, 1)]
        fits = [fit(arrivals, AREAS, ETH, seed=0, trunk=t, settings=quick) for t in trunks]
        for name in WEIGHTS:
            assert np.array_equal(fits[0].weights[name], fits[1].weights[name])
        assert not np.array_equal(fits[0].weights["weight"], fits[2].weights["weight"])

    def test_other_places_teach_what_a_short_recording_cannot(self) -> None:
        from crowdbench.spawn.joint.training import JointSettings, fit, pretrained, untaught

        scene = replace(square(10.0), protocol=ETH.protocol)
        few, fresh = waves(600, 3), waves(6_000, 4)
        quick = JointSettings(steps=0, pretraining=150)
        trunk = pretrained([waves(6_000, 5), waves(6_000, 6)], seed=0, settings=quick)
        taught = fit(few, AREAS, scene, seed=0, trunk=trunk, settings=quick)
        alone = fit(few, AREAS, scene, seed=0, trunk=untaught(0), settings=quick)
        assert taught.log_likelihood(fresh) > alone.log_likelihood(fresh) + 0.05

    def test_what_reacts_too_strongly_to_its_own_past_is_punished(self) -> None:
        """The rate of groups rises as the power of a constant level that the weights say."""
        import torch

        from crowdbench.spawn.joint import places, training

        place = places.Place.of(waves(3_000, 0), waves(3_000, 0), None)
        names = {name: torch.tensor(of) for name, of in training.untaught(0).items()}
        names |= {"own_in": torch.zeros(2, 32), "own_out": torch.zeros(2, 2)}

        def punished(power: float) -> float:
            # Nearly linear in the mean of the common traces: tanh(0.01 x) / 0.01 ≈ x.
            in_weight, weight = torch.zeros(32, FEATURES), torch.zeros(32, 32)
            in_weight[0, len(TAU_S) : 2 * len(TAU_S)] = 0.01 / len(TAU_S)
            weight[0, 0], out_weight = 1.0, torch.zeros(2, 32)
            out_weight[0, 0] = 100 * power
            zero = {"in_bias": torch.zeros(32), "bias": torch.zeros(32)}
            now = {"in_weight": in_weight, "weight": weight, "out_weight": out_weight}
            return float(training._too_steep(names | zero | now, names, place, 0.9))

        assert punished(0.0) == 0.0
        assert punished(0.8) == 0.0
        assert punished(1.5) > 0.001
        assert punished(2.0) > 3 * punished(1.5)

    def test_quiet_steps_that_stand_for_others_hardly_change_the_sum(self) -> None:
        from crowdbench.spawn.joint import places

        tick = np.array([3, 4, 90, 700])
        used, length, at = places.used_steps(1_001, 2, tick, 7)
        assert length.sum() == pytest.approx(1_001)
        assert np.array_equal(used[at], tick // 2)
        assert len(used) < 80
        assert (length[at] == 2).all()

    @pytest.mark.parametrize("tick", [[], [3]])
    def test_next_to_nobody_to_learn_from(self, tick: list[int]) -> None:
        from crowdbench.spawn.joint.training import JointSettings, fit, untaught

        ticks = np.array(tick, dtype=np.int64)
        arrivals = Arrivals(ticks, np.zeros(len(ticks), np.int64), np.array([[0, 50]]), 2, GRID_S)
        model = fit(
            arrivals, AREAS, ETH, seed=0, trunk=untaught(0), settings=JointSettings(steps=10)
        )
        assert np.isfinite(model.log_likelihood(arrivals))
        assert len(model.sample(20.0, ETH, np.random.default_rng(0))) < 50
