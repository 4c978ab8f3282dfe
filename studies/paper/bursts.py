"""How arrivals come together: in time, and in several areas at once."""

from collections.abc import Sequence

import msgspec
import numpy as np
from jaxtyping import Float, Int

from crowdbench.scene import Scene

FRAMES = 10
"""Number of frames in which the paper counts spawns."""
LENGTHS_S = (60.0, 20.0)
"""Lengths of the intervals in which people are counted, seconds; the next one is ten frames."""
LEAST = 30
"""Number of intervals that a variance needs."""


def interval_of(stretches_s: Float[np.ndarray, "B 2"], scene: Scene) -> float:
    """The longest interval that fits at least 30 times into observed time, or ten frames; s."""
    for length_s in LENGTHS_S:
        if sum(_whole(start, stop, length_s) for start, stop in stretches_s) >= LEAST:
            return length_s
    return FRAMES * scene.dt_s


class Bursts(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Statistics of the arrivals of a recording or of one sample."""

    persons: int
    """Number of people who enter."""
    interval_s: float
    """Length of the intervals in which people are counted, seconds."""
    intervals: int
    """Number of whole intervals of observed time."""
    fano: float
    """Variance of the number of people who enter in an interval, divided by its mean; 1 for
    Poisson."""
    correlation: float
    """Mean correlation between areas of the numbers of people who enter in an interval, weighted by
    the standard deviations of both areas; 0 for independent areas."""
    people: list[int]
    """`people[n]`: number of intervals of ten frames in which n people enter."""
    occupied: list[int]
    """`occupied[n]`: number of intervals of ten frames with n frames in which anybody enters."""

    @classmethod
    def of(
        cls,
        time_s: Float[np.ndarray, " n"],
        area: Int[np.ndarray, " n"],
        stretches_s: Float[np.ndarray, "B 2"],
        scene: Scene,
        areas: int,
    ) -> "Bursts":
        """Statistics of the people who enter at `time_s` in `area`, in observed stretches."""
        interval_s = interval_of(stretches_s, scene)
        counts = _counts(time_s, area, stretches_s, interval_s, areas)
        ten = _counts(time_s, area, stretches_s, FRAMES * scene.dt_s, areas).sum(axis=1)
        frame_s = np.unique(np.floor(time_s / scene.dt_s + 1e-6)) * scene.dt_s
        only = np.zeros(len(frame_s), dtype=np.int64)
        occupied = _counts(frame_s, only, stretches_s, FRAMES * scene.dt_s, 1)[:, 0]
        inside = [
            np.count_nonzero((time_s >= start) & (time_s < stop)) for start, stop in stretches_s
        ]
        total = counts.sum(axis=1)
        return cls(
            persons=int(sum(inside)),
            interval_s=interval_s,
            intervals=len(total),
            fano=float(total.var(ddof=1) / total.mean()) if total.any() else 0.0,
            correlation=_correlation(counts),
            people=np.bincount(ten).tolist(),
            occupied=np.bincount(occupied).tolist(),
        )


def share(counts: Sequence[int], chosen: Sequence[int]) -> float:
    """Share of the intervals with one of the chosen numbers."""
    return sum(counts[n] for n in chosen if n < len(counts)) / sum(counts)


def mode(counts: Sequence[int]) -> int:
    """The most frequent number."""
    return int(np.argmax(counts))


def _counts(
    time_s: Float[np.ndarray, " n"],
    area: Int[np.ndarray, " n"],
    stretches_s: Float[np.ndarray, "B 2"],
    length_s: float,
    areas: int,
) -> Int[np.ndarray, "I K"]:
    """Number of entries in each whole interval of each stretch, and each area."""
    found = [np.zeros((0, areas), dtype=np.int64)]
    for start, stop in stretches_s:
        intervals = _whole(start, stop, length_s)
        # Times on the boundary belong to the later interval, whatever their last bit.
        at = np.floor((time_s - start) / length_s + 1e-6).astype(np.int64)
        inside = (at >= 0) & (at < intervals)
        flat = np.bincount(at[inside] * areas + area[inside], minlength=intervals * areas)
        found.append(flat.reshape(intervals, areas))
    return np.concatenate(found)


def _whole(start_s: float, stop_s: float, length_s: float) -> int:
    """Number of whole intervals between two times."""
    return int((stop_s - start_s) / length_s + 1e-6)


def _correlation(counts: Int[np.ndarray, "I K"]) -> float:
    """(Var Σx − Σ Var x) / ((Σσ)² − Σσ²); 0 if fewer than two areas vary."""
    variance = counts.var(axis=0)
    sd = np.sqrt(variance)
    between = sd.sum() ** 2 - variance.sum()
    if between <= 1e-12:
        return 0.0
    return float((counts.sum(axis=1).var() - variance.sum()) / between)
