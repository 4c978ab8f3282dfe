from dataclasses import replace

import numpy as np
import pytest
import shapely
from comparisons import PLACE, nobody, score, whole
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import crowd_of

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Place
from crowdbench.metrics.interaction import Avoidance, OverlapRate, WallClearance, clearance
from crowdbench.metrics.kernels import encounters
from crowdbench.metrics.rows import nearest_neighbour_m
from crowdbench.scene import Walking

BESIDE_M = 0.3


def passing(*x: float, dt_s: float = 1.0, aside: float = BESIDE_M) -> Trajectories:
    """Someone stands at the origin; another walks past beside, at these x frame by frame."""
    stands = np.zeros((len(x), 2))
    walks = np.stack([x, np.full(len(x), aside)], axis=1)
    frames = len(x) - 1
    return crowd_of([(0, frames)] * 2, dt_s=dt_s, xy=np.concatenate([stands, walks]))


def found(crowd: Trajectories, blocks: TimeBlocks | None = None, **of: int) -> list[list[int]]:
    """Bins of the observed encounters in each block."""
    blocks = whole(crowd.frames, dt_s=crowd.dt_s) if blocks is None else blocks
    counts = Avoidance().summarise(crowd, blocks, replace(PLACE, walking=Walking(**of)))["observed"]
    return [np.repeat(np.arange(40), row).tolist() for row in counts]


def test_an_encounter_counts_once_with_its_closest_approach_between_ticks() -> None:
    # 0.25 m beside on the step from −1.75 to 0.25 m, though no tick is closer than 0.35 m.
    assert found(passing(-5.75, -3.75, -1.75, 0.25, 1.75, 4.25, aside=0.26)) == [[5]]


def test_the_step_that_leads_out_of_an_encounter_belongs_to_it() -> None:
    assert found(passing(-7.0, -5.0, -1.9, 5.0, 9.0)) == [[6]]


def test_who_passes_further_than_2_m_away_does_not_encounter() -> None:
    assert found(passing(-2.0, 0.0, 2.0, aside=2.01)) == [[]]


def test_people_who_walk_together_are_no_strangers() -> None:
    xy = np.array([(1.5 * t, y) for y in (0.0, 0.5) for t in range(6)])
    assert found(crowd_of([(0, 5), (0, 5)], xy=xy)) == [[]]


def test_strangers_are_told_by_the_mean_velocities_of_their_trips() -> None:
    slow, fast = ([v * (t - 8) for t in range(17)] for v in (0.69, 0.71))
    assert found(passing(*slow)) == [[]]
    assert found(passing(*fast)) == [[6]]


def test_whoever_creeps_near_others_stays_a_stranger() -> None:
    creeps = np.linspace(-1.9, 1.9, 20)  # 0.2 m/s
    assert found(passing(*np.arange(-30, -2, 2), *creeps, *np.arange(3, 30, 2))) == [[6]]


def test_two_people_who_part_and_meet_again_have_two_encounters() -> None:
    assert found(passing(-6, -4, -2, 0, 2, 4, 2, 0, 2, 4, 6, 8)) == [[6, 6]]


def test_each_pair_has_its_own_encounters() -> None:
    paths = [[(0, 0)] * 5, [(0.5, 0)] * 5, [(x, 0.26) for x in (-4, -2, 0, 2, 4)]]
    assert found(crowd_of([(0, 4)] * 3, xy=np.concatenate(paths))) == [[5, 5]]


def test_an_encounter_counts_in_the_block_of_its_minimum() -> None:
    crowd = passing(-7, -5, -3, -1.75, -1, 0, 1, 2.5)
    blocks = whole(8, block_s=4.0)
    assert found(crowd, blocks) == [[], [6]]
    assert found(crowd, blocks.take(np.array([0]))) == [[]]


def test_only_ticks_count() -> None:
    crowd = passing(*np.linspace(-6, 6, 25), dt_s=0.4)
    assert found(crowd, tick_frames=2) == found(crowd) == [[6]]


