import numpy as np
import pytest
from comparisons import nobody, sample, score, whole
from strategies import crowd_of

from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.metrics import Place
from crowdbench.metrics.trips import Detour, Dwell, GoalShare, OriginDestination

TEN = whole(10)
TWENTY = whole(20, block_s=10.0)
TWO_AREAS = Place(spawn_areas=2, goal_areas=3, bounds_m=(0.0, 1.0, 0.0, 1.0))
# One is there at the start, one stays to the end.
SOME = crowd_of([(0, 3), (2, 5), (2, 9), (6, 7)], frames=10)


def going(ways: list[tuple[int, int]], left: bool = True) -> Trajectories:
    """People who go from one area to another, entering in frame 1."""
    return crowd_of(
        [(1, 2)] * len(ways),
        frames=10,
        persons={
            "spawn_area": [k for k, _ in ways],
            "goal_area": [g for _, g in ways],
            "left": [left] * len(ways),
        },
    )


def ending(*outcomes: str) -> Trajectories:
    """People who enter in frame 1 and end so."""
    persons = {"outcome": [OUTCOMES.index(outcome) for outcome in outcomes]}
    return crowd_of([(1, 2)] * len(outcomes), frames=10, persons=persons)


def along(*paths: list[tuple[float, float]]) -> Trajectories:
    """People who enter in frame 1 and walk along these points, one a frame."""
    return crowd_of([(1, len(path)) for path in paths], frames=20, xy=np.concatenate(paths))


def test_dwell_is_kaplan_meiers_over_those_who_enter():
    # Trips of 3 and 1, and one of 7 that is cut off: a third of the mass each.
    result = score(Dwell(), SOME, crowd_of([(1, 3)], frames=10), TEN)
    assert result.recorded == pytest.approx(11 / 3)
    assert result.simulated == pytest.approx(2.0)
    assert result.distance == pytest.approx((1 + 1 + 5) / 3 / (11 / 3))
    assert (result.n, result.unit) == (1, "s")


def test_dwell_shares_the_mass_of_a_life_cut_off_among_those_that_last_longer():
    # Trips of 1 and 3, one cut off after 2 in between: the life of 3 stands for both.
    crowd = crowd_of([(1, 2), (1, 3), (1, 4)], frames=10, persons={"left": [True, False, True]})
    assert score(Dwell(), crowd, crowd, TEN).recorded == pytest.approx(1 / 3 + 2 / 3 * 3)


def test_dwell_follows_lives_past_their_block():
    crowd = crowd_of([(2, 15), (11, 12)], frames=20)
    assert sample(Dwell(), crowd, TWENTY, name="ended") == [[13], [1]]


def test_dwell_keeps_lives_that_ended_from_lives_cut_off():
    assert sample(Dwell(), SOME, TEN, name="ended") == [[1, 3]]
    assert sample(Dwell(), SOME, TEN, name="censored") == [[7]]


def test_dwell_is_in_seconds():
    crowd = crowd_of([(2, 7)], frames=10, dt_s=0.4)
    assert score(Dwell(), crowd, crowd, whole(10, dt_s=0.4)).recorded == pytest.approx(2.0)


def test_nobody_dwells_a_block():
    result = score(Dwell(), SOME, nobody(), TEN)
    assert (result.simulated, result.n) == (10.0, 0)


def test_origin_destination_compares_the_shares_of_the_ways():
    recorded, simulated = going([(0, 1), (0, 1), (1, 0), (1, 0)]), going([(0, 1), (1, 2)])
    assert sample(OriginDestination(), recorded, TEN, TWO_AREAS) == [[1, 1, 3, 3]]
    result = score(OriginDestination(), recorded, simulated, TEN, TWO_AREAS)
    assert result.distance == pytest.approx((0.0 + 0.5 + 0.5) / 2)
    assert result.n == 2
    assert np.isnan(result.recorded)


def test_origin_destination_leaves_out_who_comes_from_or_goes_to_an_unknown_area():
    # An area that the place does not have is as unknown as none.
    crowd = going([(0, 1), (-1, 1), (0, -1), (2, 0), (0, 3), (5, 5)])
    assert sample(OriginDestination(), crowd, TEN, TWO_AREAS) == [[1]]


def test_origin_destination_leaves_out_who_did_not_leave():
    assert sample(OriginDestination(), going([(0, 1)], left=False), TEN, TWO_AREAS) == [[]]


def test_no_way_at_all_is_as_far_as_can_be():
    result = score(OriginDestination(), going([(0, 1), (1, 0)]), nobody(), TEN, TWO_AREAS)
    assert result.distance == pytest.approx(1.0)


def test_origin_destination_counts_in_the_block_of_the_entry():
    persons = {"spawn_area": [0, 1], "goal_area": [0, 0]}
    crowd = crowd_of([(2, 15), (11, 12)], frames=20, persons=persons)
    assert sample(OriginDestination(), crowd, TWENTY, TWO_AREAS) == [[0], [3]]


def test_detour_is_the_way_walked_over_the_straight_one():
    around = [(0, 0), (3, 0), (3, 4)]  # 7 m for 5
    straight = [(0, 0), (1, 1), (5, 5)]
    assert sample(Detour(), along(around, straight), TEN) == [[100, 140]]
    result = score(Detour(), along(around, straight), along(straight), TEN)
    assert result.recorded == pytest.approx(1.2)
    assert result.distance == pytest.approx(0.4 / 2 / 1.2)
    assert (result.n, result.unit) == (1, "")


def test_detour_leaves_out_who_ends_within_a_metre_of_the_start():
    there_and_back = [(0, 0), (5, 0), (0.9, 0)]
    a_metre = [(0, 0), (0, 1)]
    assert sample(Detour(), along(there_and_back, a_metre, [(3, 3)]), TEN) == [[100]]


def test_detours_end_at_a_hundred():
    far = [(0, 0), (0, 1000), (1, 0)]
    assert sample(Detour(), along(far), TEN) == [[10_000]]


def test_detour_leaves_out_who_did_not_enter_or_leave():
    ways = np.array([(0, 0), (2, 0)] * 3)
    crowd = crowd_of([(0, 1), (1, 2), (8, 9)], frames=10, xy=ways)
    assert sample(Detour(), crowd, TEN) == [[100]]


def test_nobody_walks_straight():
    assert score(Detour(), along([(0, 0), (3, 0), (3, 4)]), nobody(), TEN).simulated == 1.0


def test_goal_share_is_of_those_who_left_without_exit_or_timeout():
    crowd = ending("goal", "recorded", "unknown", "exit", "timeout")
    result = score(GoalShare(), ending("recorded"), crowd, TEN)
    assert (result.recorded, result.simulated) == (1.0, pytest.approx(0.6))
    assert result.distance == pytest.approx(0.4)
    assert result.n == 5


def test_goal_share_leaves_out_who_did_not_enter_or_leave():
    persons = {"outcome": [OUTCOMES.index(o) for o in ("exit", "goal", "horizon")]}
    crowd = crowd_of([(0, 1), (1, 2), (8, 9)], frames=10, persons=persons)
    assert GoalShare().summarise(crowd, TEN, TWO_AREAS)["share"].tolist() == [[1, 1]]


def test_goal_share_counts_in_the_block_of_the_entry():
    persons = {"outcome": [OUTCOMES.index("exit"), OUTCOMES.index("goal")]}
    crowd = crowd_of([(2, 15), (11, 12)], frames=20, persons=persons)
    assert GoalShare().summarise(crowd, TWENTY, TWO_AREAS)["share"].tolist() == [[0, 1], [1, 1]]
