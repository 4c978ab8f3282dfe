"""Plans: companions share them, ways are walkable, and files give back what was fitted."""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
from msgspec import structs
from scipy.stats import binomtest

from crowdbench.data.blocks import SPLITS
from crowdbench.data.companions import WITHIN_M, groups_of
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.errors import SceneError, WeightsError
from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.scene_building.plan_calibration import straight_walks
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plans.files import FILE, read_plans, write_plans
from crowdbench.spawn.plans.fitting import fit_plans, offsets_of
from crowdbench.spawn.plans.links import Adjustment
from crowdbench.spawn.plans.mixtures import DECIMALS, NARROWEST_M, moments
from crowdbench.spawn.plans.planned import PlannedAreas, directions, turned
from crowdbench.spawn.plans.way_fitting import bends_of
from crowdbench.spawn.plans.ways import OFF_M, Places, TripMixtures, Ways
from crowdbench.spawn.recorded_plans import plans_of

PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return recording_of(PLAZA)


@pytest.fixture(scope="module")
def fitted(crowd: Trajectories) -> PlannedAreas:
    return fit_plans(crowd, blocks_of(crowd, PLAZA), read_areas(PLAZA))


def with_stops(fitted: PlannedAreas) -> PlannedAreas:
    """The same areas, in which a third of the people stop at one of two places."""
    ways = fitted.ways
    k, g = ways.stopping.shape
    return replace(
        fitted,
        ways=replace(
            ways,
            stopping=np.full((k, g), 1 / 3),
            stop_mean=np.array([[10.0, 10.0, np.log(8.0)], [20.0, 10.0, np.log(20.0)]]),
            stop_covariance=np.stack([np.diag([0.1, 0.1, 0.01])] * 2),
            from_area=np.ones((2, k)),
            to_area=np.ones((2, g)),
        ),
    )


def drawn(areas: PlannedAreas, number: int = 3_000, apart_s: float = 1.0):
    rng = np.random.default_rng(0)
    time_s = np.floor(np.arange(number) * apart_s / 3) * 3
    area = rng.integers(0, len(areas.spawn), number)
    return areas.draw(time_s, area, PLAZA, rng), area


def test_people_have_room_at_all_points_of_their_ways(fitted: PlannedAreas) -> None:
    events, _ = drawn(with_stops(fitted))
    radius = PLAZA.motion.person_radius_m - 1e-4  # numbers are rounded to float32
    slim = replace(PLAZA, motion=structs.replace(PLAZA.motion, person_radius_m=radius))
    via = events.via[np.isfinite(events.via[:, 0])]
    for points in (events.start, events.goal, via):
        assert slim.has_room(points.astype(np.float64)).all()


def between(fitted: PlannedAreas, *goals: tuple[float, float]) -> Ways:
    """Ways from the first area to these places, all equally likely, in the first area."""
    trips, count = fitted.ways.trips, len(goals)
    others = trips.goals.area != 0
    end = Places(
        np.concatenate([np.zeros(count, np.int64), trips.goals.area[others]]),
        np.concatenate([np.full(count, 1 / count), trips.goals.weight[others]]),
        np.concatenate([np.array(goals), trips.goals.mean[others]]),
        np.concatenate([np.tile(np.eye(2), (count, 1, 1)), trips.goals.covariance[others]]),
    )
    apart = TripMixtures.apart(trips.starts, end, trips.log_speed)
    return replace(with_stops(fitted).ways, trips=apart)


def test_redrawing_changes_neither_the_shares_of_places_nor_of_stops(
    fitted: PlannedAreas,
) -> None:
    """Half of the draws of one of two goals, and of one of two stops, are out of bounds."""
    number, zeros = 4_000, np.zeros(4_000, np.int64)
    bounds = PLAZA.bounds
    ways = between(fitted, (bounds.x_max_m, 10.0), (15.0, 10.0))
    ways.stop_mean[0, 1] = bounds.y_max_m
    found = ways.draw(zeros, zeros, PLAZA, np.random.default_rng(0))
    at_bounds = int((found[:, 2] > (bounds.x_max_m + 15) / 2).sum())
    assert binomtest(at_bounds, number, 0.5).pvalue > 1e-3
    assert binomtest(int(np.isfinite(found[:, 7]).sum()), number, 1 / 3).pvalue > 1e-3


