import numpy as np
import pytest
from comparisons import BLOCKS, PLACE, any_crowds, nobody, sample, score, whole
from hypothesis import given
from strategies import crowd_of, later

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.neighbour_kernels import from_left_to_right
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Place
from crowdbench.metrics.rows import nearest_neighbour_m
from crowdbench.metrics.space import GoalDensity, NearestNeighbour, Occupancy, StartDensity

THREE = whole(3)
SQUARE = Place(spawn_areas=0, goal_areas=0, bounds_m=(0.0, 2.0, 0.0, 2.0))
"""Cells of 1 m from −1 to 3 in both directions, 16 in all."""


def standing(*points: tuple[float, float], frames: int = 3) -> Trajectories:
    """People who stand at these points all the time."""
    xy = np.repeat(np.array(points), frames, axis=0)
    return crowd_of([(0, frames - 1)] * len(points), xy=xy)


def walking(*points: tuple[float, float]) -> Trajectories:
    """One person who is at these points, one a frame."""
    return crowd_of([(0, len(points) - 1)], xy=np.array(points))


def test_occupancy_compares_the_shares_of_time_in_each_cell():
    recorded = walking((0.2, 0.5), (0.9, 0.1), (1.0, 0.5))
    simulated = walking((0.5, 0.5), (1.5, 1.5), (1.7, 1.2))
    assert sample(Occupancy(), recorded, THREE, SQUARE) == [[5, 5, 9]]
    assert sample(Occupancy(), simulated, THREE, SQUARE) == [[5, 10, 10]]
    result = score(Occupancy(), recorded, simulated, THREE, SQUARE)
    assert result.distance == pytest.approx((1 / 3 + 1 / 3 + 2 / 3) / 2)
    assert result.n == 3


def test_occupancy_has_cells_on_whole_metres_below_zero_too():
    place = Place(spawn_areas=0, goal_areas=0, bounds_m=(-1.5, -0.5, 0.0, 1.0))  # x from −3
    crowd = walking((-1.5, 0.5), (-1.0, 0.5), (-0.1, 0.5))
    assert sample(Occupancy(), crowd, THREE, place) == [[4, 7, 7]]


def test_occupancy_tells_a_cell_that_a_bound_cuts_from_the_margin():
    place = Place(spawn_areas=0, goal_areas=0, bounds_m=(0.5, 1.5, 0.0, 1.0))  # x to 3
    crowd = walking((0.2, 0.5), (1.7, 0.5), (2.2, 0.5))
    assert sample(Occupancy(), crowd, THREE, place) == [[4, 7, 10]]


def test_occupancy_gathers_what_is_beyond_the_bounds_in_a_margin_of_one_cell():
    crowd = walking((-0.5, 0.5), (-7.0, 0.5), (1.5, 1e30))
    assert sample(Occupancy(), crowd, THREE, SQUARE) == [[1, 1, 11]]


def test_densities_are_of_the_first_and_last_points_of_trips() -> None:
    points = [(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)]
    crowd = crowd_of([(1, 2), (2, 3)], frames=4, xy=np.array(points))
    assert sample(StartDensity(), crowd, whole(4), SQUARE) == [[5, 10]]
    assert sample(GoalDensity(), crowd, whole(4), SQUARE) == [[9]]  # the other one is still there


def test_occupancy_looks_at_the_frames_of_the_blocks_only():
    blocks = TimeBlocks(np.array([[0, 1], [2, 3]]), np.array([0, 2]), 1.0, 1.0)
    crowd = walking((0.5, 0.5), (0.5, 1.5), (1.5, 1.5))
    assert sample(Occupancy(), crowd, blocks, SQUARE) == [[5], [10]]


def test_nobody_is_nowhere():
    assert score(Occupancy(), standing((1, 1)), nobody(), THREE, SQUARE).distance == 1


def test_nearest_neighbour_compares_distances_to_the_nearest():
    recorded = standing((0, 0), (1, 0), (1, 2))
    simulated = standing((0, 0), (0, 2))
    assert sample(NearestNeighbour(), recorded, THREE) == [[100] * 6 + [200] * 3]
    result = score(NearestNeighbour(), recorded, simulated, THREE)
    assert result.recorded == pytest.approx(4 / 3)
    assert result.simulated == pytest.approx(2.0)
    assert result.distance == pytest.approx(2 / 3 / (4 / 3))
    assert (result.n, result.unit) == (6, "m")


def test_who_is_alone_in_a_frame_has_no_nearest_neighbour():
    crowd = crowd_of([(0, 2), (1, 1)], xy=np.array([(0, 0), (0, 0), (0, 0), (3, 4)]))
    assert sample(NearestNeighbour(), crowd, THREE) == [[500, 500]]


def test_people_on_the_same_spot_are_neighbours():
    assert sample(NearestNeighbour(), standing((2, 2), (2, 2), (2, 2)), THREE) == [[0] * 9]


def test_where_all_are_alone_neighbours_are_50_m_away():
    result = score(NearestNeighbour(), standing((0, 0), (1, 0)), standing((0, 0)), THREE)
    assert (result.simulated, result.n) == (50.0, 0)
    assert result.distance == pytest.approx(49.0)


def test_no_neighbour_is_further_away_than_none():
    crowd = standing((0, 0), (300, 0))
    assert sample(NearestNeighbour(), crowd, THREE) == [[5000] * 6]


def test_nearest_neighbours_count_in_the_block_of_their_frame():
    blocks = TimeBlocks(np.array([[0, 1], [2, 3]]), np.array([0, 2]), 1.0, 1.0)
    xy = np.array([(0, 0)] * 3 + [(1, 0), (2, 0), (3, 0)])
    crowd = crowd_of([(0, 2), (0, 2)], xy=xy)
    assert sample(NearestNeighbour(), crowd, blocks) == [[100, 100], [300, 300]]


@given(any_crowds)
def test_positions_are_sorted_by_frame_then_x_then_index(crowd):
    # Many share an x, and trips may pause: rows of some frames are left out.
    for rows in (np.arange(len(crowd.xy)), np.flatnonzero(crowd.row_frame() % 3 != 1)):
        frame, x = crowd.row_frame()[rows], crowd.xy[rows, 0].round()
        order, begins = from_left_to_right(frame, crowd.row_person()[rows], x)
        assert order.tolist() == np.lexsort((x, frame)).tolist()
        assert begins.tolist() == [0, *np.cumsum(np.bincount(frame))]


def gaps(crowd: Trajectories) -> np.ndarray:
    """Distance of each row to each, infinite to itself and to other frames."""
    xy, frame = crowd.xy.astype(np.float64), crowd.row_frame()
    gap = np.linalg.norm(xy[:, None] - xy[None], axis=2)
    gap[frame[:, None] != frame[None]] = np.inf
    np.fill_diagonal(gap, np.inf)
    return gap


@given(any_crowds)
def test_neighbours_are_those_that_a_search_through_all_finds(crowd):
    # Frames far from 0 test that the search in space and time keeps its precision.
    late, gap = later(crowd, 40_000), gaps(crowd)
    np.testing.assert_allclose(nearest_neighbour_m(late), gap.min(axis=1), rtol=1e-12)


@given(any_crowds)
def test_occupancy_counts_each_row_of_the_blocks_once(crowd):
    counts = Occupancy().summarise(crowd, BLOCKS, PLACE)["counts"]
    frame = crowd.row_frame()
    expected = [((start <= frame) & (frame < stop)).sum() for start, stop in BLOCKS.frames]
    assert counts.sum(axis=1).tolist() == expected
