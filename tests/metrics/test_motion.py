"""Motion: made-up paths with known values, and the noise that must not matter."""

from dataclasses import replace

import numpy as np
import pytest
from comparisons import PLACE, nobody, sample, score, whole
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of, crowds

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Place, total
from crowdbench.metrics.motion import Acceleration, Deviation, Pace, Speed, Turning
from crowdbench.scene import Walking

DT_S = 0.4
ROWS = 41
NOISE_M = 0.05
HISTOGRAMS = [Speed(), Pace(), Deviation()]
T = np.arange(ROWS) * DT_S


def walking(*paths: np.ndarray, dt_s: float = DT_S, first: int = 1) -> Trajectories:
    """People who enter in frame `first` and are at these points, one a frame."""
    trips = [(first, first + len(path) - 1) for path in paths]
    frames = max(last for _, last in trips) + 2
    return crowd_of(trips, dt_s=dt_s, frames=frames, xy=np.concatenate(paths))


def lags(metric: Acceleration | Turning, crowd: Trajectories, place: Place = PLACE) -> list[float]:
    """The values at each lag, m/s²."""
    blocks = whole(crowd.frames, dt_s=crowd.dt_s)
    sums = total(metric.summarise(crowd, blocks, place))
    return metric.embed(sums, np.zeros(1, np.int64), blocks).tolist()


def typical(metric: Speed | Pace | Deviation, crowd: Trajectories) -> float:
    return score(metric, crowd, crowd, whole(crowd.frames, dt_s=crowd.dt_s)).recorded


def noisy(path: np.ndarray, people: int = 200, sigma_m: float = NOISE_M) -> Trajectories:
    rng = np.random.default_rng(5)
    return walking(*(path + rng.normal(0, sigma_m, path.shape) for _ in range(people)))


STRAIGHT = np.stack([1.4 * T, 0 * T], axis=1)
RADIUS_M, OMEGA = 5.0, 1.25 / 5.0
CIRCLE = RADIUS_M * np.stack([np.cos(OMEGA * T), np.sin(OMEGA * T)], axis=1)
BRAKING = np.stack([1.6 * T - 0.025 * T**2, 0 * T], axis=1)
LENGTH_M = 1.4 * T[-1]
HALF_SINE = np.stack([1.4 * T, np.sin(np.pi * 1.4 * T / LENGTH_M)], axis=1)


def test_a_straight_walk_has_a_speed_and_nothing_else() -> None:
    crowd = walking(STRAIGHT)
    assert typical(Speed(), crowd) == pytest.approx(1.4)
    assert typical(Pace(), crowd) == typical(Deviation(), crowd) == 0
    assert lags(Acceleration(), crowd) == pytest.approx([0] * 3, abs=1e-3)
    assert lags(Turning(), crowd) == pytest.approx([0] * 3, abs=1e-3)


@pytest.mark.parametrize("sigma_m", [0.025, 0.05, 0.1])
def test_white_noise_of_the_positions_cancels(sigma_m: float) -> None:
    crowd = noisy(STRAIGHT, sigma_m=sigma_m)
    # Its standard error falls with the square root of 200 people and 30 products.
    limit = 0.02 * max(1.0, sigma_m / NOISE_M)
    assert max(lags(Acceleration(), crowd)) < limit
    assert max(lags(Turning(), crowd)) < limit


def test_the_noise_of_speeds_is_that_of_a_slope_through_nine_points() -> None:
    crowd = noisy(STRAIGHT)
    # |v| deviates by |N(0, .3227 σ/s)|, less a bit for the mean of the trip itself.
    assert typical(Pace(), crowd) == pytest.approx(0.0125, abs=0.0012)
    assert typical(Deviation(), crowd) == pytest.approx(0.053, rel=0.05)
    assert typical(Speed(), crowd) == pytest.approx(1.4, abs=0.01)


