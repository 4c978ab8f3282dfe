import numpy as np
import pytest
import shapely
from comparisons import PLACE, nobody, sample, score, whole
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import crowd_of

from crowdbench.metrics import ClosestApproach, OverlapRate, Place, WallHits
from crowdbench.metrics.interaction import touching
from crowdbench.metrics.rows import nearest_neighbour_m, pairs_within
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

BESIDE_M = 0.3


def passing(*x: float, dt_s: float = 1.0) -> Trajectories:
    """Someone stands at the origin; another walks past 0.3 m beside, at these x frame by frame."""
    stands = np.zeros((len(x), 2))
    walks = np.stack([x, np.full(len(x), BESIDE_M)], axis=1)
    frames = len(x) - 1
    return crowd_of([(0, frames)] * 2, dt_s=dt_s, xy=np.concatenate([stands, walks]))


def approaches(crowd: Trajectories, blocks: TimeBlocks | None = None) -> list[list[int]]:
    blocks = whole(crowd.frames, dt_s=crowd.dt_s) if blocks is None else blocks
    return sample(ClosestApproach(), crowd, blocks)


def test_an_encounter_counts_once_with_its_closest_approach():
    # Within 2 m in three frames; hypot(0.25, 0.3) is 0.39 m.
    assert approaches(passing(-5.75, -3.75, -1.75, 0.25, 1.75, 4.25)) == [[39]]


def test_closest_approaches_are_compared_relative_to_the_recordings():
    near, far = passing(-4, -2, 0, 2, 4), passing(-5, -3, -1, 1, 3)
    result = score(ClosestApproach(), near, far, whole(5))
    assert (result.recorded, result.simulated) == (pytest.approx(0.3), pytest.approx(1.04))
    assert result.distance == pytest.approx(0.74 / 0.3)
    assert (result.n, result.unit) == (1, "m")


def test_who_passes_further_than_2_m_away_does_not_encounter():
    xy = np.array([(0, 0)] * 3 + [(-2, 2.01), (0, 2.01), (2, 2.01)])
    assert approaches(crowd_of([(0, 2), (0, 2)], xy=xy)) == [[]]


def test_people_who_walk_together_are_no_strangers():
    xy = np.array([(1.5 * t, y) for y in (0.0, 0.5) for t in range(6)])
    assert approaches(crowd_of([(0, 5), (0, 5)], xy=xy)) == [[]]


def test_strangers_move_fast_against_each_other_for_most_of_the_encounter():
    # Speeds within 2 m: 1, then 0.75, then 0 in the last frame of the life.
    assert approaches(passing(-3.5, -1.5, -1.5, 0.0, 0.0)) == [[30]]  # 1, .75, .75, 0
    assert approaches(passing(-3.5, -1.5, -1.5, -1.5)) == [[]]  # 1, 0, 0


def test_half_of_an_encounter_is_not_most_of_it():
    assert approaches(passing(-3.5, -1.5, -1.5)) == [[]]  # 1, 0
    assert approaches(passing(-3.5, -1.5, 0.0, 0.0)) == [[30]]  # 1.75, .75, 0


def test_the_speed_that_makes_strangers_is_0_7_metres_per_second():
    slow, fast = ([v * (t - 8) for t in range(17)] for v in (0.69, 0.71))
    assert approaches(passing(*slow)) == [[]]
    assert approaches(passing(*fast)) == [[30]]


def test_velocities_are_those_of_a_life():
    # Three are seen once, two of them side by side: no row tells that anyone moves.
    assert approaches(crowd_of([(0, 0)] * 3, xy=np.array([(50, 0), (0, 0), (0.5, 0)]))) == [[]]


def test_two_people_who_part_and_meet_again_have_two_encounters():
    assert approaches(passing(-4, -2, 0, 2, 4, 6, 4, 2, 0.5, -2, -4)) == [[30, 58]]


def test_each_pair_has_its_own_encounters():
    # One walks past two who stand 0.5 m apart, who are no strangers to each other.
    paths = [[(0, 0)] * 5, [(0.5, 0)] * 5, [(x, 0.25) for x in (-4, -2, 0, 2, 4)]]
    crowd = crowd_of([(0, 4)] * 3, xy=np.concatenate(paths))
    assert approaches(crowd) == [[25, 56]]


def test_an_encounter_counts_in_the_block_of_its_minimum():
    # It begins in frame 3, in the first block, and is closest in frame 5, in the second.
    crowd = passing(-7, -5, -3, -1.75, -1, 0, 1, 2.5)
    blocks = whole(8, block_s=4.0)
    assert approaches(crowd, blocks) == [[], [30]]
    assert approaches(crowd, blocks.take(np.array([0]))) == [[]]


def test_the_first_of_equal_minima_counts():
    # 1 m before and 1 m after, on both sides of an edge.
    assert approaches(passing(-5, -3, -1, 1, 3, 5), whole(6, block_s=3.0)) == [[104], []]


