"""The power study finds differences that are there, and no others."""

import numpy as np

from crowdbench.data.blocks import cut
from crowdbench.metrics import METRICS, Metric, Statistics
from crowdbench.metrics.motion import Speed
from crowdbench.metrics.presence import AgentsOverTime
from crowdbench.scoring.energy import Draws
from crowdbench.scoring.power import Power, power

BLOCKS = cut(np.array([[0, 300]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
DRAWS = Draws.of(BLOCKS, resample_s=10.0, block_s=10.0, seed=(0,))
RNG = np.random.default_rng(0)


def crowd(mean: float) -> Statistics:
    counts = RNG.poisson(mean, (30, 10))
    return {"counts": np.stack([np.bincount(v, minlength=40) for v in counts])}


def study(metric: Metric, recorded: Statistics, anchor: list[Statistics]) -> Power:
    found = power(metric, recorded, anchor, BLOCKS, DRAWS)
    assert found is not None
    return found


def test_an_anchor_that_is_the_truth_is_not_told_apart():
    found = [study(AgentsOverTime(), crowd(8.0), [crowd(8.0) for _ in range(20)]) for _ in range(8)]
    assert np.mean([f.power for f in found]) < 0.3
    assert not any(f.counts for f in found)


def test_an_anchor_that_differs_is_told_apart():
    found = study(AgentsOverTime(), crowd(8.0), [crowd(4.0) for _ in range(20)])
    assert found.power == 1.0
    assert found.counts
    assert found.floor < found.threshold < found.anchor


def test_walkers_are_compared_in_the_same_blocks():
    # Each block has a speed of its own; walkers with just these speeds are no different.
    levels = np.arange(30)
    recorded = {"counts": np.eye(40, dtype=np.int64)[levels] * 10}
    same = study(Speed(), recorded, [recorded])
    assert same.anchor == 0
    slower = {"counts": np.roll(recorded["counts"], 9, axis=1)}
    assert study(Speed(), recorded, [slower]).power == 1.0


def test_a_metric_of_which_the_recording_knows_one_value_does_not_count():
    share = next(m for m in METRICS if m.name == "goal_share")
    recorded = {"share": np.tile([10, 10], (30, 1))}
    found = study(share, recorded, [{"share": np.tile([9, 10], (30, 1))}] * 2)
    assert found.power == 1.0
    assert not found.counts


def test_what_is_undefined_has_no_power():
    nobody = {"counts": np.full((30, 1), 10)}
    assert power(AgentsOverTime(), nobody, [crowd(4.0)], BLOCKS, DRAWS) is None