def test_places_without_room_are_given_up(fitted: PlannedAreas) -> None:
    zeros, rng = np.zeros(300, np.int64), np.random.default_rng(0)
    outside = (PLAZA.bounds.x_max_m + 20, 10.0)
    found = between(fitted, outside, (15.0, 10.0)).draw(zeros, zeros, PLAZA, rng)
    assert (np.abs(found[:, 2] - 15) < 6).all()
    with pytest.raises(SceneError, match="no way could be drawn"):
        between(fitted, outside).draw(zeros, zeros, PLAZA, rng)


def test_ways_are_walkable_and_companions_share_them(fitted: PlannedAreas) -> None:
    events, area = drawn(with_stops(fitted))
    np.testing.assert_array_equal(events.spawn_area, area)
    for points in (events.start, events.goal):
        assert PLAZA.walkable(points.astype(np.float64)).all()
    has_via = np.isfinite(events.via[:, 0])
    assert PLAZA.walkable(events.via[has_via].astype(np.float64)).all()
    assert ((events.wait_s > 0) <= has_via).all()
    assert (events.wait_s > 0).mean() == pytest.approx(1 / 3, abs=0.06)
    sizes = np.bincount(events.group[events.group >= 0])
    assert (sizes >= 2).all()
    for group in range(len(sizes)):
        members = np.flatnonzero(events.group == group)
        for name in ("spawn_area", "goal_area", "wait_s"):
            assert len(np.unique(getattr(events, name)[members])) == 1


def test_without_arrivals_there_are_no_plans(fitted: PlannedAreas) -> None:
    rng = np.random.default_rng(0)
    assert len(fitted.draw(np.empty(0), np.empty(0, np.int64), PLAZA, rng)) == 0


def test_the_same_numbers_give_the_same_plans(fitted: PlannedAreas) -> None:
    one, other = drawn(fitted)[0], drawn(fitted)[0]
    for field in fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(other, field.name))


def test_the_file_gives_back_what_was_fitted(fitted: PlannedAreas, tmp_path: Path) -> None:
    for areas in (fitted, with_stops(fitted)):
        write_plans(tmp_path, dict.fromkeys(SPLITS, areas))
        place = replace(PLAZA, folder=tmp_path)
        again = read_plans(place, read_areas(PLAZA), "fold1")
        for kind, read, fit in (
            (Ways, again.ways, areas.ways),
            (TripMixtures, again.ways.trips, areas.ways.trips),
            (Places, again.ways.trips.starts, areas.ways.trips.starts),
            (Places, again.ways.trips.goals, areas.ways.trips.goals),
        ):
            arrays = [f.name for f in fields(kind) if f.name not in ("trips", "starts", "goals")]
            for name in arrays:
                expected = np.round(getattr(fit, name), DECIMALS if name != "fastest_mps" else 20)
                np.testing.assert_array_equal(getattr(read, name), expected)
        for name in (f.name for f in fields(areas.links)):
            np.testing.assert_array_equal(getattr(again.links, name), getattr(areas.links, name))


def test_plans_are_adjusted_to_the_times_of_a_model(fitted: PlannedAreas, tmp_path: Path) -> None:
    by = Adjustment(more=0.5, larger=-0.25, along=0.75, across=1.5)
    write_plans(tmp_path, dict.fromkeys(SPLITS, fitted), {"fold1": {"cox-gmm": by}})
    place = replace(PLAZA, folder=tmp_path)
    links = read_plans(place, read_areas(PLAZA), "fold1", "cox-gmm").links
    for field in fields(links):
        adjusted = getattr(fitted.links.adjusted(by), field.name)
        np.testing.assert_array_equal(getattr(links, field.name), adjusted)
    for split, times in (("fold1", "ntpp-gmm"), ("full", "cox-gmm")):
        with pytest.raises(WeightsError, match=f"{times}, the model that the times are from"):
            read_plans(place, read_areas(PLAZA), split, times)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ('"model":"plans"', '"model":"plums"', "plums of plaza-v0"),
        ('"fold2"', '"fold9"', "fold9"),
        ('"stopping"', '"stoping"', "stoping"),
        ('"group_log_speed"', '"slow"', "slow"),
        ('"along":1.0', '"along":-1.0', "along"),
        ('"log_speed":[', '"log_speed":[0.1,', "trips.log_speed"),
        ('"starts":{"area":[0,', '"starts":{"area":[9,', "trips.starts.area"),
        ('"starts":{"area":[0,', '"starts":{"area":[0,0,', "trips.starts.weight"),
        ('"own":[[0,', '"own":[[99,', "trips.own"),
        ('"own":[[', '"own":[[0,0],[', "trips.own|trips.mean"),
    ],
)
def test_broken_files_are_refused(
    fitted: PlannedAreas, tmp_path: Path, old: str, new: str, told: str
) -> None:
    nothing = {split: {"cox-gmm": Adjustment()} for split in SPLITS}
    write_plans(tmp_path, dict.fromkeys(SPLITS, fitted), nothing)
    file = tmp_path / FILE
    text = file.read_text().replace(" ", "").replace("\n", "")
    file.write_text(text.replace(old, new))
    with pytest.raises(WeightsError, match=told):
        read_plans(replace(PLAZA, folder=tmp_path), read_areas(PLAZA), "full")


