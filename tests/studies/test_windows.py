"""Windows of a crowd: what is counted in them, what shows something, and what is most alike."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from models import AREAS
from strategies import crowd_of

from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError
from crowdbench.scene import load_scene
from studies.figures.situations import draw_situations, search
from studies.figures.windows import GROUP_S, Windows, situations

FRAMES = 500
WINDOW = 50


def crowd(arrivals: list[tuple[int, int, int]]) -> Trajectories:
    """People by frame of entry, spawn area and goal area, in frames of 0.4 s, who stay for five."""
    first, spawn, goal = (list(column) for column in zip(*arrivals, strict=True))
    persons = {"entered": [True] * len(first), "spawn_area": spawn, "goal_area": goal}
    return crowd_of([(f, f + 4) for f in first], frames=FRAMES, dt_s=0.4, persons=persons)


def people() -> st.SearchStrategy[Trajectories]:
    one = st.tuples(st.integers(1, FRAMES - 5), st.integers(-1, 1), st.integers(-1, 1))
    return st.lists(one, min_size=1, max_size=40).map(sorted).map(crowd)


def window_at(windows: Windows, frame: int) -> int:
    return int(np.flatnonzero(windows.start == frame)[0])


def test_what_happens_is_counted_in_people() -> None:
    found = Windows.of(crowd([(3, 0, 1), (4, 0, 1), (4, 0, 1), (4, 1, 0), (60, 0, 1)]), AREAS)
    k = window_at(found, 0)
    assert found.entered[k] == 4
    assert found.largest[k] == 2
    assert found.alone[k] == 2
    assert found.members[k, :3].tolist() == [3, 1, 0]
    ways = found.ways[k].reshape(3, 3)
    assert ways[0, 1] == 3
    assert ways[1, 0] == 1
    assert found.present[k, :8].tolist() == [0, 0, 0, 1, 4, 4, 4, 4]


@given(people())
def test_each_arrival_is_counted_where_it_happens(of: Trajectories) -> None:
    found = Windows.of(of, AREAS)
    assert found.frames == WINDOW
    for k, start in enumerate(found.start.tolist()):
        inside = (of.first >= start) & (of.first < start + found.frames)
        assert found.entered[k] == inside.sum() == found.ways[k].sum()
        groups = np.stack([of.spawn_area, of.first // 2], axis=1)[inside]
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
        spawn_s=np.array([3.2, 3.2 + 1 / 9, 3.2 + GROUP_S]),
    )
    assert Windows.of(of, AREAS).members[:, :3].max(axis=0).tolist() == [2, 1, 0]


def test_windows_lie_in_what_was_observed() -> None:
    of = replace(
        crowd([(3, 0, 1), (300, 0, 1)]), observed=np.array([[0, 120], [125, 160], [250, 500]])
    )
    start = Windows.of(of, AREAS).start
    assert start.min() == 0
    assert ((start <= 70) | ((start >= 250) & (start <= 450))).all()


def test_situations_are_what_they_are_called() -> None:
    of = crowd(
        [(20, 0, 1)] * 6 + [(110, 1, 0)] * 2 + [(200 + 2 * k, 0, 1) for k in range(9)]
        + [(300 + 2 * k, k % 2, 1 - k % 2) for k in range(18)]
    )  # fmt: skip
    found = Windows.of(of, AREAS)
    chosen = situations(found, AREAS)
    assert {kind: people for kind, (_, people) in chosen.items()} == {
        "large group": 6, "small group": 2, "single walkers": 18, "strong flow": 9,
    }  # fmt: skip
    when = {kind: found.start[k] for kind, (k, _) in chosen.items()}
    for kind, frame in (("large group", 20), ("small group", 110), ("strong flow", 208)):
        assert when[kind] <= frame < when[kind] + found.frames
    starts = sorted(when.values())
    assert (np.diff(starts) >= found.frames).all()


def test_little_that_was_observed_has_no_situations() -> None:
    for observed in ([[0, 149]], [[0, 40], [60, 100]]):
        short = replace(crowd([(3, 0, 1)]), observed=np.array(observed))
        with pytest.raises(RecordingError, match="windows from 60 s or more"):
            draw_situations(load_scene("eth-v0"), AREAS, short, {"any": [short]}, "anyone")


def test_what_never_happens_is_not_shown() -> None:
    """Nobody comes with others, and nobody from a place that is known."""
    lonely = Windows.of(crowd([(10, -1, 1), (60, -1, 1)]), AREAS)
    assert set(situations(lonely, AREAS)) == {"single walkers"}
