import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.stats import kstest
from strategies import crowd_of

from crowdbench.data.blocks import cut
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.errors import WeightsError
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import Areas, Arrivals, PoissonGMM, arrivals_of, fit_areas
from crowdbench.spawn.areas import Gaussians

RATE = np.array([0.5, 0.02])
GRID_S = 0.4


@pytest.fixture(scope="module")
def scene() -> Scene:
    return load_scene("eth-v0")


@pytest.fixture(scope="module")
def areas() -> Areas:
    """Two areas in the open, each the other's goal."""
    both = Gaussians(np.array([[3.0, 5.0], [11.0, 6.0]]), np.stack([np.eye(2), np.eye(2)]))
    speeds = np.linspace(1.0, 1.5, 101)
    return Areas("eth-v0", both, both, np.array([[0.0, 1.0], [1.0, 0.0]]), speeds, (0.0, 0.0))


@pytest.fixture(scope="module")
def model(areas: Areas) -> PoissonGMM:
    return PoissonGMM(areas, RATE)


@pytest.fixture(scope="module")
def eth(opentraj: Path, scene: Scene) -> tuple[PoissonGMM, Arrivals]:
    """The model fitted to the recording, and the recording's arrivals."""
    crowd = read_published(SOURCES["eth"], opentraj)
    fitted, crowd = fit_areas(crowd, scene, scene.clustering["default"])
    blocks = cut(crowd.observed, block_s=60.0, dt_s=crowd.dt_s, grid_s=crowd.grid_s)
    arrivals = arrivals_of(crowd, blocks, len(fitted.spawn))
    return PoissonGMM.fit(arrivals, fitted), arrivals


@pytest.fixture
def folder(tmp_path: Path, scene: Scene) -> Path:
    (tmp_path / "scene.toml").write_bytes((scene.folder / "scene.toml").read_bytes())
    return tmp_path


def arrivals_at(tick: list[int], area: list[int], windows: list) -> Arrivals:
    return Arrivals(
        tick=np.array(tick, dtype=np.int64),
        area=np.array(area, dtype=np.int64),
        windows=np.array(windows),
        areas=2,
        grid_s=GRID_S,
    )


# Two people at once in area 0, one later in area 1; six grid points are observed.
FEW = arrivals_at([1, 1, 11], [0, 0, 1], [(0, 4), (10, 12)])


def test_the_arrivals_of_a_recording_are_its_entered_people():
    crowd = crowd_of(
        [(0, 2), (1, 5), (3, 5), (12, 14)],
        frames=20,
        observed=[(0, 8), (10, 20)],
        persons={"spawn_area": [0, 1, 0, 1]},
    )
    blocks = cut(crowd.observed, block_s=5.0, dt_s=1.0, grid_s=1.0)
    arrivals = arrivals_of(crowd, blocks, 2)
    assert arrivals.tick.tolist() == [1, 3, 12]
    assert arrivals.area.tolist() == [1, 0, 1]


def test_neighbouring_blocks_are_one_window_without_its_opening_frame():
    blocks = cut(np.array([[0, 30], [40, 60]]), block_s=10.0, dt_s=1.0, grid_s=1.0)
    arrivals = arrivals_of(crowd_of([(1, 2)], frames=60), blocks, 2)
    assert arrivals.windows.tolist() == [[1, 30], [41, 60]]


def test_people_without_an_area_are_no_arrivals():
    crowd = crowd_of([(1, 2), (3, 4)], frames=10, persons={"spawn_area": [-1, 1]})
    blocks = cut(crowd.observed, block_s=10.0, dt_s=1.0, grid_s=1.0)
    assert arrivals_of(crowd, blocks, 2).tick.tolist() == [3]


def test_counts_hold_each_grid_point_of_the_windows():
    expected = [[0, 0], [2, 0], [0, 0], [0, 0], [0, 0], [0, 1]]
    assert FEW.counts().tolist() == expected


def test_the_rate_is_people_per_observed_second(areas):
    rate = PoissonGMM.fit(FEW, areas).rate
    np.testing.assert_allclose(rate, [2 / 2.4, 1 / 2.4])


def test_the_fit_recovers_the_rate_of_poisson_arrivals(areas):
    points = 20_000
    rng = np.random.default_rng(4)
    counts = rng.poisson(RATE * GRID_S, (points, 2))
    tick, area = (np.repeat(index.ravel(), counts.ravel()) for index in np.indices(counts.shape))
    fitted = PoissonGMM.fit(arrivals_at(list(tick), list(area), [(0, points)]), areas)
    error = np.sqrt(RATE / (points * GRID_S))
    assert (np.abs(fitted.rate - RATE) < 4 * error).all()


