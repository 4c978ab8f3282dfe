"""Family presence: how many people are there at once."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.blocks import TimeBlocks
from crowdbench.metrics.forms import LogRatio, RelativeWasserstein
from crowdbench.metrics.lattice import Numbers, correlation, histograms, lagged_sums, moments
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support
from crowdbench.trajectories import Trajectories

LAGS_S = (10.0, 30.0, 60.0)
ENOUGH = 0.1
"""Share of the frames that must have a partner at a lag."""


def present_in(
    crowd: Trajectories, blocks: TimeBlocks
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """N(t) in each frame of the blocks, and the frame's block; beyond its end a crowd is empty."""
    last = int(blocks.frames.max())
    present = np.pad(crowd.present(), (0, max(0, last - crowd.frames)))
    frame = np.concatenate([np.arange(start, stop) for start, stop in blocks.frames])
    return present[frame], np.repeat(np.arange(len(blocks)), np.diff(blocks.frames)[:, 0])


class AgentsOverTime(RelativeWasserstein):
    """N(t), the persons present, on the scene's frames in the blocks, empty frames included.

    N(t) is the number of people whose first frame is ≤ t minus those whose last frame is < t.
    Distance: Wasserstein-1 of the two distributions of N, divided by the recording's mean N.
    """

    name = "agents_over_time"
    family = "presence"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: frames of block b with n persons."""
        present, block = present_in(crowd, blocks)
        return {"counts": histograms(present, block, len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """One person."""
        return 1.0


class AgentsSpread(LogRatio):
    """Standard deviation of N(t) over the frames in the blocks.

    Distance: |log((a + .05)/(b + .05))|.
    """

    name = "agents_sd"
    family = "presence"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: frames of block b with n persons."""
        present, block = present_in(crowd, blocks)
        return {"counts": histograms(present, block, len(blocks))}

    def value(self, sums: Sums, support: Support) -> Numbers:
        """The standard deviation."""
        return np.sqrt(moments(sums["counts"], support)[1])


class Autocorrelation(Metric):
    """Autocorrelation of N(t) at lags of 10, 30 and 60 s, those that are shorter than the blocks.

    Pearson's correlation of N(t) and N(t + lag), both in the same block, over all blocks together;
    0 where N does not vary. A lag counts where at least a tenth of the frames have a partner, so
    that no correlation stands on one long block among short ones. Distance: |difference|,
    averaged over the lags.
    """

    name = "autocorrelation"
    family = "presence"
    unit = ""

    def applies(self, blocks: TimeBlocks) -> bool:
        """Where the blocks are longer than the shortest lag."""
        return bool(_lags(blocks))

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`lag n s[b]`: n, Σx, Σx′, Σxx′, Σx², Σx′² in block b, at each lag, counted or not."""
        present, block = present_in(crowd, blocks)
        statistics = {}
        for lag_s in LAGS_S:
            lag = min(_in_frames(lag_s, blocks), len(block))
            same = block[lag:] == block[: len(block) - lag]
            x, y = present[: len(block) - lag][same], present[lag:][same]
            statistics[_key(lag_s)] = lagged_sums(x, y, block[lag:][same], len(blocks))
        return statistics

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The correlation at each lag."""
        return np.stack([correlation(sums[_key(lag)]) for lag in _lags(blocks)], axis=-1)

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """One over the number of lags."""
        return np.full(1, 1 / len(_lags(blocks)))

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The mean over the lags."""
        return float(self.embed(sums, support, blocks).mean())

    def size(self, sums: Sums) -> int:
        """Pairs of frames at the shortest lag."""
        return int(sums[_key(LAGS_S[0])][0])


def _lags(blocks: TimeBlocks) -> list[float]:
    """The lags that count."""
    length = np.diff(blocks.frames)
    return [
        lag
        for lag in LAGS_S
        if np.maximum(length - _in_frames(lag, blocks), 0).sum() >= ENOUGH * length.sum()
    ]


def _in_frames(lag_s: float, blocks: TimeBlocks) -> int:
    return round(lag_s / blocks.dt_s)


def _key(lag_s: float) -> str:
    return f"lag {lag_s:g} s"
