"""Dwell time: how long a person who enters stays."""

import numpy as np
from jaxtyping import Float

from crowdbench.blocks import TimeBlocks
from crowdbench.metrics.lattice import (
    histograms,
    kaplan_meier,
    mean,
    normalised,
    relative_wasserstein1,
)
from crowdbench.metrics.metric import Histograms, MetricResult
from crowdbench.trajectories import Trajectories


class Dwell:
    """Time from a person's first row to its last, of those who enter in the blocks.

    Lives are followed past the block's edge; who is still there when observation ends is
    right-censored, and the distribution is Kaplan–Meier's. Distance: Wasserstein-1 divided by
    the recording's mean dwell time; a crowd nobody enters counts as one dwelling a block long.
    """

    name = "dwell"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks) -> Histograms:
        """`ended[b, d]` and `censored[b, d]`: lives of d frames of those who enter in block b."""
        persons, block, _ = blocks.of_arrivals(crowd)
        life = (crowd.last - crowd.first)[persons]
        left = crowd.left[persons]
        return {
            "ended": histograms(life[left], block[left], len(blocks)),
            "censored": histograms(life[~left], block[~left], len(blocks)),
        }

    def compare(
        self, recorded: Histograms, simulated: Histograms, blocks: TimeBlocks
    ) -> MetricResult:
        """Compare the Kaplan–Meier distributions of dwell time."""
        block = max(1, round(float(np.diff(blocks.frames, axis=1).mean())))
        p, _ = distribution(recorded, if_empty=block)
        q, n = distribution(simulated, if_empty=block)
        return MetricResult(
            distance=relative_wasserstein1(p, q),
            recorded=mean(p) * blocks.dt_s,
            simulated=mean(q) * blocks.dt_s,
            unit="s",
            n=n,
        )


def distribution(statistics: Histograms, *, if_empty: int) -> tuple[Float[np.ndarray, " V"], int]:
    """Kaplan–Meier distribution of dwell time in frames, all blocks together, and its size.

    Nobody at all counts as a point mass at `if_empty`.
    """
    ended, censored = (statistics[name].sum(axis=0) for name in ("ended", "censored"))
    size = max(len(ended), len(censored))
    ended, censored = (np.pad(x, (0, size - len(x))) for x in (ended, censored))
    n = int(ended.sum() + censored.sum())
    if n == 0:
        return normalised(ended, if_empty=if_empty), 0
    return kaplan_meier(ended, censored), n
