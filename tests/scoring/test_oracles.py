"""Scores and tests of significance against independent implementations."""

import warnings

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from crowdbench.data.blocks import cut
from crowdbench.metrics import METRICS, Metric, Statistics
from crowdbench.scoring.energy import Draws, Embedded, energy
from crowdbench.scoring.score import LEVEL, holm

BLOCKS = cut(np.array([[0, 40]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
DRAWS = Draws.of(BLOCKS, resample_s=10.0, block_s=10.0, seed=(0,))
BY_NAME = {metric.name: metric for metric in METRICS}
HISTOGRAMS = [BY_NAME[name] for name in ("agents_over_time", "speed", "nearest_neighbour")]


def crowd(rng: np.random.Generator) -> Statistics:
    """A histogram of 12 values in each block, as the metrics keep it."""
    return {"counts": rng.integers(0, 9, size=(len(BLOCKS), 12))}


@pytest.mark.parametrize("metric", HISTOGRAMS, ids=lambda m: m.name)
@settings(max_examples=20)
@given(seed=st.integers(0, 2**32 - 1), fits=st.integers(1, 3), each=st.integers(2, 5))
def test_the_energy_score_is_the_fair_crps_of_each_coordinate(
    metric: Metric, seed: int, fits: int, each: int
) -> None:
    """With an L1 distance the energy score is a sum of fair CRPS, here those of scoringrules."""
    scoringrules = pytest.importorskip("scoringrules")
    rng = np.random.default_rng(seed)
    recorded, rollouts = crowd(rng), [[crowd(rng) for _ in range(each)] for _ in range(fits)]
    found = energy(metric, recorded, rollouts, BLOCKS, DRAWS)
    assert found is not None

    everyone = [recorded, *(one for fit in rollouts for one in fit)]
    embedded = Embedded.of(metric, everyone, recorded, BLOCKS)
    assert embedded is not None
    vectors = embedded(np.ones((1, len(BLOCKS)), dtype=np.int64))[0]
    y, x = vectors[0], vectors[1:].reshape(fits, each, -1)
    expected = [scoringrules.crps_ensemble(y, fit, m_axis=0, estimator="fair").sum() for fit in x]
    assert found.centre == pytest.approx(np.mean(expected), rel=1e-9, abs=1e-9)


@pytest.mark.long
@settings(max_examples=20)
@given(p=st.lists(st.floats(0, 1), min_size=1, max_size=40))
def test_holms_procedure_is_that_of_statsmodels(p: list[float]) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of its imports
        multitest = pytest.importorskip("statsmodels.stats.multitest")
    # Its step-down multiplies p where ours divides the level: rounding may differ at the limit.
    ranks = np.argsort(np.argsort(p, kind="stable"))
    assume(not np.isclose(np.array(p) * (len(p) - ranks), LEVEL, rtol=1e-9).any())
    assert holm(p) == multitest.multipletests(p, LEVEL, method="holm")[0].tolist()
