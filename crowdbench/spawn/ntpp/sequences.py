"""Cuts recordings into the sequences of groups that `ntpp-gmm` is trained and validated on."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Int

from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.ntpp.model import NEVER_FORGETS


@dataclass(frozen=True)
class Sequence:
    """The groups of one area in one window."""

    gap: Int[np.ndarray, " n"]
    """Grid steps since the previous group, or since the point before the window."""
    size: Int[np.ndarray, " n"]
    """Number of persons in each group."""
    rest: int
    """Grid points of the window after the last group."""


def pieces_of(stretches: Int[np.ndarray, "B 2"], length: int) -> Int[np.ndarray, "P 2"]:
    """Cut stretches into pieces of about `length` grid points."""
    pieces: list[tuple[int, int]] = []
    for start, stop in stretches.tolist():
        count = max(1, round((stop - start) / length))
        edges = np.linspace(start, stop, count + 1).round().astype(np.int64).tolist()
        pieces += pairwise(edges)
    return np.array(pieces)


def joined(pieces: Int[np.ndarray, "P 2"]) -> Int[np.ndarray, "B 2"]:
    """Join adjacent pieces; `pieces` must be ascending."""
    begins = np.r_[True, pieces[1:, 0] != pieces[:-1, 1]]
    return np.stack([pieces[begins, 0], pieces[np.r_[begins[1:], True], 1]], axis=1)


def within(arrivals: Arrivals, stretches: Int[np.ndarray, "B 2"]) -> Arrivals:
    """The arrivals within the given stretches."""
    at = np.searchsorted(stretches[:, 0], arrivals.tick, side="right") - 1
    inside = (at >= 0) & (arrivals.tick < stretches[np.maximum(at, 0), 1])
    tick, area = arrivals.tick[inside], arrivals.area[inside]
    return replace(arrivals, tick=tick, area=area, windows=stretches)


def windows(stretches: Int[np.ndarray, "B 2"], width: int, stride: int) -> Int[np.ndarray, "V 2"]:
    """Training windows of `width` grid points, `stride` apart, plus one at the end of each stretch.

    Windows lie within their stretch; a stretch that is shorter than `width` is one window.
    """
    found: list[tuple[int, int]] = []
    for start, stop in stretches.tolist():
        last = max(start, stop - width)
        found += [(a, min(a + width, stop)) for a in [*range(start, last, stride), last]]
    return np.array(found)


def sequences(
    arrivals: Arrivals,
    chosen: Int[np.ndarray, "V 2"],
    areas: Int[np.ndarray, " k"] | None = None,
    memory: int = NEVER_FORGETS,
) -> list[list[Sequence]]:
    """The sequences of each area (by default all areas) in the windows, which may overlap.

    A new sequence begins after a silence of `memory` grid steps.
    """
    result = []
    for k in range(arrivals.areas) if areas is None else areas.tolist():
        tick, size = np.unique(arrivals.tick[arrivals.area == k], return_counts=True)
        mine = []
        for start, stop in chosen.tolist():
            a, b = np.searchsorted(tick, (start, stop)).tolist()
            last = int(tick[b - 1]) if b > a else start - 1
            gap = np.diff(tick[a:b], prepend=start - 1)
            mine += _remembered(Sequence(gap, size[a:b], stop - 1 - last), memory)
        result.append(mine)
    return result


def _remembered(whole: Sequence, memory: int) -> list[Sequence]:
    """The sequence, cut where no group enters for longer than `memory`."""
    found, begin, gap = [], 0, whole.gap.copy()
    for i in np.flatnonzero(gap > memory).tolist():
        forgotten = (gap[i] - 1) // memory
        found.append(Sequence(gap[begin:i], whole.size[begin:i], memory))
        found += [silence(memory)] * (forgotten - 1)
        gap[i] -= forgotten * memory
        begin = i
    forgotten = max(0, whole.rest - 1) // memory
    rest = whole.rest - forgotten * memory
    if forgotten == 0:
        return [*found, Sequence(gap[begin:], whole.size[begin:], rest)]
    found.append(Sequence(gap[begin:], whole.size[begin:], memory))
    return [*found, *[silence(memory)] * (forgotten - 1), silence(rest)]


def silence(steps: int) -> Sequence:
    """The sequence of a window without groups."""
    return Sequence(np.empty(0, dtype=np.int64), np.empty(0, dtype=np.int64), steps)
