"""Family arrivals: when people enter.

Arrival times are on the annotation grid. Each person is one arrival, even within a group.
"""

import numpy as np
from jaxtyping import Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Trajectories
from crowdbench.metrics import lattice
from crowdbench.metrics.forms import LogRatio, RelativeWasserstein
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support, Vectors, Weights

ENOUGH_GAPS = 10
"""Minimum number of recorded gaps at an area for its distribution to be compared."""
LONG_BLOCK_S = 120.0
"""Minimum length of time blocks, in seconds, for statistics of counts in 60 s."""


class InterSpawn(RelativeWasserstein):
    """Gaps between consecutive arrivals in the whole scene.

    People who enter together have gaps of zero. Gaps across the edge of a block are not counted.
    Distance: Wasserstein-1 of the gaps, divided by the recording's mean gap. A crowd without gaps
    is treated as if its gaps were one block long.
    """

    name = "inter_spawn"
    family = "arrivals"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, g]`: gaps of g grid steps in block b; `pairs[b]`: sums for `memory`."""
        _, block, tick = blocks.of_arrivals(crowd)
        within = np.diff(block) == 0
        gap, block = np.diff(tick)[within], block[1:][within]
        both = np.diff(block) == 0
        return {
            "counts": lattice.histograms(gap, block, len(blocks)),
            "pairs": lattice.lagged_sums(
                gap[:-1][both], gap[1:][both], block[1:][both], len(blocks)
            ),
        }

    def step(self, blocks: TimeBlocks) -> float:
        """Lattice step: one step of the annotation grid, in seconds."""
        return blocks.grid_s

    def if_empty(self, blocks: TimeBlocks) -> int:
        """Value of an empty sample: the mean length of the blocks, in grid steps."""
        return _block_in_grid_steps(blocks)


def burstiness(sums: Sums, support: Support) -> float:
    """Burstiness B = (σ − μ)/(σ + μ) of the gaps (Goh & Barabási 2008, eq. 1).

    `sums` are those of `InterSpawn`. B is −1 for equal gaps, 0 for a Poisson process, and
    approaches 1 for extremely bursty arrivals. Shown, not scored.
    """
    mean, variance = lattice.moments(sums["counts"], support)
    sigma = np.sqrt(variance)
    return float((sigma - mean) / (sigma + mean)) if sigma + mean > 0 else 0.0


def memory(sums: Sums) -> float:
    """Memory M: correlation of consecutive gaps (Goh & Barabási 2008, eq. 2).

    `sums` are those of `InterSpawn`. Shown, not scored.
    """
    return float(lattice.correlation(sums["pairs"]))


class InterSpawnPerArea(Metric):
    """Gaps between consecutive arrivals at the same spawn area.

    Distance: Wasserstein-1 per area, averaged with the areas' shares of the recorded gaps as
    weights, divided by the recorded mean gap over all areas (the mean of a single area can be 0).
    If any area has at least ten recorded gaps, areas with fewer are ignored, because a few gaps do
    not determine a distribution. An area without gaps is treated as if its gaps were one block
    long. Persons with an unknown area are ignored.
    """

    name = "inter_spawn_per_area"
    family = "arrivals"
    unit = "s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`area k[b, g]`: number of gaps of g grid steps at area k in block b."""
        persons, block, tick = blocks.of_arrivals(crowd)
        area = crowd.spawn_area[persons]
        statistics = {}
        for k in range(place.spawn_areas):
            b, t = block[area == k], tick[area == k]
            within = np.diff(b) == 0
            statistics[f"area {k}"] = lattice.histograms(
                np.diff(t)[within], b[1:][within], len(blocks)
            )
        return statistics

    def on_lattice(self, name: str) -> bool:
        """True: all statistics are histograms."""
        return True

    def if_empty(self, blocks: TimeBlocks) -> int:
        """Value of an empty sample: the mean length of the blocks, in grid steps."""
        return _block_in_grid_steps(blocks)

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """The distribution functions of all areas, concatenated."""
        block = self.if_empty(blocks)
        return np.concatenate(
            [lattice.cdf(c, support, if_empty=block) for c in sums.values()], axis=-1
        )

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """Lattice widths times each area's share of the gaps, over the mean gap of all areas.

        The shares are equal if there are no gaps. Infinite if the mean gap is 0.
        """
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
        return np.concatenate([lattice.widths(support) * (share / mean) for share in shares])

    def typical(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        """Mean gap over all areas, seconds."""
        return self._mean(sums, support, blocks) * blocks.grid_s

    def _mean(self, sums: Sums, support: Support, blocks: TimeBlocks) -> float:
        gaps = self.size(sums)
        if gaps == 0:
            return float(self.if_empty(blocks))
        return sum(int(c @ support) for c in sums.values()) / gaps

    def size(self, sums: Sums) -> int:
        """Number of gaps."""
        return sum(int(c.sum()) for c in sums.values())


class SpawnCounts(RelativeWasserstein):
    """Number of persons who enter within ten frames.

    The bins of a block start at its beginning; an incomplete last bin is left out. Distance:
    Wasserstein-1 divided by the recording's mean. A crowd without bins is treated as one that
    nobody enters.
    """

    name = "spawns_per_10_frames"
    family = "arrivals"
    unit = "persons"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of bins of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 10 * blocks.dt_s)}


class FanoFactor10(LogRatio):
    """Fano factor of arrival counts in ten frames: their variance over their mean.

    It is 1 for a Poisson process, and 0 if nobody enters. Distance: |log((a + .05)/(b + .05))|.
    Source: Fano (1947), Phys. Rev. 72, 26.
    """

    name = "fano_10_frames"
    family = "arrivals"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of bins of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 10 * blocks.dt_s)}

    def value(self, sums: Sums, support: Support) -> lattice.Numbers:
        """Variance of the counts over their mean; 0 if the mean is 0."""
        mean, variance = lattice.moments(sums["counts"], support)
        return np.divide(variance, mean, out=np.zeros_like(variance), where=mean > 0)


class FanoFactor60s(FanoFactor10):
    """Fano factor of arrival counts in 60 s; only for time blocks of 120 s or more."""

    name = "fano_60_s"

    def applies(self, blocks: TimeBlocks) -> bool:
        """Whether blocks are at least 120 s long, up to rounding to whole frames."""
        lengths = np.diff(blocks.frames, axis=1) * blocks.dt_s
        return bool(np.median(lengths) >= LONG_BLOCK_S - 2 * blocks.dt_s)

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, n]`: number of minutes of block b in which n persons enter."""
        return {"counts": _binned(crowd, blocks, 60.0)}


def _binned(crowd: Trajectories, blocks: TimeBlocks, bin_s: float) -> Int[np.ndarray, "B V"]:
    """Histogram per block of the number of arrivals in each complete bin."""
    steps = max(1, round(bin_s / blocks.grid_s))
    ticks = np.ceil(blocks.arrival_s / blocks.grid_s - 1e-6).astype(np.int64)
    bins = (ticks[:, 1] - ticks[:, 0]) // steps
    first = np.concatenate([[0], np.cumsum(bins)])
    _, block, tick = blocks.of_arrivals(crowd)
    at = (tick - ticks[block, 0]) // steps
    whole = at < bins[block]
    entered = np.bincount((first[block] + at)[whole], minlength=first[-1])
    return lattice.histograms(entered, np.repeat(np.arange(len(blocks)), bins), len(blocks))


def _block_in_grid_steps(blocks: TimeBlocks) -> int:
    # Computed from whole frames, because differences of times would round differently per block.
    frames = (np.diff(blocks.frames, axis=1)[:, 0] - blocks.opens).mean()
    return max(1, round(float(frames) * blocks.dt_s / blocks.grid_s))
