import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from strategies import crowd_of, crowds, differences, reordered

from crowdbench.data.table import PERSON_COLUMNS, Trajectories, from_rows
from crowdbench.errors import RecordingError


def rows(person_id: list[int], frame: list[int], xy: list, **further: object) -> Trajectories:
    return from_rows(
        scene="here",
        dt_s=0.5,
        person_id=np.array(person_id, dtype=np.int64),
        frame=np.array(frame, dtype=np.int64),
        xy=np.array(xy, dtype=np.float64).reshape(-1, 2),
        where="table.csv",
        **further,
    )


def test_persons_stand_by_first_frame_then_id():
    crowd = rows([9, 9, 4, 3], [1, 0, 1, 1], [[0, 0]] * 4)
    assert crowd.person_id.tolist() == [9, 3, 4]
    assert crowd.first.tolist() == [0, 1, 1]


def test_who_asked_to_enter_first_within_a_frame_stands_first():
    # Arrivals on a grid finer than frames: 3 waited for long, 4 and 5 asked at the same time.
    asked = {"requested_s": np.array([2.5, 1.25, 2.25, 2.25, 2.0])}
    crowd = rows([1, 3, 5, 4, 9], [5, 5, 5, 5, 4], [[0, 0]] * 5, persons=asked)
    assert crowd.person_id.tolist() == [9, 3, 4, 5, 1]
    assert crowd.requested_s.tolist() == [2.0, 1.25, 2.25, 2.25, 2.5]


def test_who_entered_first_stands_first_where_nobody_waited():
    crowd = rows([1, 2], [5, 5], [[0, 0]] * 2, persons={"spawn_s": np.array([2.5, 2.25])})
    assert crowd.person_id.tolist() == [2, 1]
    assert crowd.requested_s.tolist() == crowd.spawn_s.tolist() == [2.25, 2.5]


@given(crowds())
def test_persons_are_sorted_by_frame_then_asked_entry_then_id(crowd):
    order = np.lexsort((crowd.person_id, crowd.requested_s, crowd.first))
    assert order.tolist() == list(range(len(crowd)))


def test_path_holds_a_persons_rows_by_frame():
    crowd = rows([1, 2, 1, 1], [5, 4, 3, 4], [[5, 0], [9, 9], [3, 0], [4, 0]])
    assert crowd.path(0).tolist() == [[3, 0], [4, 0], [5, 0]]


def test_frames_missing_within_a_person_are_interpolated():
    crowd = rows([1, 1], [2, 6], [[0, 8], [4, 0]])
    assert crowd.path(0).tolist() == [[0, 8], [1, 6], [2, 4], [3, 2], [4, 0]]


def test_who_is_there_when_observation_begins_has_not_entered():
    crowd = crowd_of([(0, 5), (1, 5), (8, 9), (9, 9)], frames=12, observed=[(0, 6), (8, 12)])
    assert crowd.entered.tolist() == [False, True, False, True]


def test_who_is_there_when_observation_ends_has_not_left():
    crowd = crowd_of([(0, 5), (1, 4), (8, 11), (9, 10)], frames=12, observed=[(0, 6), (8, 12)])
    assert crowd.left.tolist() == [False, True, False, True]


def test_columns_of_the_table_overrule_what_the_frames_say():
    crowd = crowd_of([(0, 3)], frames=4, persons={"entered": [True], "left": [True]})
    assert crowd.entered.tolist() == crowd.left.tolist() == [True]


def test_entry_is_the_first_row_unless_told_otherwise():
    crowd = rows([1, 2, 2], [3, 4, 5], [[0, 0]] * 3)
    assert crowd.spawn_s.tolist() == crowd.requested_s.tolist() == [1.5, 2.0]


def test_present_counts_frames_without_anyone():
    assert crowd_of([(1, 2), (2, 4)], frames=7).present().tolist() == [0, 1, 2, 1, 1, 0, 0]


def test_mean_speed_is_path_length_over_life():
    crowd = rows([1, 1, 1, 2], [0, 1, 2, 0], [[0, 0], [3, 4], [3, 4], [7, 7]])
    np.testing.assert_allclose(crowd.mean_speeds(), [5 / 1.0, np.nan])


def test_duration_includes_what_was_not_observed():
    assert crowd_of([(0, 1)], frames=10, observed=[(0, 2)], dt_s=0.4).duration_s == 4.0


@given(crowds())
def test_present_is_who_came_minus_who_is_gone(crowd: Trajectories):
    frame = np.arange(crowd.frames)
    came = (crowd.first[:, None] <= frame).sum(axis=0)
    gone = (crowd.last[:, None] < frame).sum(axis=0)
    np.testing.assert_array_equal(crowd.present(), came - gone)


@given(crowds())
def test_each_row_has_its_person_and_frame(crowd: Trajectories):
    expected = [
        (person, frame)
        for person in range(len(crowd))
        for frame in range(crowd.first[person], crowd.last[person] + 1)
    ]
    got = zip(crowd.row_person().tolist(), crowd.row_frame().tolist(), strict=True)
    assert list(got) == expected


@given(crowds())
def test_start_and_end_are_the_first_and_last_of_the_path(crowd: Trajectories):
    for person in range(len(crowd)):
        assert crowd.path(person)[0].tolist() == crowd.start[person].tolist()
        assert crowd.path(person)[-1].tolist() == crowd.end[person].tolist()


@given(crowds(), st.randoms(use_true_random=False))
def test_the_order_of_rows_does_not_matter(crowd: Trajectories, random):
    order = list(range(len(crowd.xy)))
    random.shuffle(order)
    rebuilt = from_rows(
        scene=crowd.scene,
        dt_s=crowd.dt_s,
        grid_s=crowd.grid_s,
        frames=crowd.frames,
        observed=crowd.observed,
        person_id=crowd.person_id[crowd.row_person()][order],
        frame=crowd.row_frame()[order],
        xy=crowd.xy[order],
        persons={name: getattr(crowd, name)[crowd.row_person()][order] for name in PERSON_COLUMNS},
        provenance=crowd.provenance,
        where="test",
    )
    assert differences(rebuilt, crowd) == []


@given(crowds(), st.data())
def test_the_order_of_persons_does_not_change_who_is_present(crowd: Trajectories, data):
    order = data.draw(st.permutations(range(len(crowd))))
    np.testing.assert_array_equal(reordered(crowd, order).present(), crowd.present())


@pytest.mark.parametrize(
    ("person_id", "frame", "xy", "frames", "got", "expected"),
    [
        ([], [], [], None, "no rows", "at least one row"),
        ([7, 8], [0, 3], [[0, 0], [np.nan, 0]], None, "person 8 in frame 3", "finite"),
        ([7], [0], [[0, np.inf]], None, "1 rows whose position is not finite", "finite"),
        ([7], [-2], [[0, 0]], None, "frames -2 to -2", "frames from 0"),
        ([7], [10], [[0, 0]], 10, "frames 10 to 10", "frames from 0 to 9"),
        ([7, 7, 8], [4, 4, 4], [[0, 0]] * 3, None, "person 7 twice in frame 4", "one position"),
    ],
    ids=["empty", "nan", "infinite", "before 0", "past the end", "duplicate"],
)
def test_rows_that_make_no_crowd_are_refused(person_id, frame, xy, frames, got, expected):
    with pytest.raises(RecordingError) as caught:
        rows(person_id, frame, xy, frames=frames)
    assert caught.value.where == "table.csv"
    assert got in caught.value.got
    assert expected in caught.value.expected
