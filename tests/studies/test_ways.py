"""Ways by their labels: which are common, who shows them, and what their means are."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from crowdbench.data.table import OUTCOMES, Trajectories, from_rows
from studies.figures.ways import (
    FRACTIONS,
    by_fraction,
    common_ways,
    entries,
    examples,
    mean_way,
    sides,
    walking,
)


def drawn(*ways: tuple[int, int]) -> Trajectories:
    """People who walk from one area to another, two frames each."""
    frame = np.repeat(np.arange(len(ways)), 2) + np.tile([1, 2], len(ways))
    xy = np.stack([frame, frame], axis=1).astype(float)
    crowd = from_rows(
        scene="drawn", dt_s=0.4, frames=len(ways) + 4, where="test", frame=frame,
        person_id=np.repeat(np.arange(len(ways)), 2), xy=xy,
    )  # fmt: skip
    areas = np.array(ways)
    return replace(crowd, spawn_area=areas[:, 0], goal_area=areas[:, 1])


def test_the_commonest_ways_come_first() -> None:
    crowd = drawn((0, 1), (2, 0), (2, 0), (0, 1), (2, 0), (1, 1), (-1, 0), (-1, 0), (-1, 0))
    assert common_ways(crowd, 2).tolist() == [[2, 0], [0, 1]]
    assert examples(crowd, common_ways(crowd, 2)) == [[1, 2, 4], [0, 3]]


def test_who_does_not_arrive_walks_no_way() -> None:
    crowd = drawn((0, 1), (0, 1), (0, 1))
    ends = np.array([OUTCOMES.index(how) for how in ("goal", "exit", "timeout")])
    assert walking(replace(crowd, outcome=ends), 0, 1).tolist() == [0]


def test_people_are_known_by_when_and_where_they_were_to_enter() -> None:
    crowd = drawn((0, 1), (0, 1))
    assert entries(crowd) == [(0.4, 1.0, 1.0), (0.8, 2.0, 2.0)]


def test_a_path_is_taken_by_its_length_and_not_by_its_time() -> None:
    path = np.array([[0, 0], [0, 0], [0, 0], [3, 0], [4, 0]], dtype=np.float32)
    assert by_fraction(path)[:, 0] == pytest.approx(4 * FRACTIONS)


def test_who_stands_still_has_a_way_all_the_same() -> None:
    assert (by_fraction(np.ones((1, 2), np.float32)) == 1).all()
    assert (sides(np.ones((len(FRACTIONS), 2))) == 0).all()


def test_a_mean_lies_between_its_people_and_knows_how_far_aside_they_walk() -> None:
    low, high = (np.array([[0, y], [8, y]], dtype=np.float32) for y in (-1, 1))
    found = mean_way([low, high])
    assert found.people == 2
    assert found.mean[:, 1] == pytest.approx(np.zeros(len(FRACTIONS)))
    assert found.across_m == pytest.approx(np.ones(len(FRACTIONS)))


@given(arrays(np.float32, (5, 2), elements=st.integers(-50, 50)), st.integers(1, 4))
def test_the_mean_of_equals_is_each_of_them(path: np.ndarray, people: int) -> None:
    found = mean_way([path] * people)
    assert found.mean == pytest.approx(by_fraction(path))
    assert found.across_m == pytest.approx(np.zeros(len(FRACTIONS)), abs=1e-9)
    assert found.mean[[0, -1]] == pytest.approx(path[[0, -1]])