def test_weights_that_do_not_sum_to_one_are_refused(fitted: PlannedAreas, tmp_path: Path) -> None:
    trips = fitted.ways.trips
    for changed, told in (
        (replace(trips, weight=trips.weight * 1.1), "trips.weight"),
        (replace(trips, goals=replace(trips.goals, weight=-trips.goals.weight)), "goals.weight"),
        (replace(trips, covariance=-trips.covariance), "trips.covariance"),
    ):
        broken = replace(fitted, ways=replace(fitted.ways, trips=changed))
        write_plans(tmp_path, dict.fromkeys(SPLITS, broken))
        with pytest.raises(WeightsError, match=told):
            read_plans(replace(PLAZA, folder=tmp_path), read_areas(PLAZA), "full")


def test_no_gaussian_is_narrower_than_thirty_centimetres(
    fitted: PlannedAreas, tmp_path: Path
) -> None:
    """Not even after it was rounded."""
    write_plans(tmp_path, dict.fromkeys(SPLITS, fitted))
    read = read_plans(replace(PLAZA, folder=tmp_path), read_areas(PLAZA), "full")
    for trips in (fitted.ways.trips, read.ways.trips):
        covariance = trips.gaussians[1]
        for block in (slice(0, 2), slice(2, 4)):
            values = np.linalg.eigvalsh(covariance[..., block, block])
            assert (values >= NARROWEST_M**2).all()
        for places in (trips.starts, trips.goals):
            assert (np.linalg.eigvalsh(places.covariance) >= NARROWEST_M**2).all()


def test_a_bend_is_the_furthest_point_from_the_straight_line(crowd: Trajectories) -> None:
    persons = np.flatnonzero(crowd.left)[:50]
    for person, (along, left) in zip(persons.tolist(), bends_of(crowd, persons), strict=True):
        path = crowd.path(person).astype(np.float64)
        way = crowd.goal[person] - path[0]
        length = np.hypot(*way)
        if length < OFF_M:
            continue
        across = np.array([-way[1], way[0]]) / length
        off = (path - path[0]) @ across
        assert abs(left) == pytest.approx(np.abs(off).max())
        assert 0.05 <= along <= 0.95


def test_offsets_are_turned_with_the_direction_of_the_way() -> None:
    ahead = directions(np.array([[0.0, 2.0], [3.0, 0.0]]))
    offset = np.array([[1.0, 0.5], [1.0, 0.5]])  # a metre ahead, half a metre to the left
    np.testing.assert_allclose(turned(ahead, offset), [[-0.5, 1.0], [1.0, 0.5]], atol=1e-12)
    np.testing.assert_allclose(
        turned(ahead * [1.0, -1.0], turned(ahead, offset)), offset, atol=1e-12
    )


def test_moments_are_weighted() -> None:
    x = np.array([[0.0], [1.0], [5.0]])
    mean, covariance = moments(x, np.array([1.0, 1.0, 0.0]))
    assert (mean[0], covariance[0, 0]) == (0.5, 0.25)


def test_speeds_are_those_of_the_recording(crowd: Trajectories, fitted: PlannedAreas) -> None:
    events, _ = drawn(fitted)
    recorded = plans_of(crowd).speed
    recorded = recorded[np.isfinite(recorded)]
    # The fastest person may be one of a group, who would be faster alone.
    assert events.speed.max() <= recorded.max() / np.exp(fitted.links.group_log_speed) + 1e-6
    assert np.median(events.speed) == pytest.approx(np.median(recorded), rel=0.05)