def test_a_crowd_without_encounters_passes_2_m_apart():
    result = score(ClosestApproach(), passing(-4, -2, 0, 2, 4), nobody(), whole(5))
    assert (result.simulated, result.n) == (2.0, 0)
    assert result.distance == pytest.approx(1.7 / 0.3)


def test_overlap_is_a_share_of_the_frames_of_people_who_are_not_alone():
    # Alone in frame 0, then 0.59 m, 0.61 m and 1 m apart.
    xy = np.array([(0, 0)] * 4 + [(0.59, 0), (0, 0.61), (1, 0)])
    crowd = crowd_of([(0, 3), (1, 3)], xy=xy)
    assert OverlapRate().summarise(crowd, whole(4), PLACE)["share"].tolist() == [[2, 6]]


def test_overlap_depends_on_the_radius():
    crowd = crowd_of([(0, 0), (0, 0)], xy=np.array([(0.0, 0.0), (0.5, 0.0)]))
    thin = Place(spawn_areas=0, goal_areas=0, bounds_m=PLACE.bounds_m, radius_m=0.2)
    assert score(OverlapRate(), crowd, crowd, whole(1)).recorded == 1
    assert score(OverlapRate(), crowd, crowd, whole(1), thin).recorded == 0


def test_more_and_less_overlap_are_both_a_distance():
    apart, close, half = (
        crowd_of([(0, 1), (0, 1)], xy=np.array([(0, 0), (0, 0), (a, 0), (b, 0)]))
        for a, b in ((1, 1), (0.1, 0.1), (0.1, 1))
    )
    assert score(OverlapRate(), half, apart, whole(2)).distance == pytest.approx(0.5)
    assert score(OverlapRate(), half, close, whole(2)).distance == pytest.approx(0.5)


def test_wall_hits_are_frames_within_2_cm_of_a_wall():
    # The wall reaches from 0 to 1 m: in it, 1.9 cm beside, 2.1 cm beside, far away.
    square = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
    place = Place(spawn_areas=0, goal_areas=0, bounds_m=PLACE.bounds_m, walls=(square,))
    xy = np.array([(0.5, 0.5), (1.019, 0.5), (1.021, 0.5), (3, 3)])
    crowd = crowd_of([(0, 3)], xy=xy)
    blocks = whole(4, block_s=2.0)
    assert WallHits().summarise(crowd, blocks, place)["share"].tolist() == [[2, 2], [0, 2]]
    result = score(WallHits(), crowd, nobody(), blocks, place)
    assert result.distance == result.recorded == pytest.approx(0.5)


def test_where_there_are_no_walls_none_is_hit():
    place = Place(spawn_areas=0, goal_areas=0, bounds_m=PLACE.bounds_m)
    crowd = crowd_of([(0, 3)])
    assert WallHits().summarise(crowd, whole(4), place)["share"].tolist() == [[0, 4]]


POSITIONS = st.integers(0, 2**31).map(
    lambda seed: np.random.default_rng(seed).uniform(-6, 6, (40, 2)).round(2)
)


@settings(max_examples=40, deadline=None)
@given(POSITIONS, st.integers(1, 5))
def test_neighbours_are_those_that_comparing_everyone_finds(xy, frames):
    # Many share a place, an x or a distance: positions are whole centimetres, rounded coarsely.
    xy = np.where(xy > 0, xy.round(), xy)[: 40 // frames * frames]
    crowd = crowd_of([(0, frames - 1)] * (len(xy) // frames), xy=xy)
    frame, at = crowd.row_frame(), crowd.xy.astype(np.float64)
    gap = np.hypot(*(at[:, None] - at[None]).transpose(2, 0, 1))
    gap[(frame[:, None] != frame) | np.eye(len(at), dtype=bool)] = np.inf
    np.testing.assert_allclose(nearest_neighbour_m(crowd), gap.min(axis=1), rtol=1e-15)
    found = {tuple(pair) for pair in pairs_within(crowd, 2.0).tolist()}
    assert found == {(a, b) for a, b in np.argwhere(gap <= 2.0).tolist() if a < b}


@settings(max_examples=40, deadline=None)
@given(POSITIONS, st.lists(st.tuples(*[st.integers(-5, 5).map(float)] * 2), max_size=3))
def test_touching_a_wall_is_being_within_2_cm_of_one(xy, corners):
    walls = tuple(((x, y), (x + 2.0, y), (x + 1.0, y + 3.0)) for x, y in corners)
    edges = [(x + t, y - d) for x, y in corners for t in (0.0, 1.3) for d in (0.0, 0.019, 0.021)]
    spots = np.array([*xy, *edges, (1e30, 0)], np.float32)
    solid = shapely.union_all([shapely.Polygon(wall) for wall in walls])
    near = shapely.distance(solid, shapely.points(spots.astype(np.float64))) <= 0.02
    assert touching(walls, spots).tolist() == near.tolist()
