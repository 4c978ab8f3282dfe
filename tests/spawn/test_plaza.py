"""Who enters the plaza: samples follow the exact likelihood, which is that of all hidden paths."""

from itertools import pairwise, product

import numpy as np
import pytest
from plaza_truth import correlations, rates_per_s
from scipy.stats import binom

from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, PoissonGMM, SpawnEvents, arrivals_in, plaza

SCENE = load_scene("plaza-v0")
TRUTH = plaza.PlazaArrivals(SCENE)
LONG_S = 40_000.0


@pytest.fixture(scope="module")
def long() -> SpawnEvents:
    """Eleven hours of arrivals."""
    return TRUTH.sample(LONG_S, SCENE, np.random.default_rng(1))


def sampled(seed: int, horizon_s: float) -> Arrivals:
    events = TRUTH.sample(horizon_s, SCENE, np.random.default_rng(seed))
    return arrivals_in(events, horizon_s, SCENE.grid_s, 4)


def arrivals_of(counts: np.ndarray) -> Arrivals:
    ticks, areas = (np.repeat(x, counts.ravel()) for x in np.indices(counts.shape).reshape(2, -1))
    return Arrivals(ticks, areas, np.array([[0, len(counts)]]), 4, SCENE.grid_s)


def of_path(path: tuple[int, ...], stay_s: tuple[float, float]) -> float:
    """Probability of a path of a chain with two states."""
    leave = [1 - np.exp(-SCENE.grid_s / stay) for stay in stay_s]
    p = leave[1 - path[0]] / sum(leave)
    for before, after in pairwise(path):
        p *= leave[before] if before != after else 1 - leave[before]
    return float(p)


def of_number(n: int, before: int, earlier: int, enters: float) -> float:
    """Probability that n persons enter: late ones of the two frames before, and a new group."""
    total = 0.0
    for i, j in product(range(before + 1), range(earlier + 1)):
        late = binom.pmf(i, before, plaza.FOLLOWS) * binom.pmf(j, earlier, plaza.FOLLOWS)
        new = n - i - j
        if new == 0:
            total += late * (1 - enters)
        elif 0 < new <= len(plaza.SIZES):
            total += late * enters * plaza.SIZES[new - 1]
    return float(total)


def brute_force(counts: np.ndarray) -> float:
    """Log-probability of the counts, summed over all paths of the common chain and of each area.

    Given the common path, areas are independent.
    """
    frames = len(counts)
    paths = list(product((0, 1), repeat=frames))
    padded = np.concatenate([np.zeros((2, 4), int), counts])
    total = 0.0
    for rush in paths:
        p = of_path(rush, plaza.COMMON_STAY_S)
        for a in range(4):
            rate = plaza.FACTOR[:, None] * plaza.GROUPS_PER_S[a]
            enters = 1 - np.exp(-rate * SCENE.grid_s)
            each = [
                [
                    of_number(*padded[[t + 2, t + 1, t], a].tolist(), enters[rush[t], busy])
                    for busy in (0, 1)
                ]
                for t in range(frames)
            ]
            p *= sum(
                of_path(own, plaza.STAY_S) * np.prod([each[t][own[t]] for t in range(frames)])
                for own in paths
            )
        total += p
    return float(np.log(total))


@pytest.mark.parametrize("seed", range(3))
def test_the_likelihood_is_the_sum_over_all_hidden_paths(seed: int) -> None:
    counts = np.random.default_rng(seed).poisson(0.7, (5, 4))
    found = TRUTH.log_likelihood(arrivals_of(counts)) * counts.sum()
    assert found == pytest.approx(brute_force(counts), rel=1e-12)


def test_the_probabilities_of_all_numbers_of_a_frame_sum_to_one() -> None:
    total = 0.0
    for numbers in product(range(len(plaza.SIZES) + 1), repeat=4):
        counts = np.array([numbers])
        nats = TRUTH.log_likelihood(arrivals_of(counts)) * max(1, counts.sum())
        total += np.exp(nats)
    assert total == pytest.approx(1.0, abs=1e-12)


def test_more_people_than_any_group_has_are_impossible() -> None:
    counts = np.zeros((3, 4), int)
    counts[1, 2] = len(plaza.SIZES) + 1
    assert TRUTH.log_likelihood(arrivals_of(counts)) == -np.inf
    counts[0, 2] = 1  # who may be followed by one of them
    assert np.isfinite(TRUTH.log_likelihood(arrivals_of(counts)))


def test_windows_are_independent_stretches() -> None:
    windows = np.array([[0, 5], [9, 12]])
    ticks, areas = np.array([1, 3, 3, 10]), np.array([0, 2, 2, 1])
    whole = Arrivals(ticks, areas, windows, 4, SCENE.grid_s)
    parts = [
        Arrivals(ticks[:3], areas[:3], windows[:1], 4, SCENE.grid_s),
        Arrivals(ticks[3:], areas[3:], windows[1:], 4, SCENE.grid_s),
    ]
    total = sum(TRUTH.log_likelihood(part) * len(part.tick) for part in parts)
    assert TRUTH.log_likelihood(whole) * 4 == pytest.approx(total)


