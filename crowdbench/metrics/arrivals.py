"""Family arrivals: when people enter. All on the annotation grid, each person an arrival."""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.metrics.forms import LogRatio, RelativeWasserstein
from crowdbench.metrics.lattice import (
    Numbers,
    cdf,
    correlation,
    histograms,
    lagged_sums,
    moments,
    widths,
)
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

ENOUGH_GAPS = 10
"""Recorded gaps from which on an area tells a distribution."""
LONG_BLOCK_S = 120.0
"""Blocks from which on counts in 60 s can be told apart."""


class InterSpawn(RelativeWasserstein):
    """Gaps between consecutive arrivals of the whole scene.

    People who enter together make gaps of zero. A gap lies within one block. Distance:
    Wasserstein-1 of the gaps divided by the recording's mean gap; a crowd without a gap counts as
    one whose gaps are a block long.
    """

    name = "inter_spawn"
    family = "arrivals"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, g]`: gaps of g grid steps in block b; `pairs`: of consecutive gaps."""
        _, block, tick = blocks.of_arrivals(crowd)
        within = np.diff(block) == 0
        gap, block = np.diff(tick)[within], block[1:][within]
        both = np.diff(block) == 0
        return {
            "counts": histograms(gap, block, len(blocks)),
            "pairs": lagged_sums(gap[:-1][both], gap[1:][both], block[1:][both], len(blocks)),
        }

    def step(self, blocks: TimeBlocks) -> float:
        """The annotation grid."""
        return blocks.grid_s

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The mean length of the blocks."""
        return _block_in_grid_steps(blocks)


def burstiness(sums: Sums, support: Support) -> float:
    """B = (σ − μ)/(σ + μ) of the gaps, by `InterSpawn`'s sums (Goh & Barabási 2008, eq. 1).

    −1 is a clock, 0 Poisson, 1 the extreme of bursts. Shown, not scored.
    """
    mean, variance = moments(sums["counts"], support)
    sigma = np.sqrt(variance)
    return float((sigma - mean) / (sigma + mean)) if sigma + mean > 0 else 0.0


def memory(sums: Sums) -> float:
    """M: correlation of consecutive gaps (Goh & Barabási 2008, eq. 2). Shown, not scored."""
    return float(correlation(sums["pairs"]))


class InterSpawnPerArea(Metric):
    """Gaps between consecutive arrivals at the same spawn area.

    Distance: Wasserstein-1 of each area, averaged with the areas' shares of the recorded gaps as
    weights, divided by the recorded mean gap within areas (an area's own mean can be 0). Where some
    areas have ten recorded gaps or more, others do not count: a handful tells no distribution. An
    area without a gap counts as one whose gaps are a block long. Persons of unknown area do not
    count.
    """

    name = "inter_spawn_per_area"
    family = "arrivals"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`area k[b, g]`: gaps of g grid steps at area k in block b."""
        persons, block, tick = blocks.of_arrivals(crowd)
        area = crowd.spawn_area[persons]
        statistics = {}
        for k in range(place.spawn_areas):
            b, t = block[area == k], tick[area == k]
            within = np.diff(b) == 0
            statistics[f"area {k}"] = histograms(np.diff(t)[within], b[1:][within], len(blocks))
        return statistics

    def on_lattice(self, name: str) -> bool:
        """All of them."""
        return True

    def if_empty(self, blocks: TimeBlocks) -> int:
        """The mean length of the blocks."""
        return _block_in_grid_steps(blocks)

    def embed(
        self, sums: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, "*batch F"]:
        """The areas' distribution functions, one after the other."""
        block = self.if_empty(blocks)
        return np.concatenate([cdf(c, support, if_empty=block) for c in sums.values()], axis=-1)

    def weights(
        self, recorded: Sums, support: Support, blocks: TimeBlocks
    ) -> Float[np.ndarray, " #F"]:
        """Of each area its share of the gaps (equal ones of none), over the mean gap of all."""
        enough = [c.sum() >= ENOUGH_GAPS for c in recorded.values()]
        counts = {
            name: c if good or not any(enough) else np.zeros_like(c)
            for (name, c), good in zip(recorded.items(), enough, strict=True)
        }
        mean = self._mean(counts, support, blocks)
        if mean == 0:
            return np.full(1, np.inf)
        gaps = np.array([c.sum() for c in counts.values()])
        shares = gaps / gaps.sum() if gaps.any() else np.full(len(gaps), 1 / len(gaps))
        return np.concatenate([widths(support) * (share / mean) for share in shares])

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """The mean gap over all areas."""
        return self._mean(sums, support, blocks) * blocks.grid_s

    def _mean(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        gaps = self.size(sums)
        if gaps == 0:
            return float(self.if_empty(blocks))
        return sum(int(c @ support) for c in sums.values()) / gaps

    def size(self, sums: Sums) -> int:
        """Gaps."""
        return sum(int(c.sum()) for c in sums.values())


class SpawnCounts(RelativeWasserstein):
    """Persons who enter in ten frames.

    Bins begin with the block, one that would straddle its end is left out. Distance:
    Wasserstein-1 divided by the recording's mean; a crowd without a bin has none enter.
    """

    name = "spawns_per_10_frames"
    family = "arrivals"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: bins of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 10 * blocks.dt_s)}

    def step(self, blocks: TimeBlocks) -> float:
        """One person."""
        return 1.0


class FanoFactor10(LogRatio):
    """Fano factor: variance over mean of the persons who enter in ten frames; Poisson has 1.

    Distance: |log((a + .05)/(b + .05))|. Where nobody enters the factor is 0.
    Source: Fano (1947), Phys. Rev. 72, 26.
    """

    name = "fano_10_frames"
    family = "arrivals"
    unit = ""

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: bins of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 10 * blocks.dt_s)}

    def value(self, sums: Sums, support: Support) -> Numbers:
        """Variance over mean."""
        mean, variance = moments(sums["counts"], support)
        return np.divide(variance, mean, out=np.zeros_like(variance), where=mean > 0)


class FanoFactor60s(FanoFactor10):
    """The Fano factor of the persons who enter in 60 s; for blocks of 120 s and more."""

    name = "fano_60_s"

    def applies(self, blocks: TimeBlocks) -> bool:
        """From blocks of 120 s on (up to the frame that rounding may take)."""
        lengths = np.diff(blocks.frames, axis=1) * blocks.dt_s
        return bool(np.median(lengths) >= LONG_BLOCK_S - 2 * blocks.dt_s)

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: minutes of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 60.0)}


def _binned(crowd: Trajectories, blocks: TimeBlocks, bin_s: float) -> Int[np.ndarray, "B V"]:
    """Per block how many whole bins have how many arrivals."""
    steps = max(1, round(bin_s / blocks.grid_s))
    ticks = np.ceil(blocks.arrival_s / blocks.grid_s - 1e-6).astype(np.int64)
    bins = (ticks[:, 1] - ticks[:, 0]) // steps
    first = np.concatenate([[0], np.cumsum(bins)])
    _, block, tick = blocks.of_arrivals(crowd)
    at = (tick - ticks[block, 0]) // steps
    whole = at < bins[block]
    entered = np.bincount((first[block] + at)[whole], minlength=first[-1])
    return histograms(entered, np.repeat(np.arange(len(blocks)), bins), len(blocks))


def _block_in_grid_steps(blocks: TimeBlocks) -> int:
    # From whole frames: differences of times would round differently from block to block.
    frames = (np.diff(blocks.frames, axis=1)[:, 0] - blocks.opens).mean()
    return max(1, round(float(frames) * blocks.dt_s / blocks.grid_s))