def test_on_a_circle_all_values_are_known() -> None:
    crowd = walking(CIRCLE)
    expected = [
        2 * RADIUS_M * (1 - np.cos(OMEGA * k * DT_S)) / (k * DT_S) ** 2 * np.cos(OMEGA * DT_S / 2)
        for k in PLACE.walking.lags_ticks
    ]
    assert expected == pytest.approx([0.3098, 0.3080, 0.3029], abs=2e-4)
    assert lags(Turning(), crowd) == pytest.approx(expected, rel=1e-3)
    assert lags(Acceleration(), crowd) == pytest.approx([0] * 3, abs=0.01)
    assert typical(Deviation(), crowd) == pytest.approx(6.92, rel=0.02)
    assert typical(Pace(), crowd) == 0


def test_noise_changes_a_circle_little() -> None:
    crowd = noisy(CIRCLE)
    assert lags(Turning(), crowd) == pytest.approx([0.3098, 0.3080, 0.3029], rel=0.02)
    assert typical(Deviation(), crowd) == pytest.approx(6.91, rel=0.02)


def test_turning_to_either_side_is_the_same() -> None:
    assert lags(Turning(), walking(CIRCLE)) == lags(Turning(), walking(CIRCLE * [1, -1]))


def test_braking_is_acceleration_along_the_path() -> None:
    crowd = walking(BRAKING)
    assert lags(Acceleration(), crowd) == pytest.approx([0.05] * 3, rel=0.02)
    assert lags(Turning(), crowd) == pytest.approx([0] * 3, abs=1e-3)
    assert typical(Pace(), crowd) == pytest.approx(0.165, rel=0.02)


def test_a_half_sine_deviates_by_its_amplitude() -> None:
    for crowd, error in ((walking(HALF_SINE), 0.001), (noisy(HALF_SINE), 0.008)):
        assert typical(Deviation(), crowd) == pytest.approx(1.0, abs=0.005)
        assert lags(Turning(), crowd) == pytest.approx([0.029, 0.030, 0.031], abs=error)
    assert typical(Pace(), walking(HALF_SINE)) == pytest.approx(0.003, abs=0.002)


def test_people_who_stand_turn_nowhere() -> None:
    jerk = np.zeros((ROWS, 2))
    jerk[20:] += [0.3, 0.2]
    crowd = walking(jerk)
    assert lags(Turning(), crowd) == [0.0] * 3
    assert max(lags(Acceleration(), crowd)) > 0


@pytest.mark.parametrize("metric", [Acceleration(), Turning()])
def test_products_keep_to_one_trip(metric: Acceleration | Turning) -> None:
    # Two trips, one after the other in the table, far apart: their ends share no product.
    place = replace(PLACE, walking=Walking(lags_ticks=(3,)))
    blocks = whole(60, dt_s=DT_S)
    both = metric.summarise(walking(STRAIGHT, STRAIGHT + np.array([500, 0])), blocks, place)[
        "lag 3"
    ]
    one = metric.summarise(walking(STRAIGHT), blocks, place)["lag 3"]
    assert both.tolist() == (2 * one).tolist()
    assert one[0, 1] == ROWS - 2 * 3 - 1


def test_frames_between_ticks_do_not_count() -> None:
    # Every second position is interpolated: wrong ones change nothing.
    place = replace(PLACE, walking=Walking(tick_frames=2))
    wrong = CIRCLE.copy()
    wrong[1::2] += 9.0  # odd rows, in even frames for a first frame of 1
    even, odd = (walking(path, first=2) for path in (CIRCLE, wrong))
    for metric in (*HISTOGRAMS, Acceleration(), Turning()):
        blocks = whole(even.frames, dt_s=DT_S)
        one, other = (metric.summarise(crowd, blocks, place) for crowd in (even, odd))
        assert {n: v.tolist() for n, v in one.items()} == {n: v.tolist() for n, v in other.items()}


def test_only_full_windows_have_a_speed() -> None:
    assert sample(Speed(), walking(STRAIGHT[:9]), whole(11, dt_s=DT_S)) == [[140]]
    assert sample(Speed(), walking(STRAIGHT[:8]), whole(11, dt_s=DT_S)) == [[]]


