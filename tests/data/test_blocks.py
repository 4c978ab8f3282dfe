import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of, crowds, intervals

from crowdbench.data.blocks import SPLITS, TimeBlocks, cut

observations = st.integers(1, 400).flatmap(lambda frames: intervals(frames))


def blocks_of(observed: list, block_s: float, dt_s: float = 1.0, grid_s: float = 1.0) -> TimeBlocks:
    return cut(np.array(observed), block_s=block_s, dt_s=dt_s, grid_s=grid_s)


def frames_of(spans: list) -> list[int]:
    return [frame for start, stop in spans for frame in range(start, stop)]


@given(observations, st.floats(3, 200))
def test_each_observed_frame_is_in_one_block(observed, block_s):
    # A list keeps duplicates: a frame in two blocks would stand there twice.
    assert frames_of(blocks_of(observed, block_s).frames.tolist()) == frames_of(observed)


@given(observations, st.floats(3, 200))
def test_no_block_straddles_an_unobserved_gap(observed, block_s):
    for start, stop in blocks_of(observed, block_s).frames:
        assert any(a <= start < stop <= b for a, b in observed)


def test_blocks_are_as_near_the_wanted_length_as_can_be():
    lengths = np.diff(blocks_of([(0, 100), (200, 214)], 30.0).frames, axis=1)[:, 0]
    assert lengths.tolist() == [33, 34, 33, 14]


def test_a_block_opens_where_observation_begins():
    assert blocks_of([(0, 60), (70, 90)], 30.0).opens.tolist() == [True, False, True]


def test_arrivals_in_an_opening_frame_do_not_count():
    blocks = blocks_of([(0, 10), (20, 30)], 10.0)
    crowd = crowd_of([(0, 3), (1, 3), (20, 22), (21, 22)], persons={"entered": [True] * 4})
    persons, _, tick = blocks.of_arrivals(crowd)
    assert persons.tolist() == [1, 3]
    assert tick.tolist() == [1, 21]


def test_arrivals_in_the_first_frame_of_a_later_block_count():
    blocks = blocks_of([(0, 20)], 10.0)
    persons, block, _ = blocks.of_arrivals(crowd_of([(10, 12)], frames=20))
    assert persons.tolist() == [0]
    assert block.tolist() == [1]


def test_who_has_not_entered_is_no_arrival():
    crowd = crowd_of([(3, 5), (4, 5)], frames=10, persons={"entered": [False, True]})
    assert blocks_of([(0, 10)], 10.0).of_arrivals(crowd)[0].tolist() == [1]


def test_arrivals_where_nothing_was_observed_do_not_count():
    crowd = crowd_of([(12, 13), (22, 23)], frames=30, observed=[(0, 10), (20, 30)])
    assert blocks_of([(0, 10), (20, 30)], 10.0).of_arrivals(crowd)[0].tolist() == [1]


@pytest.mark.parametrize(
    ("spawn_s", "tick"), [(0.8, 1), (0.81, 2), (1.2, 2), (1.6, 2), (3 * 0.8, 3), (0.1 * 24, 3)]
)
def test_an_arrival_stands_at_the_next_point_of_the_annotation_grid(spawn_s, tick):
    crowd = crowd_of(
        [(int(np.ceil(spawn_s / 0.4)), 8)],
        frames=20,
        dt_s=0.4,
        grid_s=0.8,
        persons={"spawn_s": [spawn_s]},
    )
    blocks = blocks_of([(0, 20)], 8.0, dt_s=0.4, grid_s=0.8)
    assert blocks.of_arrivals(crowd)[2].tolist() == [tick]


def test_an_arrival_between_two_blocks_falls_into_the_one_of_its_grid_point():
    crowd = crowd_of([(10, 12)], frames=20, persons={"spawn_s": [9.5]})
    assert blocks_of([(0, 20)], 10.0).of_arrivals(crowd)[1].tolist() == [1]


def test_arrivals_come_by_time():
    crowd = crowd_of([(2, 9), (4, 9), (6, 9)], frames=10, persons={"spawn_s": [5.5, 3.5, 2.0]})
    _, _, tick = blocks_of([(0, 10)], 10.0).of_arrivals(crowd)
    assert tick.tolist() == [2, 4, 6]


def test_exposure_leaves_out_the_opening_frames():
    assert blocks_of([(0, 100), (150, 200)], 50.0, dt_s=0.4).exposure_s() == pytest.approx(59.2)


def test_folds_are_interleaved_and_each_block_is_scored_in_one():
    blocks = blocks_of([(0, 50), (60, 80)], 10.0)
    scored = [blocks.scored(split).frames.tolist() for split in SPLITS]
    assert scored[0] == blocks.frames.tolist()
    assert scored[1] == [[0, 10], [30, 40], [70, 80]]
    assert scored[2] == [[10, 20], [40, 50]]
    assert scored[3] == [[20, 30], [60, 70]]


@given(observations, st.floats(3, 200), st.sampled_from(SPLITS[1:]))
def test_no_block_is_both_trained_on_and_scored(observed, block_s, split):
    blocks = blocks_of(observed, block_s)
    both = blocks.scored(split).frames.tolist() + blocks.training(split).frames.tolist()
    assert sorted(both) == blocks.frames.tolist()
    assert blocks.training("full").frames.tolist() == blocks.frames.tolist()


@given(crowds(), intervals(30), st.floats(3, 20))
def test_parts_are_the_paths_within_the_blocks(crowd, observed, block_s):
    blocks = blocks_of(observed, block_s)
    parts = blocks.parts(crowd)
    inside = np.isin(crowd.row_frame(), frames_of(blocks.frames.tolist()))
    goal = crowd.goal[crowd.row_person()]

    def rows(frame, xy, goal):
        table = np.column_stack([frame, xy, goal])
        return table[np.lexsort(table.T)].tolist()

    expected = rows(crowd.row_frame()[inside], crowd.xy[inside], goal[inside])
    assert rows(parts.row_frame(), parts.xy, parts.goal[parts.row_person()]) == expected
    # A part is uninterrupted, and no longer than what is observed without a pause.
    pauses = np.setdiff1d(np.arange(crowd.frames), frames_of(blocks.frames.tolist()))
    for first, last in zip(parts.first, parts.last, strict=True):
        assert not ((first <= pauses) & (pauses <= last)).any()
    assert (np.diff(parts.first) >= 0).all()
    assert len(parts.offsets) == len(parts) + 1


def test_a_part_that_a_border_cuts_has_neither_entered_nor_left():
    parts = blocks_of([(0, 10), (20, 30)], 10.0).parts(crowd_of([(3, 25), (5, 8)], frames=40))
    assert parts.first.tolist() == [3, 5, 20]
    assert parts.last.tolist() == [9, 8, 25]
    assert parts.entered.tolist() == [True, True, False]
    assert parts.left.tolist() == [False, True, True]
