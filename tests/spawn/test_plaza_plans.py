"""What people on the plaza do: groups, their lines and their stops follow the stated laws."""

from itertools import combinations

import numpy as np
import pytest
import shapely
from plaza_truth import group_sizes
from scipy.stats import chi2, chisquare, kstest, norm

from crowdbench.data.companions import groups_of
from crowdbench.data.stops import stops_of
from crowdbench.data.table import Trajectories
from crowdbench.policies.social_force import GroupForce
from crowdbench.run.plaza_recording import record
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.spawn import (
    SpawnEvents,
    arrivals_in,
    arrivals_of,
    fit_areas,
    plaza,
)
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plans.planned import directions

SCENE = load_scene("plaza-v0")
TRUTH = plaza.PlazaArrivals(SCENE)


@pytest.fixture(scope="module")
def events() -> SpawnEvents:
    """Eleven hours of arrivals: about 20,000 persons."""
    return TRUTH.sample(40_000.0, SCENE, np.random.default_rng(2))


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    """The recording of the scene."""
    return record()


def sizes(group: np.ndarray) -> np.ndarray:
    """Size of each group, that of people who are alone included."""
    return np.concatenate([np.bincount(group[group >= 0]), np.ones((group < 0).sum(), np.int64)])


def neighbours(events: SpawnEvents) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of companions of whom one enters after the other with nobody of them in between."""
    order = np.argsort(events.group, kind="stable")
    order = order[events.group[order] >= 0]
    same = np.diff(events.group[order]) == 0
    return order[:-1][same], order[1:][same]


def test_the_sizes_of_groups_are_those_of_a_branching_process() -> None:
    probability = group_sizes(60)
    assert probability.sum() == pytest.approx(1.0)
    together = plaza.SIZES @ np.arange(1, 6)
    mean = together / (1 - plaza.LATE * plaza.FOLLOWS)
    assert probability @ np.arange(1, 61) == pytest.approx(mean)
    # Of a person who is alone at first: with nobody behind, and with one whom nobody follows.
    alone, stays = plaza.SIZES[0], 1 - plaza.FOLLOWS
    assert probability[0] == pytest.approx(alone * stays**2)
    two = alone * 2 * plaza.FOLLOWS * stays * stays**2 + plaza.SIZES[1] * stays**4
    assert probability[1] == pytest.approx(two)


def test_groups_have_these_sizes(events: SpawnEvents) -> None:
    found = np.bincount(sizes(events.group).clip(max=7), minlength=8)[1:]
    expected = group_sizes(6)
    expected = np.append(expected, 1 - expected.sum()) * found.sum()
    assert expected.min() > 5
    assert chisquare(found, expected).pvalue > 1e-3


def test_a_quarter_of_the_companions_are_late(events: SpawnEvents) -> None:
    first = np.full(events.group.max() + 1, np.inf)
    np.minimum.at(first, events.group[events.group >= 0], events.time_s[events.group >= 0])
    late = events.time_s[events.group >= 0] > first[events.group[events.group >= 0]] + 1e-6
    joined = (sizes(events.group) - 1).sum()
    size = group_sizes(60) @ np.arange(1, 61)
    expected = (size - plaza.SIZES @ np.arange(1, 6)) / (size - 1)
    assert expected == pytest.approx(0.25, abs=0.01)
    assert late.sum() / joined == pytest.approx(expected, abs=0.02)
    one, other = neighbours(events)
    delay = events.time_s[other] - events.time_s[one]
    assert delay.max() < (plaza.LATE + 0.5) * SCENE.grid_s  # nobody is later behind the one before


def test_a_group_has_one_plan_and_walks_more_slowly(events: SpawnEvents) -> None:
    one, other = neighbours(events)
    for name in ("spawn_area", "goal_area", "wait_s", "speed"):
        column = getattr(events, name)
        assert np.array_equal(column[one], column[other])
    assert np.array_equal(np.isnan(events.via[one]), np.isnan(events.via[other]))
    quantiles = TRUTH.areas.speed_quantiles
    alone = events.speed[events.group < 0]
    first = np.unique(events.group[events.group >= 0], return_index=True)[1]
    groups = events.speed[np.flatnonzero(events.group >= 0)[first]] / plaza.SLOWER
    for speeds in (alone, groups):
        levels = np.interp(speeds, quantiles, np.linspace(0, 1, len(quantiles)))
        assert kstest(levels, "uniform").pvalue > 1e-3


def test_companions_stand_abreast_at_their_start_stop_and_goal(events: SpawnEvents) -> None:
    one, other = neighbours(events)
    way = directions((events.goal[one] - events.start[one]).astype(np.float64))
    left = np.column_stack([-way[:, 1], way[:, 0]])
    stops = np.isfinite(events.via[one, 0])
    aside = []
    for points, which in ((events.start, ...), (events.goal, ...), (events.via, stops)):
        gap = (points[other] - points[one]).astype(np.float64)[which]
        ahead, across = (gap * way[which]).sum(axis=1), (gap * left[which]).sum(axis=1)
        in_line = np.abs(ahead) < 1e-4  # all but a few, in groups too wide for their street
        assert in_line.mean() > 0.995
        aside.append(across[in_line])
    for across in aside:
        law = norm(plaza.ABREAST_M, plaza.ABREAST_SD_M)
        assert kstest(np.abs(across), law.cdf).pvalue > 1e-3
    assert (aside[0] > 0).mean() == pytest.approx(0.5, abs=0.04)


def test_people_start_stop_and_arrive_around_the_true_places(events: SpawnEvents) -> None:
    """Of those who are alone: their places are the drawn ones."""
    alone = events.group < 0
    stops = alone & np.isfinite(events.via[:, 0])
    place = np.linalg.norm(events.via[:, None] - plaza.PLACES_M, axis=2).argmin(axis=1)
    centres, spread = plaza.CENTRES_M, plaza.SPREAD_M
    for points, index, mean, sd, which in (
        (events.start, events.spawn_area, centres, spread, alone),
        (events.goal, events.goal_area, centres, spread, alone),
        (events.via, place, plaza.PLACES_M, plaza.PLACE_SPREAD_M, stops),
    ):
        off = (points[which] - mean[index[which]]) / sd[index[which]]
        assert kstest((off**2).sum(axis=1), chi2(2).cdf).pvalue > 1e-3


def test_goals_follow_the_flow(events: SpawnEvents) -> None:
    alone = events.group < 0
    flow = np.zeros((4, 4))
    np.add.at(flow, (events.spawn_area[alone], events.goal_area[alone]), 1)
    n = flow.sum(axis=1, keepdims=True)
    error = np.sqrt(plaza.FLOW * (1 - plaza.FLOW) / n)
    assert (np.abs(flow / n - plaza.FLOW) <= 5 * error).all()


def test_groups_stop_where_as_often_and_as_long_as_the_truth_says(events: SpawnEvents) -> None:
    _, first = np.unique(
        np.where(events.group < 0, -1 - np.arange(len(events)), events.group), return_index=True
    )
    via, wait_s = events.via[first], events.wait_s[first]
    stops = np.isfinite(via[:, 0])
    error = np.sqrt(plaza.STOPPING * (1 - plaza.STOPPING) / len(first))
    assert abs(stops.mean() - plaza.STOPPING) < 4 * error
    assert ((wait_s > 0) == stops).all()
    place = np.linalg.norm(via[stops][:, None] - plaza.PLACES_M, axis=2).argmin(axis=1)
    expected = plaza.PLACE_SHARE * stops.sum()
    assert chisquare(np.bincount(place), expected).pvalue > 1e-3
    for k in range(2):
        log_wait = np.log(wait_s[stops][place == k])
        law = norm(np.log(plaza.WAIT_S[k]), plaza.WAIT_LOG_SD[k])
        assert kstest(log_wait, law.cdf).pvalue > 1e-3


def test_everyone_has_a_place_in_the_largest_group_and_the_narrowest_street() -> None:
    group = np.zeros(14, np.int64)
    events = plaza.draw_plans(
        np.zeros(14), np.array([3]), group, TRUTH.areas, SCENE, np.random.default_rng(0)
    )
    for points in (events.start, events.goal):
        assert SCENE.walkable(points.astype(np.float64)).all()


def test_without_arrivals_there_are_no_plans() -> None:
    assert len(TRUTH.sample(0.4, SCENE, np.random.default_rng(0))) == 0


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


@pytest.mark.parametrize("side", ["spawn", "goal"])
def test_fitted_areas_lie_at_the_true_centres(crowd: Trajectories, side: str) -> None:
    areas, _ = fit_areas(crowd, SCENE, SCENE.clustering["default"])
    fitted = getattr(areas, side).mean
    gaps = np.linalg.norm(fitted[:, None] - plaza.CENTRES_M, axis=2)
    assert (gaps.min(axis=0) < 0.5).all()


def test_the_recording_of_the_scene_is_in_its_process(crowd: Trajectories) -> None:
    # What the walkers and the warm-up leave of the arrivals is as likely as fresh arrivals are.
    recorded = TRUTH.log_likelihood(arrivals_of(crowd, blocks_of(crowd, SCENE), 4))
    samples = [TRUTH.sample(1800.0, SCENE, np.random.default_rng(seed)) for seed in range(20)]
    fresh = [TRUTH.log_likelihood(arrivals_in(s, 1800.0, SCENE.grid_s, 4)) for s in samples]
    assert abs(recorded - np.mean(fresh)) < 4 * np.std(fresh)


def pairs(group: np.ndarray) -> set[tuple[int, int]]:
    """All pairs of companions."""
    members = [np.flatnonzero(group == k).tolist() for k in range(group.max() + 1)]
    return {pair for of_group in members for pair in combinations(of_group, 2)}


@pytest.fixture(scope="module")
def walked() -> Trajectories:
    """An hour with the true groups, which the recording does not have."""
    return rollout(SCENE, TRUTH, GroupForce(), seed=5, horizon_s=3_600.0)


def test_companions_stay_together_so_that_they_are_found(walked: Trajectories) -> None:
    true, found = pairs(walked.group), pairs(groups_of(walked))
    assert len(true & found) / len(true) > 0.8  # social forces without groups: 0.6
    assert len(true & found) / len(found) > 0.8
    assert sizes(groups_of(walked)).mean() == pytest.approx(sizes(walked.group).mean(), rel=0.08)


def test_people_stand_where_they_were_to_stop(walked: Trajectories) -> None:
    stops = stops_of(walked)
    gap = np.linalg.norm(stops.place[:, None] - plaza.PLACES_M, axis=2).min(axis=1)
    assert (gap < 2.5).mean() > 0.9
    share = len(np.unique(stops.person)) / len(walked)
    assert share == pytest.approx(plaza.STOPPING, abs=0.04)
    expected = plaza.PLACE_SHARE @ plaza.WAIT_S
    assert np.median(stops.duration_s) == pytest.approx(expected, rel=0.2)