def test_deviation_is_that_of_whole_trips_of_3_m() -> None:
    blocks = whole(60, dt_s=DT_S)
    assert sample(Deviation(), walking(HALF_SINE), blocks) == [[100]]
    assert sample(Deviation(), walking(HALF_SINE[:6]), blocks) == [[]]  # 2.8 m
    cut_off = replace(walking(HALF_SINE), left=np.array([False]))
    assert sample(Deviation(), cut_off, blocks) == [[]]


def test_values_count_in_the_block_of_their_middle() -> None:
    blocks = TimeBlocks(np.array([[1, 7], [7, 60]]), np.array([1, 1]), DT_S, DT_S)
    counts = [len(values) for values in sample(Speed(), walking(STRAIGHT), blocks)]
    assert counts == [2, ROWS - 8 - 2]  # the first middle is frame 5
    products = Turning().summarise(walking(STRAIGHT), blocks, PLACE)["lag 3"]
    assert products[:, 1].tolist() == [3, ROWS - 7 - 3]


def test_speeds_are_compared_relative_to_the_recordings() -> None:
    slow, fast = (walking(np.stack([v * T, 0 * T], axis=1)) for v in (1.0, 1.5))
    result = score(Speed(), slow, fast, whole(50, dt_s=DT_S))
    assert (result.recorded, result.simulated) == (pytest.approx(1.0), pytest.approx(1.5))
    assert result.distance == pytest.approx(0.5)
    assert (result.n, result.unit) == (ROWS - 8, "m/s")


@pytest.mark.parametrize("metric", [Acceleration(), Turning()])
def test_accelerations_are_compared_lag_by_lag(metric: Acceleration | Turning) -> None:
    swerving = walking(np.stack([1.4 * T, 2 * np.sin(0.5 * T)], axis=1))
    blocks = whole(swerving.frames, dt_s=DT_S)
    result = score(metric, swerving, nobody(), blocks)
    assert result.distance == pytest.approx(1.0)
    assert result.n == 0


def test_a_leap_across_the_world_counts_as_the_fastest_there_is() -> None:
    # Otherwise one broken row of a table would need a histogram larger than memory.
    leap = STRAIGHT.copy()
    leap[20:] += 1e30
    crowd = walking(leap)
    assert max(sample(Speed(), crowd, whole(50, dt_s=DT_S))[0]) == 10_000
    assert np.isfinite(lags(Acceleration(), crowd)).all()


@given(crowds(dt_s=DT_S), st.sampled_from([1, 2]))
def test_products_are_those_of_their_formula(crowd: Trajectories, tick: int) -> None:
    place = replace(PLACE, walking=Walking(tick_frames=tick, lags_ticks=(2,)))
    blocks = whole(crowd.frames, dt_s=DT_S)
    along, across, number = 0.0, 0.0, 0
    for person in range(len(crowd)):
        frames = crowd.first[person] + np.arange(len(crowd.path(person)))
        x = crowd.path(person)[frames % tick == 0].astype(np.float64)
        span_s = 2 * tick * DT_S
        for t in range(2, len(x) - 3):
            one, two = ((x[s + 2] - 2 * x[s] + x[s - 2]) / span_s**2 for s in (t, t + 1))
            way = x[t + 3] - x[t - 2]
            number += 1
            if np.hypot(*way) < 0.3 * 5 * tick * DT_S:
                along += one @ two
                continue
            u = way / np.hypot(*way)
            v = np.array([-u[1], u[0]])
            along += (one @ u) * (two @ u)
            across += (one @ v) * (two @ v)
    expected = {"acceleration": along, "turning": across}
    for metric in (Acceleration(), Turning()):
        sums = metric.summarise(crowd, blocks, place)["lag 2"]
        assert sums[:, 1].sum() == number
        assert sums[:, 0].sum() * 1e-6 == pytest.approx(
            expected[metric.name], rel=1e-6, abs=1e-6 * (number + 1)
        )