@pytest.mark.parametrize("factor", [0.95, 1.05])
@pytest.mark.parametrize("area", [0, 1])
def test_no_other_rate_is_more_likely_than_the_fitted_one(areas, area, factor):
    fitted = PoissonGMM.fit(FEW, areas)
    rate = fitted.rate.copy()
    rate[area] *= factor
    assert PoissonGMM(areas, rate).log_likelihood(FEW) < fitted.log_likelihood(FEW)


def test_the_likelihood_is_that_of_the_counts_in_closed_form(model):
    total = 0.0
    for at_point in [(0, 0), (2, 0), (0, 0), (0, 0), (0, 0), (0, 1)]:
        for n, rate in zip(at_point, RATE, strict=True):
            mean = float(rate) * GRID_S
            total += n * math.log(mean) - mean - math.log(math.factorial(n))
    assert model.log_likelihood(FEW) == pytest.approx(total / 3)


def test_time_without_arrivals_lowers_the_likelihood(model):
    longer = replace(FEW, windows=np.array([[0, 4], [10, 12], [20, 120]]))
    survival = -RATE.sum() * 100 * GRID_S
    gained = model.log_likelihood(longer) - model.log_likelihood(FEW)
    assert gained == pytest.approx(survival / 3)


def test_an_arrival_where_nobody_ever_arrives_is_impossible(areas):
    assert PoissonGMM(areas, np.array([0.5, 0.0])).log_likelihood(FEW) == -math.inf


def test_as_many_people_enter_each_area_as_its_rate_says(model, scene):
    horizon_s = 20_000.0
    events = model.sample(horizon_s, scene, np.random.default_rng(5))
    expected = RATE * horizon_s
    count = np.bincount(events.spawn_area, minlength=2)
    assert (np.abs(count - expected) < 4 * np.sqrt(expected)).all()


def test_people_enter_in_order_and_before_the_horizon(model, scene):
    time_s = model.sample(500.0, scene, np.random.default_rng(6)).time_s
    assert (np.diff(time_s) >= 0).all()
    assert time_s.min() >= 0
    assert time_s.max() < 500.0


def test_rescaled_gaps_between_arrivals_are_exponential(model, scene):
    time_s = model.sample(6_000.0, scene, np.random.default_rng(7)).time_s
    rescaled = np.diff(time_s, prepend=0.0) * RATE.sum()
    assert kstest(rescaled, "expon").pvalue > 0.001


def test_the_same_seed_gives_the_same_people(model, scene):
    one, two = (model.sample(100.0, scene, np.random.default_rng(8)) for _ in range(2))
    np.testing.assert_array_equal(one.time_s, two.time_s)
    np.testing.assert_array_equal(one.start, two.start)
    np.testing.assert_array_equal(one.goal, two.goal)


def test_without_a_rate_nobody_enters(areas, scene):
    nobody = PoissonGMM(areas, np.zeros(2))
    assert len(nobody.sample(100.0, scene, np.random.default_rng(9))) == 0


def test_eths_people_are_all_arrivals_of_the_fit(eth):
    model, arrivals = eth
    assert len(arrivals.tick) == 311
    assert model.rate.sum() * arrivals.exposure_s() == pytest.approx(311)


def test_samples_of_eth_have_its_arrivals_per_observed_minute_and_area(eth, scene):
    model, arrivals = eth
    samples = 100
    count = np.zeros(len(model.rate))
    for seed in range(samples):
        events = model.sample(scene.horizon_s, scene, np.random.default_rng(seed))
        count += np.bincount(events.spawn_area, minlength=len(model.rate))
    minutes = samples * scene.horizon_s / 60
    recorded = np.bincount(arrivals.area, minlength=arrivals.areas)
    recorded = recorded / (arrivals.exposure_s() / 60)
    assert count.sum() / minutes == pytest.approx(recorded.sum(), rel=0.05)
    assert (np.abs(count / minutes - recorded) <= 3 * np.sqrt(recorded / minutes)).all()


def test_rates_that_are_no_json_are_refused(folder, areas):
    (folder / "poisson-gmm.json").write_text("rate_per_s = [0.1, 0.1]")
    with pytest.raises(WeightsError, match="expected valid JSON"):
        PoissonGMM.read(load_scene(folder), areas)
