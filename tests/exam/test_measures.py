"""Times, flows, densities and speeds of made-up crowds whose values are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from crowdbench.data.table import Trajectories, from_rows
from crowdbench.exam.measures import (
    crossed_s,
    densities,
    flow_per_s,
    last_left_s,
    left_s,
    nearest_m,
    speed_within,
    started_s,
)

DT = 0.4


def walking(
    starts: np.ndarray, velocities: np.ndarray, steps: int, frames: int | None = None
) -> Trajectories:
    """People who walk straight on from frame 0 on."""
    frame = np.tile(np.arange(steps + 1), len(starts))
    person = np.repeat(np.arange(len(starts)), steps + 1)
    xy = starts[person] + velocities[person] * frame[:, None] * DT
    return from_rows(scene="x", dt_s=DT, person_id=person, frame=frame, xy=xy, where="test",
                     frames=frames)  # fmt: skip


def test_crossings_are_timed_between_frames() -> None:
    crowd = walking(np.array([[0.0, 0.0], [0.0, 3.0], [0.0, 0.5]]),
                    np.array([[1.0, 0.0], [1.0, 0.0], [0.0, 0.0]]), 10)  # fmt: skip
    times = crossed_s(crowd, (1.5, -1.0, 1.5, 1.0))
    np.testing.assert_allclose(times, [1.5, np.inf, np.inf], atol=1e-6)


@settings(max_examples=50, deadline=None)
@given(angle=st.floats(0, 6.28), along=st.floats(0.1, 0.9), after=st.floats(0.2, 3.0))
def test_a_line_of_any_direction_is_crossed_from_both_sides(
    angle: float, along: float, after: float
) -> None:
    a, way = np.array([1.0, 2.0]), np.array([np.cos(angle), np.sin(angle)])
    across = np.array([-way[1], way[0]])
    line = (*a, *(a + 2 * way))
    for side in (1.0, -1.0):
        start = (a + 2 * along * way - side * after * across)[None]
        times = crossed_s(walking(start, side * across[None], 15), line)
        assert times[0] == pytest.approx(after, abs=1e-4)


def test_the_first_of_several_crossings_counts() -> None:
    x = np.array([0.0, 1.0, 0.0, 1.0])
    crowd = from_rows(scene="x", dt_s=DT, person_id=np.zeros(4, int), frame=np.arange(4),
                      xy=np.stack([x, 0 * x], axis=1), where="test")  # fmt: skip
    assert crossed_s(crowd, (0.5, -1.0, 0.5, 1.0))[0] == pytest.approx(0.5 * DT)


def test_a_steady_flow_is_measured() -> None:
    assert flow_per_s(np.arange(100) / 2.5) == pytest.approx(2.5)
    late = np.r_[np.arange(100) / 2.5, np.full(50, np.inf)]
    assert flow_per_s(late) == pytest.approx(2.5)
    assert np.isnan(flow_per_s(np.arange(9.0)))
    assert np.isnan(flow_per_s(np.full(20, np.inf)))


def test_who_is_present_at_the_end_has_not_left() -> None:
    crowd = walking(np.zeros((1, 2)), np.ones((1, 2)), 5, frames=7)
    assert left_s(crowd)[0] == pytest.approx(5 * DT)
    assert last_left_s(crowd) == pytest.approx(5 * DT)
    assert last_left_s(walking(np.zeros((1, 2)), np.ones((1, 2)), 5)) == np.inf


def test_densities_and_speeds_in_a_rectangle() -> None:
    starts = np.array([[0.5, 0.5], [1.5, 0.5], [9.0, 0.5]])
    crowd = walking(starts, np.array([[0.0, 0.0], [0.0, 0.0], [0.0, 1.0]]), 4)
    np.testing.assert_allclose(densities(crowd, (0, 0, 2, 2)), 0.5)
    assert speed_within(crowd, (0, 0, 2, 2), 0.0, 2.0) == 0
    assert speed_within(crowd, (8, 0, 10, 2), 0.0, 2.0) == pytest.approx(1.0)
    assert np.isnan(speed_within(crowd, (20, 20, 22, 22), 0.0, 2.0))
    assert np.isnan(speed_within(crowd, (8, 0, 10, 2), 5.0, 6.0))


def test_starts_and_nearest_people() -> None:
    crowd = walking(np.array([[0.0, 0.0], [0.0, 1.0]]), np.array([[1.0, 0.0], [0.0, 0.0]]), 5)
    np.testing.assert_allclose(started_s(crowd, 0.75), [0.8, np.inf])
    assert nearest_m(crowd) == pytest.approx(1.0)
    assert nearest_m(walking(np.zeros((1, 2)), np.zeros((1, 2)), 3)) == np.inf
