"""Family presence: how many people are present at the same time."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.stops import standing
from crowdbench.data.table import Trajectories
from crowdbench.metrics.forms import LogRatio, RelativeWasserstein, ShareDifference
from crowdbench.metrics.lattice import (
    Numbers,
    correlation,
    counted,
    histograms,
    lagged_sums,
    moments,
)
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support
from crowdbench.metrics.rows import rows_in

LAGS_S = (10.0, 30.0, 60.0)
SLOW_LAGS_S = (120.0, 300.0)
ENOUGH = 0.1
"""Minimum share of frames that must have a frame one lag later in the same block."""


def present_in(
    crowd: Trajectories, blocks: TimeBlocks
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """N(t) in each frame of the blocks, and the frame's block.

    N(t) is 0 after the end of the crowd.
    """
    last = int(blocks.frames.max())
    present = np.pad(crowd.present(), (0, max(0, last - crowd.frames)))
    frame = np.concatenate([np.arange(start, stop) for start, stop in blocks.frames])
    return present[frame], np.repeat(np.arange(len(blocks)), np.diff(blocks.frames)[:, 0])


class AgentsOverTime(RelativeWasserstein):
    """N(t), the number of persons present, in all frames of the blocks, including empty frames.

    N(t) is the number of people whose first frame is ≤ t minus those whose last frame is < t.
    Distance: Wasserstein-1 of the two distributions of N, divided by the recording's mean N.
    """

    name = "agents_over_time"
    family = "presence"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of frames of block b with n persons."""
        present, block = present_in(crowd, blocks)
        return {"counts": histograms(present, block, len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """Lattice step: 1 person."""
        return 1.0


class AgentsSpread(LogRatio):
    """Standard deviation of N(t) over the frames in the blocks.

    Distance: |log((a + .05)/(b + .05))|.
    """

    name = "agents_sd"
    family = "presence"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of frames of block b with n persons."""
        present, block = present_in(crowd, blocks)
        return {"counts": histograms(present, block, len(blocks))}

    def value(self, sums: Sums, support: Support) -> Numbers:
        """Standard deviation of N(t)."""
        return np.sqrt(moments(sums["counts"], support)[1])


class Autocorrelation(Metric):
    """Autocorrelation of N(t) at lags of 10, 30 and 60 s.

    Pearson's correlation of N(t) and N(t + lag), both in the same block, over all blocks together;
    0 if N does not vary. A lag is used if at least a tenth of the frames have a frame one lag later
    in the same block, so that no correlation rests on one long block among short ones. Distance:
    |difference|, averaged over the lags.
    """

    name = "autocorrelation"
    family = "presence"
    unit = ""

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether the blocks are long enough for at least one lag."""
        return bool(usable_lags(LAGS_S, blocks))

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`lag n s[b]`: n, Σx, Σx′, Σxx′, Σx², Σx′² in block b, for every lag, used or not."""
        sums = lagged(crowd, blocks, LAGS_S)
        return {lag_key(lag_s): of_lag for lag_s, of_lag in zip(LAGS_S, sums, strict=True)}

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The correlation at each lag that is used."""
        by_lag = [correlation(sums[lag_key(lag_s)]) for lag_s in usable_lags(LAGS_S, blocks)]
        return np.stack(by_lag, axis=-1)

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """1 / number of lags: the distance is a mean over the lags."""
        return np.full(1, 1 / len(usable_lags(LAGS_S, blocks)))

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """Mean correlation over the lags."""
        return float(self.embed(sums, support, blocks).mean())

    def size(self, sums: Sums) -> int:
        """Number of pairs of frames at the shortest lag."""
        return int(sums[lag_key(LAGS_S[0])][0])


class SlowAutocorrelation(Metric):
    """Autocorrelation of N(t) at lags of 120 and 300 s.

    As `Autocorrelation`, but N(t + lag) may be in a later block than N(t), if observation did not
    stop in between; the pair counts for the later block. Shown, never scored: recordings are short
    compared with these lags. A lag is used if at least a tenth of the frames come that long after
    observation began.
    """

    name = "slow_autocorrelation"
    family = "presence"
    unit = ""
    scored = False

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether at least one lag is used."""
        return bool(_late_enough(blocks))

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`lag n s[b]`: as in `Autocorrelation`, with N(t + lag) in block b."""
        last = max(int(blocks.frames.max()), crowd.frames)
        present = np.pad(crowd.present(), (0, last - crowd.frames))
        block, since = np.full(last, -1), np.full(last, last)
        for b, (start, stop) in enumerate(blocks.frames):
            block[start:stop], since[start:stop] = b, blocks.since[b]
        sums = {}
        for lag_s in SLOW_LAGS_S:
            lag = min(_in_frames(lag_s, blocks), last)
            counts = np.arange(last - lag) >= since[lag:]
            x, y = present[: last - lag][counts], present[lag:][counts]
            sums[lag_key(lag_s)] = lagged_sums(x, y, block[lag:][counts], len(blocks))
        return sums

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The correlation at each lag that is used."""
        by_lag = [correlation(sums[lag_key(lag_s)]) for lag_s in _late_enough(blocks)]
        return np.stack(by_lag, axis=-1)

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """1 / number of lags: the distance is a mean over the lags."""
        return np.full(1, 1 / len(_late_enough(blocks)))

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """Mean correlation over the lags."""
        return float(self.embed(sums, support, blocks).mean())

    def size(self, sums: Sums) -> int:
        """Number of pairs of frames at the shortest lag."""
        return int(sums[lag_key(SLOW_LAGS_S[0])][0])


class StandingShare(ShareDifference):
    """Share of the time that people spend standing.

    Somebody stands if it moves by less than 0.3 m/s over 1.6 s, see
    `crowdbench.data.stops`. Distance: |difference|.
    """

    name = "standing_share"
    family = "presence"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`share[b]`: number of positions in block b of people who stand, and of all."""
        rows, block = rows_in(crowd, blocks)
        return {"share": counted(standing(crowd)[rows], block, len(blocks))}


def lagged(
    crowd: Trajectories, blocks: TimeBlocks, lags_s: Sequence[float]
) -> Int[np.ndarray, "L B 6"]:
    """n, Σx, Σx′, Σxx′, Σx², Σx′² of x = N(t) and x′ = N(t + lag) in each block, for each lag."""
    present, block = present_in(crowd, blocks)
    found = np.zeros((len(lags_s), len(blocks), 6), dtype=np.int64)
    for k, lag_s in enumerate(lags_s):
        lag = min(_in_frames(lag_s, blocks), len(block))
        same = block[lag:] == block[: len(block) - lag]
        x, y = present[: len(block) - lag][same], present[lag:][same]
        found[k] = lagged_sums(x, y, block[lag:][same], len(blocks))
    return found


def usable_lags(lags_s: Sequence[float], blocks: TimeBlocks) -> list[float]:
    """The lags for which enough frames have a frame one lag later in the same block."""
    length = np.diff(blocks.frames)
    return [
        lag_s
        for lag_s in lags_s
        if np.maximum(length - _in_frames(lag_s, blocks), 0).sum() >= ENOUGH * length.sum()
    ]


def _late_enough(blocks: TimeBlocks) -> list[float]:
    """The slow lags at which enough frames of the blocks have an earlier one."""
    start, stop = blocks.frames.T
    found = []
    for lag_s in SLOW_LAGS_S:
        late = np.maximum(stop - np.maximum(start, blocks.since + _in_frames(lag_s, blocks)), 0)
        if late.sum() >= ENOUGH * (stop - start).sum():
            found.append(lag_s)
    return found


def lag_key(lag_s: float) -> str:
    """Name of the statistic for a lag."""
    return f"lag {lag_s:g} s"


def _in_frames(lag_s: float, blocks: TimeBlocks) -> int:
    return round(lag_s / blocks.dt_s)
