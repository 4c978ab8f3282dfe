"""Agents over time: how many persons are there at once."""

import numpy as np

from crowdbench.blocks import TimeBlocks
from crowdbench.metrics.lattice import histograms, mean, normalised, relative_wasserstein1
from crowdbench.metrics.metric import Histograms, MetricResult
from crowdbench.trajectories import Trajectories


class AgentsOverTime:
    """N(t) on the scene's frames inside the blocks, frames without anyone included.

    Distance: Wasserstein-1 of the two distributions of N, divided by the recording's mean N.
    """

    name = "agents_over_time"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks) -> Histograms:
        """`counts[b, n]`: frames of block b with n persons; beyond a crowd's end it is empty."""
        last = int(blocks.frames.max())
        present = np.pad(crowd.present(), (0, max(0, last - crowd.frames)))
        frame = np.concatenate([np.arange(start, stop) for start, stop in blocks.frames])
        block = np.repeat(np.arange(len(blocks)), np.diff(blocks.frames, axis=1)[:, 0])
        return {"counts": histograms(present[frame], block, len(blocks))}

    def compare(
        self, recorded: Histograms, simulated: Histograms, blocks: TimeBlocks
    ) -> MetricResult:
        """Compare the distributions of N."""
        p = normalised(recorded["counts"].sum(axis=0), if_empty=0)
        q = normalised(simulated["counts"].sum(axis=0), if_empty=0)
        return MetricResult(
            distance=relative_wasserstein1(p, q),
            recorded=mean(p),
            simulated=mean(q),
            unit="persons",
            n=int(simulated["counts"].sum()),
        )
