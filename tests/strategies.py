"""Crowds for tests: made by hand (`crowd_of`), drawn by hypothesis (`crowds`), and altered."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from models import arrivals_at

from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS, Trajectories, from_rows
from crowdbench.spawn import Arrivals

METRES = st.floats(-50, 50, width=32)


def crowd_of(
    trips: Sequence[tuple[int, int]],
    *,
    frames: int | None = None,
    observed: Sequence[tuple[int, int]] | None = None,
    dt_s: float = 1.0,
    grid_s: float | None = None,
    person_id: Sequence[int] | None = None,
    xy: np.ndarray | None = None,
    persons: dict[str, Sequence] | None = None,
) -> Trajectories:
    """One person per (first frame, last frame), all at the origin unless `xy` says otherwise.

    `persons` holds columns with one value per life.
    """
    sizes = [last - first + 1 for first, last in trips]
    return from_rows(
        scene="made by hand",
        dt_s=dt_s,
        grid_s=grid_s,
        frames=frames,
        observed=None if observed is None else np.array(observed),
        person_id=np.repeat(np.arange(len(trips)) if person_id is None else person_id, sizes),
        frame=np.concatenate([np.arange(first, last + 1) for first, last in trips]),
        xy=np.zeros((sum(sizes), 2)) if xy is None else np.asarray(xy, dtype=np.float64),
        persons={name: np.repeat(values, sizes) for name, values in (persons or {}).items()},
        where="test",
    )


@st.composite
def intervals(draw: st.DrawFn, frames: int) -> list[tuple[int, int]]:
    """Ascending, disjoint and not empty intervals within `frames` frames."""
    edges = sorted(draw(st.sets(st.integers(0, frames), min_size=2, max_size=6)))
    return list(zip(edges[:-1:2], edges[1::2], strict=True))


@st.composite
def crowds(draw: st.DrawFn, dt_s: float | None = None) -> Trajectories:
    """Any table: persons of any life, in areas or in none, who enter between two frames."""
    frames = draw(st.integers(1, 30))
    frame = st.integers(0, frames - 1)
    life = st.tuples(frame, frame).map(lambda ends: (min(ends), max(ends)))
    trips = draw(st.lists(life, min_size=1, max_size=8))
    number = len(trips)
    ids = draw(st.lists(st.integers(0, 2**40), min_size=number, max_size=number, unique=True))
    dt_s = draw(st.sampled_from([0.4, 1.0, 4 / 9])) if dt_s is None else dt_s
    first = np.array([first for first, _ in trips])
    early = draw(arrays(np.float64, number, elements=st.sampled_from([0.0, 0.25, 0.75])))
    spawn_s = (first - early) * dt_s

    def column(elements: st.SearchStrategy) -> list:
        return draw(st.lists(elements, min_size=number, max_size=number))

    crowd = crowd_of(
        trips,
        frames=frames,
        observed=draw(intervals(frames)),
        dt_s=dt_s,
        grid_s=dt_s * draw(st.sampled_from([0.25, 1.0, 2.0])),
        person_id=ids,
        xy=draw(arrays(np.float32, (sum(b - a + 1 for a, b in trips), 2), elements=METRES)),
        persons={
            "spawn_area": column(st.integers(-1, 4)),
            "goal_area": column(st.integers(-1, 4)),
            "entered": column(st.booleans()),
            "left": column(st.booleans()),
            "requested_s": spawn_s - column(st.sampled_from([0.0, 0.3])),
            "spawn_s": spawn_s,
            "outcome": column(st.integers(0, len(OUTCOMES) - 1)),
        },
    )
    return replace(crowd, provenance=draw(st.dictionaries(st.text(), st.integers() | st.text())))


@st.composite
def arrivals_of_two_areas(draw: st.DrawFn) -> Arrivals:
    """Any arrivals in disjoint stretches of a grid: none, several at once, in either area."""
    stretches = draw(intervals(40))
    points = [tick for start, stop in stretches for tick in range(start, stop)]
    one = st.tuples(st.sampled_from(points), st.integers(0, 1))
    ticks = sorted(draw(st.lists(one, max_size=30)))
    return arrivals_at([t for t, _ in ticks], [k for _, k in ticks], stretches)


def reordered(crowd: Trajectories, order: Sequence[int]) -> Trajectories:
    """The same crowd with its persons in another order."""
    order = np.array(order)
    return replace(
        crowd,
        person_id=crowd.person_id[order],
        first=crowd.first[order],
        offsets=np.concatenate([[0], np.cumsum(np.diff(crowd.offsets)[order])]),
        xy=np.concatenate([crowd.path(int(person)) for person in order]),
        **{name: getattr(crowd, name)[order] for name in PERSON_COLUMNS},
    )


def later(crowd: Trajectories, frames: int) -> Trajectories:
    """The same crowd, `frames` frames later."""
    by_s = frames * crowd.dt_s
    return replace(
        crowd,
        frames=crowd.frames + frames,
        first=crowd.first + frames,
        observed=crowd.observed + frames,
        requested_s=crowd.requested_s + by_s,
        spawn_s=crowd.spawn_s + by_s,
    )


def differences(a: Trajectories, b: Trajectories) -> list[str]:
    """Names of the fields in which two tables differ, in value or in kind."""
    names = ("scene", "dt_s", "grid_s", "frames", "provenance")
    different = [name for name in names if getattr(a, name) != getattr(b, name)]
    for name in ("observed", "person_id", "first", "offsets", "xy", *PERSON_COLUMNS):
        x, y = getattr(a, name), getattr(b, name)
        if x.dtype != y.dtype or not np.array_equal(x, y):
            different.append(name)
    return different
