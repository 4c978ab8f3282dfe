"""Stops and companions: made-up paths with known answers, and properties of both rules."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of, crowds, later

from crowdbench.data.companions import groups_of, with_companions
from crowdbench.data.stops import standing, stops_of
from crowdbench.data.table import Trajectories

DT = 0.4


def walk(*pieces: tuple[float, float]) -> np.ndarray:
    """Positions along x: pieces of (speed in m/s, duration in s), from 0 on."""
    speed = np.concatenate([np.full(round(duration / DT), v) for v, duration in pieces])
    x = np.concatenate([[0.0], np.cumsum(speed * DT)])
    return np.stack([x, np.zeros(len(x))], axis=1)


def crowd(*paths: np.ndarray, first: tuple[int, ...] = ()) -> Trajectories:
    """People who enter in these frames, by default in the second one of an observed interval."""
    begins = first or (1,) * len(paths)
    trips = [(b, b + len(path) - 1) for b, path in zip(begins, paths, strict=True)]
    return crowd_of(trips, xy=np.concatenate(paths), dt_s=DT)


def test_a_stop_is_found_with_its_place_and_duration() -> None:
    stops = stops_of(crowd(walk((1.2, 8), (0.0, 10), (1.2, 8)), walk((1.2, 8))))
    assert stops.person.tolist() == [0]
    # The displacement over 1.6 s is slow in all but half of that at either end.
    assert stops.duration_s[0] == pytest.approx(10 - 1.6, abs=0.5)
    np.testing.assert_allclose(stops.place[0], [9.6, 0], atol=0.1)


def test_short_stops_do_not_count() -> None:
    assert len(stops_of(crowd(walk((1.2, 8), (0.0, 3.2), (1.2, 8)))).person) == 0


def test_noise_does_not_end_a_stop() -> None:
    path = walk((1.2, 8), (0.0, 20), (1.2, 8))
    path += np.random.default_rng(1).normal(0, 0.05, path.shape)
    stops = stops_of(crowd(path))
    assert len(stops.person) == 1
    assert stops.duration_s[0] == pytest.approx(20 - 1.6, abs=1.0)


@pytest.mark.parametrize(("apart_s", "number"), [(2.0, 1), (8.0, 2)])
def test_people_who_shift_their_feet_stop_once(apart_s: float, number: int) -> None:
    path = walk((1.2, 4), (0.0, 8), (0.5, apart_s), (0.0, 8), (1.2, 4))
    assert len(stops_of(crowd(path)).person) == number


def test_stops_that_are_far_apart_are_two() -> None:
    path = walk((1.2, 4), (0.0, 8), (1.5, 3.2), (0.0, 8), (1.2, 4))
    assert len(stops_of(crowd(path)).person) == 2


@given(crowds())
def test_stops_are_runs_of_one_person(drawn: Trajectories) -> None:
    stops, person = stops_of(drawn), drawn.row_person()
    assert (person[stops.first] == stops.person).all()
    assert (person[stops.last] == stops.person).all()
    assert (stops.duration_s >= 4 - 1e-6).all()
    assert (np.diff(stops.first) > 0).all()
    assert standing(drawn)[stops.first].all()
    assert standing(drawn)[stops.last].all()


@given(crowds(), st.integers(0, 9))
def test_neither_rule_depends_on_the_time_of_day(drawn: Trajectories, frames: int) -> None:
    other = later(drawn, frames)
    np.testing.assert_array_equal(groups_of(drawn), groups_of(other))
    np.testing.assert_array_equal(stops_of(drawn).first, stops_of(other).first)


def beside(path: np.ndarray, metres: float) -> np.ndarray:
    return path + np.array([0.0, metres])


def test_companions_are_those_who_walk_close_and_alike() -> None:
    path = walk((1.2, 12))
    together = crowd(path, beside(path, 0.8), beside(path, 9.0), beside(path, 1.6))
    assert groups_of(together).tolist() == [0, 0, -1, 0]
    assert with_companions(together).group.tolist() == [0, 0, -1, 0]


def test_people_who_meet_are_no_companions() -> None:
    path = walk((1.2, 12))
    assert groups_of(crowd(path, beside(path[::-1], 0.5))).tolist() == [-1, -1]


def test_people_who_part_early_are_no_companions() -> None:
    path = walk((1.2, 12))
    leaves = path.copy()
    leaves[20:, 1] += 0.5 + np.arange(len(path) - 20)
    assert groups_of(crowd(path, leaves)).tolist() == [-1, -1]


@pytest.mark.parametrize(("late", "group"), [(15, 0), (16, -1)])
def test_companions_enter_within_six_seconds(late: int, group: int) -> None:
    slow, after = walk((0.2, 16)), walk((0.2, 16))
    enter = (1, 1 + late)
    assert groups_of(crowd(slow, beside(after, 0.5), first=enter)).tolist() == [group, group]


def test_people_who_were_there_before_observation_have_no_companions() -> None:
    path = walk((1.2, 12))
    others = (path, beside(path, 0.8), beside(path, 1.6), beside(path, 2.4))
    assert groups_of(crowd(*others, first=(0, 0, 1, 1))).tolist() == [-1, -1, 0, 0]


def test_a_glimpse_of_two_people_makes_no_group() -> None:
    path = walk((1.2, 3.2))
    assert groups_of(crowd(path, beside(path, 0.5))).tolist() == [-1, -1]


@given(crowds())
def test_groups_have_two_members_or_more_and_are_numbered_in_order(drawn: Trajectories) -> None:
    group = groups_of(drawn)
    members = np.bincount(group[group >= 0])
    assert (members >= 2).all()
    _, first = np.unique(group[group >= 0], return_index=True)
    assert (np.diff(first) > 0).all()


@given(crowds(dt_s=1.0))
def test_companions_are_those_that_comparing_everyone_finds(drawn: Trajectories) -> None:
    small = replace(drawn, xy=(drawn.xy / 25).astype(np.float32))  # so that people meet
    links = np.eye(len(small), dtype=bool)
    for a in range(len(small)):
        for b in range(a):
            links[a, b] = links[b, a] = are_companions(small, a, b)
    for _ in range(len(small)):
        links = links @ links
    group = groups_of(small)
    alone = links.sum(axis=1) == 1
    np.testing.assert_array_equal(group == -1, alone)
    same = (group[:, None] == group) & (group >= 0)
    np.testing.assert_array_equal(same | np.eye(len(small), dtype=bool), links)


def are_companions(crowd: Trajectories, a: int, b: int) -> bool:
    if abs(int(crowd.first[a]) - int(crowd.first[b])) > 6:
        return False
    if not (crowd.entered[a] and crowd.entered[b]):
        return False
    frames = range(
        int(max(crowd.first[a], crowd.first[b])), int(min(crowd.last[a], crowd.last[b])) + 1
    )
    if len(frames) < 5:
        return False

    def seen(p: int, t: int) -> tuple[np.ndarray, np.ndarray]:
        path, k = crowd.path(p).astype(np.float64), t - int(crowd.first[p])
        before, after = max(k - 1, 0), min(k + 1, len(path) - 1)
        return path[k], (path[after] - path[before]) / max(1, after - before)

    both = [(seen(a, t), seen(b, t)) for t in frames]
    near = [(u, v) for (x, u), (y, v) in both if np.hypot(*(x - y)) <= 2.0]
    relative = [np.hypot(*(u - v)) for u, v in near]
    return len(near) >= 0.8 * len(both) - 1e-9 and np.mean(relative) <= 0.5
