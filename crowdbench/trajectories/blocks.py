"""Time blocks: the mask through which both sides of a comparison are looked at.

Observed intervals are cut into blocks of about the same length. Statistics are kept per block,
so that blocks can be folded (fit on some, score others) and resampled.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.trajectories.table import Trajectories

FOLDS = 3
PARTS = ("full", *(f"fold{k}" for k in range(FOLDS)))
"""What models are fitted for: the whole recording (protocol `full`), and each fold of `heldout`,
for which a model is fitted on the blocks outside the fold and scored on those in it."""

_TOLERANCE = 1e-6  # of a grid step: times are sums of floats


@dataclass(frozen=True, eq=False)
class TimeBlocks:
    """`B` disjoint blocks of frames, ascending."""

    frames: Int[np.ndarray, "B 2"]
    """[start, stop) of each block."""
    opens: Bool[np.ndarray, " B"]
    """True where observation begins with the block: who stands in its first frame was there
    before, so that arrivals count from the second frame on."""
    dt_s: float
    grid_s: float

    def __len__(self) -> int:
        return len(self.frames)

    def in_part(self, part: str) -> Bool[np.ndarray, " B"]:
        """Which blocks models fitted for `part` (one of `PARTS`) are scored on.

        Folds are interleaved.
        """
        if part == "full":
            return np.ones(len(self), dtype=bool)
        return np.arange(len(self)) % FOLDS == PARTS.index(part) - 1

    def scored(self, part: str) -> "TimeBlocks":
        """The blocks that models fitted for `part` are scored on."""
        return self.take(self.in_part(part))

    def training(self, part: str) -> "TimeBlocks":
        """The blocks that models for `part` are fitted on."""
        return self if part == "full" else self.take(~self.in_part(part))

    def take(self, chosen: Bool[np.ndarray, " B"] | Int[np.ndarray, " b"]) -> "TimeBlocks":
        """Some of the blocks, by mask or by ascending index."""
        return TimeBlocks(self.frames[chosen], self.opens[chosen], self.dt_s, self.grid_s)

    @property
    def arrival_s(self) -> Float[np.ndarray, "B 2"]:
        """Interval [from, to) of each block in which arrivals count, seconds."""
        start = self.frames[:, 0] + self.opens
        return np.stack([start, self.frames[:, 1]], axis=1) * self.dt_s

    def exposure_s(self) -> float:
        """Seconds in which arrivals were observed."""
        return float(np.diff(self.arrival_s, axis=1).sum())

    def of_arrivals(
        self, trajectories: Trajectories
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        """Those who enter in a block: person index, block, and arrival on the annotation grid.

        The arrival is the grid point at or after `spawn_s`, in grid steps: an annotator sees a
        person at the first grid point after the entry, and a simulated one enters likewise.
        """
        persons = np.flatnonzero(trajectories.entered)
        tick = np.ceil(trajectories.spawn_s[persons] / self.grid_s - _TOLERANCE).astype(np.int64)
        at = tick * self.grid_s + _TOLERANCE * self.grid_s
        block = np.searchsorted(self.arrival_s[:, 0], at, side="right") - 1
        inside = (block >= 0) & (at < self.arrival_s[np.maximum(block, 0), 1])
        order = np.lexsort((persons[inside], tick[inside]))
        return persons[inside][order], block[inside][order], tick[inside][order]


def cut(
    observed: Int[np.ndarray, "I 2"], *, block_s: float, dt_s: float, grid_s: float
) -> TimeBlocks:
    """Cut each observed interval into equal blocks whose length is as near `block_s` as can be.

    No observed frame is lost: an interval shorter than `block_s` is one block.
    """
    frames: list[tuple[int, int]] = []
    opens: list[bool] = []
    for start, stop in observed:
        count = max(1, round((stop - start) * dt_s / block_s))
        edges = np.linspace(start, stop, count + 1).round().astype(np.int64)
        frames += pairwise(edges)
        opens += [True] + [False] * (count - 1)
    return TimeBlocks(np.array(frames), np.array(opens), dt_s, grid_s)