def crossing(number: int, seed: int) -> Trajectories:
    """People who cross a square of 20 m at any time in any direction, and see nobody."""
    rng = np.random.default_rng(seed)
    frames, dt_s = 2000, 0.4
    angle, aside = rng.uniform(0, 2 * np.pi, number), rng.uniform(-8, 8, number)
    steps = np.arange(40)[:, None] * 1.3 * dt_s - 10
    way = np.stack([np.cos(angle), np.sin(angle)])
    across = np.stack([-way[1], way[0]])
    xy = steps[:, None] * way + aside * across  # (40, 2, number)
    first = rng.integers(0, frames - 40, number)
    return crowd_of(
        [(int(f), int(f) + 39) for f in first],
        frames=frames,
        dt_s=dt_s,
        xy=xy.transpose(2, 0, 1).reshape(-1, 2),
    )


@pytest.mark.parametrize("seed", range(3))
def test_people_who_ignore_each_other_avoid_nobody(seed: int) -> None:
    crowd = crossing(1500, seed)
    result = score(Avoidance(), crowd, crowd, whole(2000, dt_s=0.4))
    assert result.n > 1000
    assert abs(result.recorded) < 0.03


def test_people_who_keep_apart_are_seen_to() -> None:
    # Those who would come closer than 0.8 m to anybody do not come.
    crowd = crossing(900, 7)
    at, frame = crowd.xy.astype(np.float64), crowd.row_frame()
    person, shy = crowd.row_person(), np.zeros(len(crowd), dtype=bool)
    for f in range(crowd.frames):
        here = np.flatnonzero((frame == f) & ~shy[person])
        gap = np.hypot(*(at[here, None] - at[here]).transpose(2, 0, 1)) + 9 * np.eye(len(here))
        a, _ = np.nonzero(gap < 0.8)
        shy[person[here[a]]] = True
    kept = np.flatnonzero(~shy)
    distant = crowd_of(
        [(int(crowd.first[p]), int(crowd.last[p])) for p in kept],
        frames=crowd.frames,
        dt_s=0.4,
        xy=np.concatenate([crowd.path(int(p)) for p in kept]),
    )
    result = score(Avoidance(), distant, crowd, whole(2000, dt_s=0.4))
    assert result.recorded < -0.15
    assert result.distance > 0.15


def test_without_encounters_there_is_no_avoidance() -> None:
    crowd = crossing(300, 1)
    result = score(Avoidance(), crowd, nobody(), whole(2000, dt_s=0.4))
    assert (result.simulated, result.n) == (0.0, 0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 2**31), st.sampled_from([0, 1, -2]))
def test_encounters_are_those_that_comparing_everyone_finds(seed: int, shift: int) -> None:
    rng = np.random.default_rng(seed)
    first = rng.integers(0, 6, 6)
    size = rng.integers(1, 8, 6)
    person = np.repeat(np.arange(6), size)
    tick = np.concatenate([f + np.arange(n) for f, n in zip(first, size, strict=True)])
    xy = rng.uniform(-3, 3, (len(person), 2))
    velocity = rng.uniform(-1, 1, (6, 2))[person]
    order = np.lexsort((xy[:, 0], tick))
    begins = np.concatenate([[0], np.cumsum(np.bincount(tick))])
    closest, index = encounters(xy, velocity, person, order, begins, shift, 2.0, 0.7)
    expected = by_hand(xy, velocity, person, tick, shift)
    assert sorted(tick[index].tolist()) == sorted(tick[at] for at, _ in expected)
    np.testing.assert_allclose(np.sort(closest), np.sort([m for _, m in expected]), atol=1e-8)


def by_hand(
    xy: np.ndarray, velocity: np.ndarray, person: np.ndarray, tick: np.ndarray, shift: int
) -> list[tuple[int, float]]:
    """Index and closest approach of all encounters of strangers, pair by pair."""
    result = []
    for a in range(6):
        for b in range(6):
            if a == b or (shift == 0 and b < a):
                continue
            i, j = np.flatnonzero(person == a), np.flatnonzero(person == b)
            both = [(p, q) for p in i for q in j if tick[p] == tick[q] + shift]
            near = [np.hypot(*(xy[p] - xy[q])) <= 2.0 for p, q in both]
            k = 0
            while k < len(both):
                if not near[k]:
                    k += 1
                    continue
                stop = k
                while stop < len(both) and near[stop]:
                    stop += 1
                run = both[k:stop]
                if np.hypot(*(velocity[run[0][0]] - velocity[run[0][1]])) > 0.7:
                    result.append(_closest(xy, both, k, stop))
                k = stop
    return sorted(result)


