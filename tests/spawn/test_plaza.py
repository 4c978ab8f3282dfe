"""The plaza: its process is what it says it is, and its recording is worth testing models on."""

from itertools import pairwise, product

import numpy as np
import pytest
import shapely

from crowdbench.rollouts.plaza_recording import record
from crowdbench.scene import load_scene
from crowdbench.spawn import Arrivals, PoissonGMM, SpawnEvents, arrivals_of, fit_areas, plaza
from crowdbench.trajectories.blocks import cut
from crowdbench.trajectories.table import Trajectories

SCENE = load_scene("plaza-v0")
TRUTH = plaza.PlazaArrivals(SCENE)
LONG_S = 40_000.0


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    """The recording of the scene."""
    return record()


@pytest.fixture(scope="module")
def long() -> SpawnEvents:
    """Eleven hours of arrivals."""
    return TRUTH.sample(LONG_S, SCENE, np.random.default_rng(1))


def as_arrivals(events: SpawnEvents, horizon_s: float) -> Arrivals:
    return Arrivals(
        tick=np.round(events.time_s / SCENE.grid_s).astype(np.int64),
        area=events.spawn_area.astype(np.int64),
        windows=np.array([[0, round(horizon_s / SCENE.grid_s)]]),
        areas=4,
        grid_s=SCENE.grid_s,
    )


def sampled(seed: int, horizon_s: float) -> Arrivals:
    events = TRUTH.sample(horizon_s, SCENE, np.random.default_rng(seed))
    return as_arrivals(events, horizon_s)


def test_a_recording_is_reproduced_by_its_seed() -> None:
    one, other = (record(3, 40.0) for _ in range(2))
    assert np.array_equal(one.xy, other.xy)
    assert np.array_equal(one.first, other.first)


def test_another_seed_records_another_crowd() -> None:
    assert not np.array_equal(record(3, 40.0).xy, record(4, 40.0).xy)


def test_the_recording_is_as_the_scene_says(crowd: Trajectories) -> None:
    assert (crowd.frames, crowd.dt_s, crowd.scene) == (SCENE.recording.frames, SCENE.dt_s, "plaza")


def test_nobody_is_inside_a_wall_or_outside_the_bounds_before_leaving(crowd: Trajectories) -> None:
    last = np.zeros(len(crowd.xy), bool)
    last[crowd.offsets[1:] - 1] = True
    assert SCENE.walkable(crowd.xy[~last].astype(np.float64)).all()


def test_nobody_steps_through_a_wall(crowd: Trajectories) -> None:
    walls = shapely.union_all([shapely.Polygon(w.corners_m) for w in SCENE.walls])
    same = np.diff(crowd.row_person()) == 0
    steps = np.stack([crowd.xy[:-1][same], crowd.xy[1:][same]], axis=1).astype(np.float64)
    assert not shapely.intersects(shapely.linestrings(steps), walls).any()


def brute_force(counts: np.ndarray, area: int) -> float:
    """Log-probability of the counts, summed over every path of the hidden chain."""
    dt = SCENE.grid_s
    leave = [1 - np.exp(-dt / s) for s in plaza.STAY_S]
    step = np.array([[1 - leave[0], leave[0]], [leave[1], 1 - leave[1]]])
    stationary = [leave[1] / sum(leave), leave[0] / sum(leave)]
    group = 1 - np.exp(-plaza.GROUPS_PER_S[area] * dt)
    more = plaza.NEXT_MEMBER
    total = 0.0
    for path in product((0, 1), repeat=len(counts)):
        p = stationary[path[0]]
        for before, after in pairwise(path):
            p *= step[before, after]
        for state, n in zip(path, counts.tolist(), strict=True):
            p *= 1 - group[state] if n == 0 else group[state] * (1 - more) * more ** (n - 1)
        total += p
    return float(np.log(total))


@pytest.mark.parametrize("seed", range(3))
def test_the_likelihood_is_the_sum_over_all_hidden_paths(seed: int) -> None:
    counts = np.random.default_rng(seed).poisson(0.5, (8, 4))
    ticks, areas = (np.repeat(x, counts.ravel()) for x in np.indices(counts.shape).reshape(2, -1))
    arrivals = Arrivals(ticks, areas, np.array([[0, 8]]), 4, SCENE.grid_s)
    expected = sum(brute_force(counts[:, k], k) for k in range(4)) / len(ticks)
    assert TRUTH.log_likelihood(arrivals) == pytest.approx(expected, rel=1e-12)


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


