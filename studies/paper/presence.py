"""The number of people present: the data that the study keeps of a recording or rollout."""

from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Int

from crowdbench.metrics.lattice import correlation, lagged_sums, moments

LAG_S = 60.0
"""Lag of the autocorrelation, seconds."""


class Presence(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """Counts of the number N(t) of people present, over one or more stretches of frames."""

    counts: list[int]
    """`counts[n]`: number of frames with n persons."""
    pairs: list[int]
    """n, Σx, Σx′, Σxx′, Σx², Σx′² over pairs x = N(t), x′ = N(t + 60 s) in the same stretch."""

    @classmethod
    def of(cls, stretches: list[Int[np.ndarray, " _"]], dt_s: float) -> "Presence":
        """Count N(t), which `stretches` contain frame by frame; a frame is `dt_s` seconds."""
        everything = np.concatenate(stretches)
        pairs = np.zeros(6, dtype=np.int64)
        lag = round(LAG_S / dt_s)
        for present in stretches:
            x, y = present[: max(0, len(present) - lag)], present[lag:]
            pairs += lagged_sums(x, y, np.zeros(len(x), dtype=np.int64), 1)[0]
        return cls(counts=np.bincount(everything).tolist(), pairs=pairs.tolist())

    @property
    def mean(self) -> float:
        """Mean of N(t), persons."""
        return float(moments(np.array(self.counts), np.arange(len(self.counts)))[0])

    @property
    def sd(self) -> float:
        """Standard deviation of N(t), persons."""
        variance = moments(np.array(self.counts), np.arange(len(self.counts)))[1]
        return float(np.sqrt(variance))

    @property
    def correlation(self) -> float | None:
        """Correlation of N(t) and N(t + 60 s); None if no stretch is that long."""
        return float(correlation(np.array(self.pairs))) if self.pairs[0] else None

    def distance(self, recorded: "Presence") -> float:
        """Wasserstein-1 distance between both distributions of N, divided by the recorded mean."""
        size = max(len(self.counts), len(recorded.counts))
        mine, theirs = (
            np.pad(np.cumsum(counts) / np.sum(counts), (0, size - len(counts)), constant_values=1.0)
            for counts in (self.counts, recorded.counts)
        )
        return float(np.abs(mine - theirs).sum() / recorded.mean)


def stretches(
    observed: Int[np.ndarray, "I 2"], frames: int, parts: int
) -> list[tuple[int, int, int]]:
    """Observed stretches of each of `parts` equal parts of a recording of `frames` frames.

    Each is (part, start, stop), with frames [start, stop) counted from the first frame of the part.
    """
    edges = parts_at(frames, parts)
    found: list[tuple[int, int, int]] = []
    for part, (first, end) in enumerate(pairwise(edges)):
        for start, stop in observed.tolist():
            a, b = max(start, first), min(stop, end)
            if a < b:
                found.append((part, a - first, b - first))
    return found


def parts_at(frames: int, parts: int) -> list[int]:
    """The first frame of each of `parts` equal parts, and the end of the last part."""
    return [-(-frames * part // parts) for part in range(parts + 1)]