def pair(gap_m: np.ndarray, delay: int = 0) -> Trajectories:
    """Somebody who walks along x at 0.5 m a frame, and somebody at `gap_m` from there."""
    rows = len(gap_m)
    first = np.column_stack([0.5 * np.arange(rows), np.full(rows, 10.0)])
    return from_rows(
        scene="plaza",
        dt_s=0.4,
        person_id=np.repeat([0, 1], [rows, rows - delay]),
        frame=np.concatenate([np.arange(rows), np.arange(delay, rows)]),
        xy=np.concatenate([first, (first + gap_m)[delay:]]),
        where="a test",
    )


def test_companions_are_as_far_apart_as_they_are_while_they_walk() -> None:
    # At the ends they come close to each other; on the way they are 0.8 m abreast.
    across = np.full(40, 0.8)
    across[[0, -1]] = 0.1
    found = offsets_of(pair(np.column_stack([np.zeros(40), across])), np.array([1]), np.array([0]))
    np.testing.assert_allclose(found, [[0, 0.8, 0, 0.8, 0]], atol=0.05)


def test_a_companion_who_catches_up_gains_on_the_other_one() -> None:
    along = np.linspace(-1.5, -0.5, 40)
    crowd = pair(np.column_stack([along, np.full(40, -0.6)]), delay=2)
    found = offsets_of(crowd, np.array([1]), np.array([0]))[0]
    assert found[4] == pytest.approx(along[-1] - along[2], abs=0.01)
    assert found[0] == pytest.approx(2 * 0.5 + along[2], abs=1e-5)  # where it enters, late
    np.testing.assert_allclose(found[[1, 3]], -0.6, atol=1e-5)


def test_companions_who_change_sides_do_not_count_as_near() -> None:
    across = np.where(np.arange(40) < 28, 0.8, -0.8)
    crowd = pair(np.column_stack([np.zeros(40), across]))
    found = offsets_of(crowd, np.array([1]), np.array([0]))[0]
    np.testing.assert_allclose(found[[1, 3]], 0.8, atol=0.05)


def test_companions_stay_near_each_other_and_none_walks_into_another(
    fitted: PlannedAreas,
) -> None:
    links = replace(fitted.links, covariance=9 * fitted.links.covariance)
    events, _ = drawn(replace(fitted, links=links), 1_500)
    crowd = straight_walks(replace(events, wait_s=0 * events.wait_s), PLAZA)
    frame, person = crowd.row_frame(), crowd.row_person()
    apart = []
    for group in range(int(events.group.max()) + 1):
        first, second = np.flatnonzero(events.group == group)[:2].tolist()
        one, other = (dict(zip(frame[person == p].tolist(), crowd.path(p), strict=True))
                      for p in (first, second))  # fmt: skip
        apart += [np.hypot(*(one[t] - other[t])) for t in one.keys() & other.keys()]
    assert np.mean(np.array(apart) <= WITHIN_M) > 0.9
    assert np.mean(np.array(apart) >= 0.29) > 0.97


def test_companions_are_those_who_are_planned(fitted: PlannedAreas) -> None:
    """The rule that finds companions finds hardly any others among straight walkers."""
    events, _ = drawn(with_stops(fitted), 3_000)
    found, planned = groups_of(straight_walks(events, PLAZA)), events.group
    together = planned >= 0
    assert 0.2 < together.mean() < 0.8
    assert (found[together] >= 0).mean() > 0.93
    assert (found[~together] >= 0).mean() < 0.02
    sizes = [np.bincount(group[group >= 0]) for group in (planned, found)]
    planned_size, found_size = ((n * n).sum() / n.sum() for n in sizes)
    assert found_size == pytest.approx(planned_size, rel=0.03)


def test_a_crowd_that_enters_at_once_is_drawn_in_spite_of_companions_by_accident(
    fitted: PlannedAreas,
) -> None:
    time_s, area = np.zeros(400), np.zeros(400, dtype=np.int64)
    events = fitted.draw(time_s, area, PLAZA, np.random.default_rng(0))
    assert len(events) == 400
    assert np.isfinite(events.start).all()
    assert np.isfinite(events.goal).all()