def test_the_truth_explains_fresh_arrivals_better_than_poisson() -> None:
    fitted = PoissonGMM.fit(sampled(0, 1800.0), plaza.true_areas())
    margins = [
        TRUTH.log_likelihood(fresh) - fitted.log_likelihood(fresh)
        for fresh in (sampled(seed, 1800.0) for seed in range(1, 9))
    ]
    assert min(margins) > 0.3  # nats per person


def test_areas_let_in_as_many_as_the_stationary_process(long: SpawnEvents) -> None:
    # Busy for 12 of 42 s on average; a group has 1 / (1 − 0.4) members.
    busy = plaza.STAY_S[1] / sum(plaza.STAY_S)
    dt = SCENE.grid_s
    per_frame = 1 - np.exp(-plaza.GROUPS_PER_S * dt)
    groups = per_frame @ [1 - busy, busy]
    expected = groups / dt / (1 - plaza.NEXT_MEMBER) * LONG_S
    found = np.bincount(long.spawn_area, minlength=4)
    # Five standard errors by the counts of 600 s, which are all but independent.
    windows = np.histogram2d(
        long.spawn_area, long.time_s, bins=[np.arange(5), np.arange(0, LONG_S + 1, 600)]
    )[0]
    error = windows.std(axis=1) * np.sqrt(windows.shape[1])
    assert (np.abs(found - expected) < 5 * error).all()
    assert (error < 0.1 * expected).all()


def groups_of(events: SpawnEvents) -> tuple[np.ndarray, np.ndarray]:
    """Index of each event's group, and the groups' sizes."""
    key = np.stack([events.time_s, events.spawn_area], axis=1)
    _, group, size = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    return group.ravel(), size


def test_a_group_has_one_goal_area(long: SpawnEvents) -> None:
    group, size = groups_of(long)
    least, most = np.full(len(size), 9), np.full(len(size), -1)
    np.minimum.at(least, group, long.goal_area)
    np.maximum.at(most, group, long.goal_area)
    assert size.max() > 3
    assert (least == most).all()


def test_sizes_of_groups_are_geometric(long: SpawnEvents) -> None:
    _, size = groups_of(long)
    alone = (size == 1).mean()
    error = np.sqrt(0.6 * 0.4 / len(size))
    assert abs(alone - (1 - plaza.NEXT_MEMBER)) < 5 * error


def test_goals_follow_the_flow(long: SpawnEvents) -> None:
    group, _ = groups_of(long)
    first = np.unique(group, return_index=True)[1]
    flow = np.zeros((4, 4))
    np.add.at(flow, (long.spawn_area[first], long.goal_area[first]), 1)
    n = flow.sum(axis=1, keepdims=True)
    error = np.sqrt(plaza.FLOW * (1 - plaza.FLOW) / n)
    assert (np.abs(flow / n - plaza.FLOW) <= 5 * error).all()


@pytest.mark.parametrize("side", ["spawn", "goal"])
def test_fitted_areas_lie_at_the_true_centres(crowd: Trajectories, side: str) -> None:
    areas, _ = fit_areas(crowd, SCENE, SCENE.clustering["default"])
    fitted = getattr(areas, side).mean
    gaps = np.linalg.norm(fitted[:, None] - plaza.CENTRES_M, axis=2)

    assert (gaps.min(axis=0) < 0.5).all()


def test_the_recording_of_the_scene_is_in_its_process(crowd: Trajectories) -> None:
    # What the walkers and the warm-up leave of the arrivals is as likely as fresh arrivals are.
    blocks = cut(crowd.observed, block_s=60.0, dt_s=SCENE.dt_s, grid_s=SCENE.grid_s)
    recorded = TRUTH.log_likelihood(arrivals_of(crowd, blocks, 4))
    fresh = [TRUTH.log_likelihood(sampled(seed, 1800.0)) for seed in range(20)]
    assert abs(recorded - np.mean(fresh)) < 4 * np.std(fresh)
