"""Time rescaling: residuals are uniform exactly where the model is the truth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from models import GRID_S, arrivals_at, poisson, random_ntpp, renewal

from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, arrivals_in
from crowdbench.spawn.times.groups import kolmogorov_smirnov, rescaled, spells_of

ETH = load_scene("eth-v0")
FORGETFUL = replace(random_ntpp(), memory=4)  # of about three gaps one is longer
MODELS = {
    "poisson": poisson(),
    "renewal": renewal(),
    "ntpp": random_ntpp(),
    "another ntpp": random_ntpp(seed=1),
    "a forgetful ntpp": FORGETFUL,
    "a ntpp that forgets at once": replace(random_ntpp(seed=1), memory=1),
}


def sampled(model: Any, horizon_s: float = 20_000.0, seed: int = 0) -> Arrivals:
    events = model.sample(horizon_s, ETH, np.random.default_rng(seed))
    return arrivals_in(events, horizon_s, GRID_S, 2)


@pytest.mark.parametrize("what", ["gap", "size"])
@pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)
def test_samples_follow_their_own_density(model: Any, what: Any) -> None:
    found = kolmogorov_smirnov(rescaled(model, sampled(model), np.random.default_rng(1), what))
    assert found.n > 2000
    assert found.p > 0.001


@pytest.mark.parametrize(
    "model", [renewal(), random_ntpp(), FORGETFUL], ids=["renewal", "ntpp", "forgetful"]
)
def test_many_short_samples_follow_it_too(model: Any) -> None:
    # Waits from a start and unfinished gaps are most of what is seen in 16 s.
    rng = np.random.default_rng(2)
    tick, area, windows = [], [], []
    for k in range(600):
        events = model.sample(16.0, ETH, rng)
        tick.append(np.round(events.time_s / GRID_S).astype(np.int64) + 50 * k)
        area.append(events.spawn_area.astype(np.int64))
        windows.append((50 * k, 50 * k + 40))
    arrivals = Arrivals(np.concatenate(tick), np.concatenate(area), np.array(windows), 2, GRID_S)
    assert kolmogorov_smirnov(rescaled(model, arrivals, rng)).p > 0.001


def slower(model: Any) -> Any:
    if hasattr(model, "scale_s"):
        return replace(model, scale_s=model.scale_s * 1.5)
    base = model.weights["base"] + np.array([0, np.log(1.5), 0], np.float32)
    return replace(model, weights={**model.weights, "base": base})


@pytest.mark.parametrize("model", [renewal(), random_ntpp()], ids=["renewal", "ntpp"])
def test_a_model_of_longer_gaps_is_found_out(model: Any) -> None:
    arrivals = sampled(model)
    other = slower(model)
    assert kolmogorov_smirnov(rescaled(other, arrivals, np.random.default_rng(3))).p < 1e-6


def test_a_model_that_does_not_forget_is_found_out_by_silences() -> None:
    arrivals = sampled(FORGETFUL)
    gap = spells_of(arrivals).gap
    assert (gap > 4).mean() > 0.2
    assert (gap > 8).sum() > 200
    other = rescaled(random_ntpp(), arrivals, np.random.default_rng(3))
    assert kolmogorov_smirnov(other).p < 1e-6


def test_poisson_is_found_out_by_groups() -> None:
    arrivals = sampled(renewal())
    sizes = rescaled(poisson(), arrivals, np.random.default_rng(4), "size")
    assert kolmogorov_smirnov(sizes).p < 1e-6


def test_unfinished_gaps_count_towards_the_next() -> None:
    # Nobody in the first stretch, one at the first point of the second: by Poisson's hazard, all
    # points of the first and the whole or a part of one of the second were spent.
    model = poisson()
    hazard = 0.5 * GRID_S
    arrivals = arrivals_at([10], [0], [(0, 7), (10, 20)])
    u = rescaled(model, arrivals, np.random.default_rng(5))
    spent = -np.log1p(-u[0])
    assert 7 * hazard <= spent <= 8 * hazard


def test_residuals_depend_on_the_generator_alone() -> None:
    model = renewal()
    arrivals = sampled(model, 400.0)
    one, two = (rescaled(model, arrivals, np.random.default_rng(6)) for _ in range(2))
    assert np.array_equal(one, two)
