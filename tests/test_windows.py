"""Windows of a crowd: what is counted in them, what shows something, and what is most alike."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS
from strategies import crowd_of

from crowdbench.figures.situations import search
from crowdbench.figures.windows import GROUP_S, WINDOW_S, Windows, situations
from crowdbench.trajectories import Trajectories

FRAMES = 200


def crowd(arrivals: list[tuple[int, int, int]]) -> Trajectories:
    """People by entry, spawn area and goal area, in frames of 1 s, who stay for 5 s."""
    first, spawn, goal = (list(column) for column in zip(*arrivals, strict=True))
    persons = {"entered": [True] * len(first), "spawn_area": spawn, "goal_area": goal}
    return crowd_of([(f, f + 4) for f in first], frames=FRAMES, persons=persons)


def people() -> st.SearchStrategy[Trajectories]:
    one = st.tuples(st.integers(1, FRAMES - 5), st.integers(-1, 1), st.integers(-1, 1))
    return st.lists(one, min_size=1, max_size=40).map(sorted).map(crowd)


def window_at(windows: Windows, frame: int) -> int:
    return int(np.flatnonzero(windows.start == frame)[0])


def test_what_happens_is_counted_in_people() -> None:
    found = Windows.of(crowd([(3, 0, 1), (4, 0, 1), (4, 0, 1), (4, 1, 0), (50, 0, 1)]), AREAS)
    k = window_at(found, 2)
    assert found.entered[k] == 4
    assert found.largest[k] == 2
    assert found.alone[k] == 2
    assert found.members[k, :3].tolist() == [3, 1, 0]
    ways = found.ways[k].reshape(3, 3)
    assert ways[0, 1] == 3
    assert ways[1, 0] == 1
    assert found.present[k, :8].tolist() == [0, 1, 4, 4, 4, 4, 3, 0]


@given(people())
def test_each_arrival_is_counted_where_it_happens(of: Trajectories) -> None:
    found = Windows.of(of, AREAS)
    assert found.frames == WINDOW_S
    for k, start in enumerate(found.start.tolist()):
        inside = (of.first >= start) & (of.first < start + found.frames)
        assert found.entered[k] == inside.sum() == found.ways[k].sum()
        groups = np.stack([of.spawn_area, of.first], axis=1)[inside]
        sizes = np.unique(groups, axis=0, return_counts=True)[1]
        assert found.largest[k] == sizes.max(initial=0)
        assert found.alone[k] == (sizes == 1).sum()


@given(people(), people(), st.data())
def test_distances_are_distances(
    one: Trajectories, other: Trajectories, data: st.DataObject
) -> None:
    a, b = Windows.of(one, AREAS), Windows.of(other, AREAS)
    i, j, k = (data.draw(st.integers(0, len(a) - 1)) for _ in range(3))
    assert (a.apart(a, i)[i] == 0).all()
    assert a.apart(b, j)[i] == pytest.approx(b.apart(a, i)[j])
    assert (a.apart(b, j)[i] <= a.apart(a, k)[i] + a.apart(b, j)[k] + 1e-9).all()


@given(people())
def test_what_is_most_alike_a_window_is_itself(of: Trajectories) -> None:
    found = Windows.of(of, AREAS)
    for kind, (k, _) in situations(found, AREAS).items():
        best = search([found], found, k, 2)
        assert best.best[0].distance == 0, kind
        assert best.each == [0]
        first, second = (found.start[match.window] for match in best.best)
        assert abs(first - second) >= found.frames


def test_groups_are_those_of_the_same_moment_on_any_grid() -> None:
    """Two who come a ninth of a second apart are one group where arrivals are known so well."""
    of = replace(
        crowd([(8, 0, 1), (8, 0, 1), (8, 0, 1)]),
        grid_s=1 / 9,
        spawn_s=np.array([8.0, 8.0 + 1 / 9, 8.0 + GROUP_S]),
    )
    assert Windows.of(of, AREAS).members[:, :3].max(axis=0).tolist() == [2, 1, 0]


def test_windows_lie_in_what_was_observed() -> None:
    of = replace(
        crowd([(3, 0, 1), (120, 0, 1)]), observed=np.array([[0, 50], [55, 70], [100, 200]])
    )
    start = Windows.of(of, AREAS).start
    assert start.min() == 0
    assert ((start <= 30) | ((start >= 100) & (start <= 180))).all()


def test_situations_are_what_they_are_called() -> None:
    of = crowd(
        [(10, 0, 1)] * 6 + [(50, 1, 0)] * 2 + [(90 + k, 0, 1) for k in range(9)]
        + [(130 + k, k % 2, 1 - k % 2) for k in range(18)]
    )  # fmt: skip
    found = Windows.of(of, AREAS)
    chosen = situations(found, AREAS)
    assert {kind: people for kind, (_, people) in chosen.items()} == {
        "large group": 6, "small group": 2, "single walkers": 18, "strong flow": 9,
    }  # fmt: skip
    when = {kind: found.start[k] for kind, (k, _) in chosen.items()}
    for kind, frame in (("large group", 10), ("small group", 50), ("strong flow", 94)):
        assert when[kind] <= frame < when[kind] + found.frames
    starts = sorted(when.values())
    assert (np.diff(starts) >= found.frames).all()


def test_what_never_happens_is_not_shown() -> None:
    """Nobody comes with others, and nobody from a place that is known."""
    lonely = Windows.of(crowd([(10, -1, 1), (60, -1, 1)]), AREAS)
    assert set(situations(lonely, AREAS)) == {"single walkers"}