def _closest(
    xy: np.ndarray, both: list[tuple[int, int]], start: int, stop: int
) -> tuple[int, float]:
    """Index of the position, and distance, at the closest approach."""
    best = (np.inf, 0)
    for k in range(max(0, start - 1), min(len(both) - 1, stop)):
        (p, q), (r, s) = both[k], both[k + 1]
        gap, to = xy[p] - xy[q], xy[r] - xy[s]
        way = to - gap
        t = np.clip(-(gap @ way) / max(way @ way, 1e-12), 0, 1)
        at = r if k < start else p
        best = min(best, (float(np.hypot(*(gap + t * way))), int(at)))
    for p, q in both[start:stop]:
        best = min(best, (float(np.hypot(*(xy[p] - xy[q]))), int(p)))
    return best[1], round(best[0], 9)


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


SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
WALLED = Place(spawn_areas=0, goal_areas=0, bounds_m=PLACE.bounds_m, walls=(SQUARE,))


def test_clearance_is_the_distance_to_the_nearest_wall_up_to_2_m() -> None:
    # Inside, 0.3 m beside, at a corner, far away.
    xy = np.array([(0.5, 0.5), (1.3, 0.5), (1.3, 1.4), (9, 9)])
    crowd = crowd_of([(0, 3)], xy=xy)
    counts = WallClearance().summarise(crowd, whole(4, block_s=2.0), WALLED)["counts"]
    each = [np.repeat(np.arange(counts.shape[1]), row).tolist() for row in counts]
    assert each == [[0, 6], [10, 40]]
    result = score(WallClearance(), crowd, nobody(), whole(4), WALLED)
    assert result.recorded == pytest.approx((0 + 0.3 + 0.5 + 2) / 4)
    assert result.simulated == 2.0


def test_where_there_are_no_walls_everyone_is_2_m_away() -> None:
    place = Place(spawn_areas=0, goal_areas=0, bounds_m=PLACE.bounds_m)
    counts = WallClearance().summarise(crowd_of([(0, 3)]), whole(4), place)["counts"]
    assert counts[0, 40] == 4


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


@settings(max_examples=40, deadline=None)
@given(POSITIONS, st.lists(st.tuples(*[st.integers(-5, 5).map(float)] * 2), max_size=3))
def test_clearance_is_what_a_library_finds(
    xy: np.ndarray, corners: list[tuple[float, float]]
) -> None:
    walls = tuple(((x, y), (x + 2.0, y), (x + 1.0, y + 3.0)) for x, y in corners)
    edges = [(x + t, y - d) for x, y in corners for t in (0.0, 1.3) for d in (0.0, 0.02, 1.999)]
    spots = np.array([*xy, *edges, (1e30, 0)])
    solid = shapely.union_all([shapely.Polygon(wall) for wall in walls])
    gap = np.minimum(np.nan_to_num(shapely.distance(solid, shapely.points(spots)), nan=2.0), 2.0)
    np.testing.assert_allclose(clearance(walls, spots), gap, atol=1e-9)


@pytest.mark.parametrize(
    ("spot", "expected"),
    [((0.0, 0.0), 0.0), ((2.9, 2.9), 0.0), ((4.0, 0.0), 1.0), ((9.0, 0.0), 2.0)],
)
def test_deep_inside_a_wall_the_clearance_is_0(spot: tuple[float, float], expected: float) -> None:
    wall = ((-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0))
    inner = ((-0.2, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.2, 0.2))  # its edges are no way out
    for walls in ((wall,), (wall, inner)):
        assert clearance(walls, np.array([spot])).tolist() == pytest.approx([expected])
