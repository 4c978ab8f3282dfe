"""Family presence: how many people are present at the same time."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np
from jaxtyping import Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.stops import standing
from crowdbench.data.table import Indices, Trajectories
from crowdbench.metrics import lattice
from crowdbench.metrics.forms import LogRatio, RelativeWasserstein, ShareDifference
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support, Vectors, Weights
from crowdbench.metrics.rows import block_of_frames, rows_in

LAGS_S = (10.0, 30.0, 60.0)
SLOW_LAGS_S = (120.0, 300.0)
ENOUGH = 0.1
"""Minimum share of frames that must have a frame one lag later in the same block."""


def present_in(crowd: Trajectories, blocks: TimeBlocks) -> tuple[Indices, Indices]:
    """N(t) in each frame of the blocks, and the frame's block.

    N(t) is 0 after the end of the crowd.
    """
    block = block_of_frames(blocks, crowd.frames)
    present = np.pad(crowd.present(), (0, len(block) - crowd.frames))
    return present[block >= 0], block[block >= 0]


class _Present(Metric):
    family = "presence"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of frames of block b with n persons."""
        present, block = present_in(crowd, blocks)
        return {"counts": lattice.histograms(present, block, len(blocks))}


class AgentsOverTime(_Present, RelativeWasserstein):
    """N(t), the number of persons present, in all frames of the blocks, including empty frames.

    N(t) is the number of people whose first frame is ≤ t minus those whose last frame is < t.
    Distance: Wasserstein-1 of the two distributions of N, divided by the recording's mean N.
    """

    name = "agents_over_time"


class AgentsSpread(_Present, LogRatio):
    """Standard deviation of N(t) over the frames in the blocks.

    Distance: |log((a + .05)/(b + .05))|.
    """

    name = "agents_sd"

    def value(self, sums: Sums, support: Support) -> lattice.Numbers:
        """Standard deviation of N(t)."""
        return np.sqrt(lattice.moments(sums["counts"], support)[1])


class _Correlations(Metric):
    """Pearson's correlation of N(t) and N(t + lag) at several lags."""

    family = "presence"
    lags_s: ClassVar[tuple[float, ...]]
    across: ClassVar[bool] = False
    """Whether N(t) may be in an earlier block than N(t + lag)."""

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether at least one lag is used."""
        return bool(self._used(blocks))

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`lag n s[b]`: sums of pairs with t + lag in block b (see `lagged`), used or not."""
        sums = lagged(crowd, blocks, self.lags_s, across=self.across)
        return {lag_key(lag_s): of_lag for lag_s, of_lag in zip(self.lags_s, sums, strict=True)}

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The correlation at each lag that is used."""
        return np.stack(
            [lattice.correlation(sums[lag_key(lag)]) for lag in self._used(blocks)], axis=-1
        )

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """1 / number of lags: the distance is a mean over the lags."""
        return np.full(1, 1 / len(self._used(blocks)))

    def size(self, sums: Sums) -> int:
        """Number of pairs of frames at the shortest lag."""
        return int(sums[lag_key(self.lags_s[0])][0])

    def _used(self, blocks: TimeBlocks) -> list[float]:
        return usable_lags(self.lags_s, blocks, across=self.across)


class Autocorrelation(_Correlations):
    """Autocorrelation of N(t) at lags of 10, 30 and 60 s.

    Pearson's correlation of N(t) and N(t + lag), both in the same block, over all blocks together;
    0 if N does not vary. A lag is used if at least a tenth of the frames have a frame one lag later
    in the same block, so that no correlation rests on one long block among short ones. Distance:
    |difference|, averaged over the lags.
    """

    name = "autocorrelation"
    lags_s = LAGS_S


class SlowAutocorrelation(_Correlations):
    """Autocorrelation of N(t) at lags of 120 and 300 s.

    As `Autocorrelation`, but N(t + lag) may be in a later block than N(t), if observation did not
    stop in between; the pair counts for the later block. Shown, never scored: recordings are short
    compared with these lags. A lag is used if at least a tenth of the frames come that long after
    observation began.
    """

    name = "slow_autocorrelation"
    scored = False
    lags_s = SLOW_LAGS_S
    across = True


class StandingShare(ShareDifference):
    """Share of the time that people spend standing.

    Somebody stands if it moves by less than 0.3 m/s over 1.6 s, see
    `crowdbench.data.stops`. Distance: |difference|.
    """

    name = "standing_share"
    family = "presence"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: number of positions in block b of people who stand, and of all."""
        rows, block = rows_in(crowd, blocks)
        return {"share": lattice.counted(standing(crowd)[rows], block, len(blocks))}


def lagged(
    crowd: Trajectories, blocks: TimeBlocks, lags_s: Sequence[float], *, across: bool = False
) -> Int[np.ndarray, "L B 6"]:
    """n, Σx, Σx′, Σxx′, Σx², Σx′² of x = N(t) and x′ = N(t + lag), for each lag and block.

    A pair counts for the block of t + lag, if t is in it too or, with `across`, if observation did
    not stop in between.
    """
    since = blocks.since if across else blocks.frames[:, 0]
    block = block_of_frames(blocks, crowd.frames)
    last = len(block)
    present = np.pad(crowd.present(), (0, last - crowd.frames))
    begin = np.where(block >= 0, since[block], last)
    found = np.zeros((len(lags_s), len(blocks), 6), dtype=np.int64)
    for k, lag_s in enumerate(lags_s):
        lag = min(_in_frames(lag_s, blocks), last)
        counts = np.arange(last - lag) >= begin[lag:]
        x, y = present[: last - lag][counts], present[lag:][counts]
        found[k] = lattice.lagged_sums(x, y, block[lag:][counts], len(blocks))
    return found


def usable_lags(
    lags_s: Sequence[float], blocks: TimeBlocks, *, across: bool = False
) -> list[float]:
    """The lags for which enough frames have an earlier one that counts, see `lagged`."""
    start, stop = blocks.frames.T
    since = blocks.since if across else start
    found = []
    for lag_s in lags_s:
        late = np.maximum(stop - np.maximum(start, since + _in_frames(lag_s, blocks)), 0)
        if late.sum() >= ENOUGH * (stop - start).sum():
            found.append(lag_s)
    return found


def lag_key(lag_s: float) -> str:
    """Name of the statistic for a lag."""
    return f"lag {lag_s:g} s"


def _in_frames(lag_s: float, blocks: TimeBlocks) -> int:
    return round(lag_s / blocks.dt_s)
