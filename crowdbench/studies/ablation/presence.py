"""How many people were there: what the study keeps of a recording or a rollout."""

from itertools import pairwise

import msgspec
import numpy as np
from jaxtyping import Int

from crowdbench.metrics.lattice import correlation, lagged_sums, moments

LAG_S = 60.0
"""At which the autocorrelation is looked at."""


class Presence(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The number N(t) of people present, over some stretches of frames."""

    counts: list[int]
    """`counts[n]`: frames with n persons."""
    pairs: list[int]
    """n, Σx, Σx′, Σxx′, Σx², Σx′² of N(t) and N(t + 60 s), both in the same stretch."""

    @classmethod
    def of(cls, stretches: list[Int[np.ndarray, " _"]], dt_s: float) -> "Presence":
        """Of N(t) frame by frame in each stretch, frames of `dt_s` seconds."""
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
        """Correlation of N(t) and N(t + 60 s); None where no stretch is so long."""
        return float(correlation(np.array(self.pairs))) if self.pairs[0] else None

    def distance(self, recorded: "Presence") -> float:
        """Wasserstein-1 of the two distributions of N, divided by the recording's mean N."""
        size = max(len(self.counts), len(recorded.counts))
        mine, theirs = (
            np.pad(np.cumsum(counts) / np.sum(counts), (0, size - len(counts)), constant_values=1.0)
            for counts in (self.counts, recorded.counts)
        )
        return float(np.abs(mine - theirs).sum() / recorded.mean)


def stretches(
    observed: Int[np.ndarray, "I 2"], frames: int, parts: int
) -> list[tuple[int, int, int]]:
    """The observed frames of each of so many equal parts of a recording of `frames` frames.

    Each is the part and, counted from the part's first frame, [start, stop).
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
    """The first frame of each of so many equal parts, and the end of the last."""
    return [-(-frames * part // parts) for part in range(parts + 1)]