CHANGES = {
    "COMMON_STAY_S": lambda x: (plaza.COMMON_STAY_S[0] * np.exp(x), plaza.COMMON_STAY_S[1]),
    "STAY_S": lambda x: (plaza.STAY_S[0], plaza.STAY_S[1] * np.exp(x)),
    "FACTOR": lambda x: plaza.FACTOR * [1.0, np.exp(x)],
    "GROUPS_PER_S": lambda x: plaza.GROUPS_PER_S * [np.exp(x), 1.0],
    "SIZES": lambda x: plaza.SIZES + x * np.array([-0.2, 0.2, 0.0, 0.0, 0.0]),
    "FOLLOWS": lambda x: plaza.FOLLOWS * np.exp(x),
}
"""Each parameter of the process, changed by a small x."""


@pytest.fixture(scope="module")
def samples() -> list[Arrivals]:
    return [sampled(seed, 3_000.0) for seed in range(40)]


@pytest.mark.parametrize("name", CHANGES)
def test_samples_have_the_density_of_the_likelihood(
    name: str, samples: list[Arrivals], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The likelihood is exact: its slope with respect to each parameter has the mean 0."""
    step, nats = 0.05, {}
    for x in (-step, step):
        with monkeypatch.context() as patch:
            patch.setattr(plaza, name, CHANGES[name](x))
            other = plaza.PlazaArrivals(SCENE)
            nats[x] = np.array([other.log_likelihood(a) * len(a.tick) for a in samples])
    slope = (nats[step] - nats[-step]) / (2 * step)
    error = slope.std() / np.sqrt(len(slope))
    assert abs(slope.mean()) < 3.5 * error
    # Samples of a process in which x is 0.35 would be noticed: by the information equality, their
    # mean slope is about x times the variance of the slope.
    assert 3.5 * error < 0.35 * slope.var()


def test_samples_have_the_mean_rates(long: SpawnEvents) -> None:
    expected = rates_per_s(TRUTH) * LONG_S
    found = np.bincount(long.spawn_area, minlength=4)
    # Five standard errors by the counts of 1,000 s, which are all but independent.
    edges = [np.arange(5), np.arange(0, LONG_S + 1, 1000)]
    windows = np.histogram2d(long.spawn_area, long.time_s, bins=edges)[0]
    error = windows.std(axis=1) * np.sqrt(windows.shape[1])
    assert (np.abs(found - expected) < 5 * error).all()
    assert (error < 0.1 * expected).all()


def test_samples_have_the_pair_correlations(long: SpawnEvents) -> None:
    """Of persons in intervals of 4 s, at delays that are long compared with those of late ones."""
    step_s = 4.0
    edges = [np.arange(0, LONG_S + 1, step_s), np.arange(5)]
    n = np.histogram2d(long.time_s, long.spawn_area, bins=edges)[0]
    delays = np.array([8.0, 16.0, 40.0, 120.0])
    expected = correlations(TRUTH, delays)
    everyone, m = n.sum(axis=1), n.mean(axis=0)
    for delay_s, g in zip(delays.tolist(), expected, strict=True):
        lag = round(delay_s / step_s)
        found = n[:-lag].T @ n[lag:] / (len(n) - lag) / np.outer(m, m)
        same = np.eye(4, dtype=bool)
        assert found[same].mean() == pytest.approx(g[same].mean(), abs=0.2)
        assert found[~same].mean() == pytest.approx(g[~same].mean(), abs=0.12)
        pooled = (everyone[:-lag] * everyone[lag:]).mean() / everyone.mean() ** 2
        assert pooled == pytest.approx(m @ g @ m / m.sum() ** 2, abs=0.12)
    # The waves are common to all areas, and slower than what areas have of their own.
    assert (expected[1][~same] > 1.2).all()
    assert (expected[0][same] - expected[0].mean(axis=1) > 0.2).all()


def test_the_truth_explains_fresh_arrivals_better_than_poisson() -> None:
    fitted = PoissonGMM.fit(sampled(0, 1800.0), plaza.true_areas("plaza-v0"))
    margins = [
        TRUTH.log_likelihood(fresh) - fitted.log_likelihood(fresh)
        for fresh in (sampled(seed, 1800.0) for seed in range(1, 9))
    ]
    assert min(margins) > 0.3  # nats per person


def test_what_areas_have_in_common_is_worth_knowing(monkeypatch: pytest.MonkeyPatch) -> None:
    fresh = [sampled(seed, 3_600.0) for seed in range(4)]
    monkeypatch.setattr(plaza, "FACTOR", np.ones(2))
    calm = plaza.PlazaArrivals(SCENE)
    assert min(TRUTH.log_likelihood(a) - calm.log_likelihood(a) for a in fresh) > 0.01
