import numpy as np
import pytest
from comparisons import PLACE, nobody, sample, score, whole
from strategies import crowd_of

from crowdbench.data.table import Trajectories
from crowdbench.metrics.groups import CompanionDistance, CompanionOffset, CompanionShare, GroupSize

DT_S = 0.4
BLOCKS = whole(31, dt_s=DT_S)
PATH = np.stack([1.2 * DT_S * np.arange(30), np.zeros(30)], axis=1)


def beside(path: np.ndarray, metres: float) -> np.ndarray:
    return path + np.array([0.0, metres])


def together(*paths: np.ndarray) -> Trajectories:
    """People on these paths, who enter after the first frame and stay to the last one."""
    trips = [(31 - len(path), 30) for path in paths]
    return crowd_of(trips, dt_s=DT_S, xy=np.concatenate(paths))


PAIR_AND_STRANGER = together(PATH, beside(PATH, 0.75), beside(PATH[::-1], 3))


def test_companions_are_measured_and_strangers_are_not() -> None:
    counts = CompanionDistance().summarise(PAIR_AND_STRANGER, BLOCKS, PLACE)["counts"]
    assert counts.nonzero()[1].tolist() == [15]
    assert counts.sum() == 30


def test_companions_who_come_later_are_compared_frame_by_frame() -> None:
    crowd = together(PATH, beside(PATH[5:], 0.5))
    counts = CompanionDistance().summarise(crowd, BLOCKS, PLACE)["counts"]
    assert counts.nonzero()[1].tolist() == [10]
    assert counts.sum() == 25


def test_the_share_and_the_sizes_are_those_of_persons() -> None:
    assert CompanionShare().summarise(PAIR_AND_STRANGER, BLOCKS, PLACE)["share"].tolist() == [
        [2, 3]
    ]
    assert sample(GroupSize(), PAIR_AND_STRANGER, BLOCKS) == [[2, 2]]
    three = together(PATH, beside(PATH, 0.75), beside(PATH, 1.5), beside(PATH[::-1], 4))
    assert sample(GroupSize(), three, BLOCKS) == [[3, 3, 3]]
    result = score(GroupSize(), PAIR_AND_STRANGER, three, BLOCKS)
    assert (result.recorded, result.simulated) == (2.0, 3.0)
    assert result.distance == pytest.approx(0.5)
    assert score(CompanionShare(), PAIR_AND_STRANGER, three, BLOCKS).distance == pytest.approx(
        3 / 4 - 2 / 3
    )


def test_an_offset_is_the_distance_across_the_direction_of_walking() -> None:
    """One walks 0.6 m ahead and 0.5 m to the side of the other, on a diagonal."""
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    one = PATH @ turn
    other = (PATH + np.array([0.6, 0.5])) @ turn
    counts = CompanionOffset().summarise(together(one, other), BLOCKS, PLACE)["counts"]
    assert counts.nonzero()[1].tolist() == [10]
    assert counts.sum() == 28  # at the first and last tick there is no direction
    distance = CompanionDistance().summarise(together(one, other), BLOCKS, PLACE)["counts"]
    assert distance.nonzero()[1].tolist() == [round(np.hypot(0.6, 0.5) / 0.05)]


def test_people_who_stand_have_no_direction() -> None:
    stands = np.zeros((30, 2))
    crowd = together(stands, beside(stands, 0.75))
    assert CompanionDistance().summarise(crowd, BLOCKS, PLACE)["counts"].sum() == 30
    assert CompanionOffset().summarise(crowd, BLOCKS, PLACE)["counts"].sum() == 0


def test_a_crowd_without_companions_is_one_of_single_people_far_apart() -> None:
    assert score(GroupSize(), PAIR_AND_STRANGER, nobody(), BLOCKS).simulated == 1.0
    assert score(CompanionDistance(), PAIR_AND_STRANGER, nobody(), BLOCKS).simulated == 5.0
