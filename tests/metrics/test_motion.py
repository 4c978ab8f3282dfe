import numpy as np
import pytest
from comparisons import nobody, sample, score, whole
from strategies import crowd_of

from crowdbench.metrics import Acceleration, Speed, Turning
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

DT_S = 0.4
MOTION = [Speed(), Acceleration(), Turning()]
each_metric = pytest.mark.parametrize("metric", MOTION, ids=lambda metric: metric.name)


def walking(xy: np.ndarray | list, dt_s: float = DT_S, first: int = 0) -> Trajectories:
    """One person who is at these points, one a frame."""
    return crowd_of([(first, first + len(xy) - 1)], dt_s=dt_s, xy=np.array(xy, dtype=np.float64))


def circling(radius_m: float, turn: float, frames: int = 50) -> Trajectories:
    """A walk on a circle, by the angle `turn` (radians) a frame."""
    angle = turn * np.arange(frames)
    return walking(radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=1))


def typical(metric, crowd: Trajectories) -> float:
    return score(metric, crowd, crowd, whole(crowd.frames, dt_s=crowd.dt_s)).recorded


def test_on_a_circle_speed_acceleration_and_turning_are_known():
    crowd = circling(5.0, 0.2)
    speed = 5.0 * 0.2 / DT_S
    # A chord is shorter than its arc: sin(.2)/.2 is 0.993, (sin(.1)/.1)² is 0.997.
    assert typical(Speed(), crowd) == pytest.approx(speed, rel=0.01)
    assert typical(Acceleration(), crowd) == pytest.approx(speed**2 / 5.0, rel=0.01)
    assert typical(Turning(), crowd) == pytest.approx(np.degrees(0.2), abs=0.5)


def test_turning_to_either_side_is_the_same():
    assert typical(Turning(), circling(5.0, -0.4)) == typical(Turning(), circling(5.0, 0.4)) == 23


def test_a_steady_walk_has_speed_and_nothing_else():
    crowd = walking([(0.5 * t, -0.25 * t) for t in range(12)])
    assert sample(Speed(), crowd, whole(12, dt_s=DT_S)) == [[140] * 10]  # hypot(1.25, 0.625)
    assert sample(Acceleration(), crowd, whole(12, dt_s=DT_S)) == [[0] * 10]
    assert sample(Turning(), crowd, whole(12, dt_s=DT_S)) == [[0] * 10]


def test_motion_is_taken_over_two_frames_of_0_4_s():
    crowd = walking([(0, 0), (0.4, 0), (0.4, 0.8)])
    one = whole(3, dt_s=DT_S)
    assert sample(Speed(), crowd, one) == [[112]]  # hypot(.4, .8) m in 0.8 s
    assert sample(Acceleration(), crowd, one) == [[559]]  # hypot(.4, .8) m over 0.4 s twice
    assert sample(Turning(), crowd, one) == [[90]]


@each_metric
def test_who_stands_has_no_speed_no_acceleration_and_no_direction(metric):
    values = sample(metric, walking([(3, 4)] * 5), whole(5, dt_s=DT_S))
    assert values == ([[]] if metric.name == "turning" else [[0, 0, 0]])


@pytest.mark.parametrize(("step_m", "counts"), [(0.079, False), (0.081, True)])
def test_turning_looks_at_steps_of_0_2_metres_per_second(step_m, counts):
    # One of the two ways is slow: that is enough to know no direction.
    crowd = walking([(0, 0), (1, 0), (1, step_m)])
    assert sample(Turning(), crowd, whole(3, dt_s=DT_S)) == [[90] if counts else []]


def test_who_turns_back_turns_by_half_a_circle():
    crowd = walking([(0, 0), (1, 0), (0, 0)])
    assert sample(Turning(), crowd, whole(3, dt_s=DT_S)) == [[180]]


@each_metric
def test_both_ends_of_a_span_lie_within_a_life(metric):
    # Two people, one after the other, far apart: no way leads from one to the other.
    xy = np.array([(0, 0), (1, 0), (2, 0), (50, 50), (51, 50), (70, 0)])
    crowd = crowd_of([(0, 2), (3, 4), (5, 5)], dt_s=DT_S, xy=xy)
    assert len(sample(metric, crowd, whole(6, dt_s=DT_S))[0]) == 1


@each_metric
def test_frames_count_by_their_middle(metric):
    # Ways lead past a block's edge, and begin where nothing is looked at.
    blocks = TimeBlocks(np.array([[2, 4], [4, 5]]), np.array([True, False]), DT_S, DT_S)
    crowd = walking([(t, 0) for t in range(10)])
    assert [len(values) for values in sample(metric, crowd, blocks)] == [2, 1]


@pytest.mark.parametrize(
    ("dt_s", "half"), [(0.1, 4), (0.2, 2), (0.4, 1), (4 / 9, 1), (1.0, 1), (1 / 9, 4)]
)
def test_the_span_is_an_even_number_of_frames_next_to_0_8_s(dt_s, half):
    crowd = walking([(t * dt_s, 0) for t in range(20)], dt_s=dt_s)
    assert sample(Speed(), crowd, whole(20, dt_s=dt_s)) == [[100] * (20 - 2 * half)]


def test_speeds_are_compared_relative_to_the_recordings():
    slow, fast = (walking([(v * DT_S * t, 0) for t in range(9)]) for v in (1.0, 1.5))
    result = score(Speed(), slow, fast, whole(9, dt_s=DT_S))
    assert (result.recorded, result.simulated) == (pytest.approx(1.0), pytest.approx(1.5))
    assert result.distance == pytest.approx(0.5)
    assert (result.n, result.unit) == (7, "m/s")


@each_metric
def test_nobody_does_not_move(metric):
    crowd = circling(5.0, 0.2)
    result = score(metric, crowd, nobody(), whole(50, dt_s=DT_S))
    assert (result.simulated, result.n) == (0.0, 0)
    assert result.distance == pytest.approx(1.0)


def test_a_leap_across_the_world_counts_as_the_fastest_there_is():
    # Otherwise one broken row of a table would need a histogram larger than memory.
    crowd = walking([(0, 0), (1e30, 0), (0, 0)])
    leap = walking([(0, 0), (1, 0), (1e30, 0)])
    assert sample(Acceleration(), crowd, whole(3, dt_s=DT_S)) == [[100_000]]
    assert sample(Speed(), leap, whole(3, dt_s=DT_S)) == [[10_000]]
