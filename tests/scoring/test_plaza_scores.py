"""On the plaza, whose truth is known: the true process scores 1, Poisson 0, and memory no more."""

from collections.abc import Callable

import numpy as np
import pytest
from numpy.random import Generator

from crowdbench.data.blocks import SPLITS, TimeBlocks, cut
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.evaluation import evaluate
from crowdbench.metrics import METRICS, Metric, Place, Statistics
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import Draws, energy
from crowdbench.scoring.ranking import Row, rows
from crowdbench.spawn import PoissonGMM, arrivals_of
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.plaza import PlazaArrivals

pytestmark = pytest.mark.long

PLAZA = load_scene("plaza-v0")
TRUTH = "crowdbench.spawn.plaza:PlazaArrivals"
WALKER = "crowdbench.policies.social_force:GroupForce"
"""Who walks in the recording."""
PLACE = Place(spawn_areas=4, goal_areas=4, bounds_m=(0.0, 30.0, 0.0, 20.0))
ARRIVALS = [m for m in METRICS if m.family == "arrivals" and m.name != "fano_60_s"]
FRAMES = 1500  # ten minutes
ROLLOUTS = 8

Arrive = Callable[[Generator], tuple[np.ndarray, np.ndarray]]
"""Times (grid points) and areas of those who enter."""


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Row]:
    card = evaluate(
        "plaza-v0", spawn=[TRUTH, "poisson-gmm"], policy=[WALKER], seeds=20,
        out=tmp_path_factory.mktemp("plaza"), report=False,
    )  # fmt: skip
    return {row.spawn: row for row in rows(card) if row.kind == "entry"}


@pytest.mark.parametrize("family", ["arrivals", "presence", "trips", "space"])
def test_the_true_process_scores_one_within_its_interval(table: dict[str, Row], family: str):
    score = table[TRUTH].families[family]
    low, high = score.interval
    assert low <= 1 <= high, f"{family}: {score.value:.2f} [{low:.2f}, {high:.2f}]"


def test_poisson_arrivals_score_zero(table: dict[str, Row]):
    low, high = table["poisson-gmm"].families["arrivals"].interval
    assert low <= 1e-9  # but for rounding it is the anchor itself
    assert high >= -1e-9
    assert table["poisson-gmm"].families["arrivals"].value == pytest.approx(0, abs=0.1)


def test_the_true_process_is_ranked_before_poisson(table: dict[str, Row]):
    assert table[TRUTH].rank == 1
    assert table["poisson-gmm"].rank == 2


def crowd(tick: np.ndarray, area: np.ndarray) -> Trajectories:
    """Those who enter, each there for one frame: all that arrivals are about."""
    n = len(tick)
    return from_rows(
        scene="plaza-v0",
        dt_s=0.4,
        frames=FRAMES,
        person_id=np.arange(n),
        frame=tick,
        xy=np.zeros((n, 2)),
        persons={"spawn_area": area, "entered": np.ones(n, dtype=bool)},
        where="test",
    )


def of_truth(rng: Generator) -> tuple[np.ndarray, np.ndarray]:
    events = PlazaArrivals(PLAZA).sample(FRAMES * 0.4, PLAZA, rng)
    return np.round(events.time_s / 0.4).astype(int), events.spawn_area


def permuted(y: Trajectories, blocks: TimeBlocks) -> Arrive:
    """The gaps of the training blocks in another order: their marginal by heart, and no memory."""
    persons, block, tick = blocks.of_arrivals(y)
    within = np.diff(block) == 0
    gaps, areas = np.diff(tick)[within], y.spawn_area[persons]

    def arrive(rng: Generator) -> tuple[np.ndarray, np.ndarray]:
        ticks = np.cumsum(np.concatenate([rng.permutation(gaps) for _ in range(3)]))
        ticks = ticks[ticks < FRAMES]
        return ticks, rng.choice(areas, len(ticks))

    return arrive


def poisson(y: Trajectories, blocks: TimeBlocks) -> Arrive:
    model = PoissonGMM.fit(arrivals_of(y, blocks, 4), read_areas(PLAZA))

    def arrive(rng: Generator) -> tuple[np.ndarray, np.ndarray]:
        count = rng.poisson(model.rate * FRAMES * 0.4)
        ticks = rng.integers(FRAMES, size=count.sum())
        order = np.argsort(ticks)
        return ticks[order], np.repeat(np.arange(4), count)[order]

    return arrive


@pytest.fixture(scope="module")
def held_out() -> dict[str, dict[str, float]]:
    """Mean energy scores over folds and independent recordings, by model and metric."""
    models = ("truth", "permuted gaps", "poisson")
    scores: dict[str, dict[str, list[float]]] = {m: {} for m in models}
    with pytest.MonkeyPatch.context() as patch:  # the resamples are not looked at
        patch.setattr("crowdbench.scoring.energy.RESAMPLES", 1)
        for seed in range(12):
            y = crowd(*of_truth(np.random.default_rng([seed, 0])))
            blocks = cut(np.array([[0, FRAMES]]), block_s=60.0, dt_s=0.4, grid_s=0.4)
            for split in SPLITS[1:]:
                made = (of_truth, permuted(y, blocks.training(split)), poisson(y, blocks))
                for model, arrive in zip(models, made, strict=True):
                    rng = np.random.default_rng([seed, 1])
                    crowds = [crowd(*arrive(rng)) for _ in range(ROLLOUTS)]
                    scored = blocks.scored(split)
                    for metric in ARRIVALS:
                        es = centre(metric, y, crowds, scored)
                        scores[model].setdefault(metric.name, []).append(es)
    return {m: {n: float(np.mean(v)) for n, v in each.items()} for m, each in scores.items()}


def centre(metric: Metric, y: Trajectories, x: list[Trajectories], blocks: TimeBlocks) -> float:
    def of(crowd: Trajectories) -> Statistics:
        return metric.summarise(crowd, blocks, PLACE)

    draws = Draws.of(blocks, resample_s=60.0, block_s=60.0, seed=(0,))
    es = energy(metric, of(y), [[of(one) for one in x]], blocks, draws)
    assert es is not None
    return es.centre


@pytest.mark.parametrize("metric", [m.name for m in ARRIVALS])
@pytest.mark.parametrize("model", ["permuted gaps", "poisson"])
def test_no_model_is_better_than_the_truth_on_what_was_held_out(
    held_out: dict[str, dict[str, float]], model: str, metric: str
):
    assert held_out["truth"][metric] < held_out[model][metric]


def test_the_true_process_reaches_the_floor(held_out: dict[str, dict[str, float]]):
    """The truth's energy score is half the mean distance of two recordings."""
    rng = np.random.default_rng(7)
    blocks = cut(np.array([[0, FRAMES]]), block_s=60.0, dt_s=0.4, grid_s=0.4).scored("fold0")
    for metric in ARRIVALS:
        pairs = [[crowd(*of_truth(rng)) for _ in range(2)] for _ in range(40)]
        half = np.mean([
            metric.compare(*(metric.summarise(c, blocks, PLACE) for c in pair), blocks).distance / 2
            for pair in pairs
        ])  # fmt: skip
        assert held_out["truth"][metric.name] == pytest.approx(half, rel=0.35)
