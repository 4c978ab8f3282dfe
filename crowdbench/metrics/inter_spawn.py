"""Inter-spawn times: the gaps between one arrival and the next."""

import numpy as np

from crowdbench.blocks import TimeBlocks
from crowdbench.metrics.lattice import histograms, mean, normalised, relative_wasserstein1
from crowdbench.metrics.metric import Histograms, MetricResult
from crowdbench.trajectories import Trajectories


class InterSpawn:
    """Gaps between consecutive arrivals of the whole scene, on the annotation grid.

    Each person is an arrival, so people who enter together make gaps of zero. A gap lies within
    one block. Distance: Wasserstein-1 of the gaps divided by the recording's mean gap; a crowd
    without a gap counts as one whose gaps are a block long.
    """

    name = "inter_spawn"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks) -> Histograms:
        """`gaps[b, g]`: gaps of g grid steps in block b."""
        _, block, tick = blocks.of_arrivals(crowd)
        within = np.diff(block) == 0
        return {"gaps": histograms(np.diff(tick)[within], block[1:][within], len(blocks))}

    def compare(
        self, recorded: Histograms, simulated: Histograms, blocks: TimeBlocks
    ) -> MetricResult:
        """Compare the distributions of gaps."""
        # From whole frames: differences of times would round differently from block to block.
        frames = (np.diff(blocks.frames, axis=1)[:, 0] - blocks.opens).mean()
        block = max(1, round(float(frames) * blocks.dt_s / blocks.grid_s))
        p = normalised(recorded["gaps"].sum(axis=0), if_empty=block)
        q = normalised(simulated["gaps"].sum(axis=0), if_empty=block)
        return MetricResult(
            distance=relative_wasserstein1(p, q),
            recorded=mean(p) * blocks.grid_s,
            simulated=mean(q) * blocks.grid_s,
            unit="s",
            n=int(simulated["gaps"].sum()),
        )
