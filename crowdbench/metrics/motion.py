"""Family motion: how people move, by central differences over 0.8 s at every frame.

The span is two frames where a frame is 0.4 s, and the even number of frames next to 0.8 s
elsewhere. Frames count by their middle; both ends lie within the life.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.metrics.forms import RelativeWasserstein
from crowdbench.metrics.lattice import histograms, rounded
from crowdbench.metrics.metric import Place, Statistics
from crowdbench.metrics.rows import block_of_frames
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

SPAN_S = 0.8
STANDING_MPS = 0.2
"""Slower steps have no direction to speak of: annotation jitters by centimetres."""
FASTEST_MPS = 100.0
HARDEST_MPS2 = 1000.0
"""Beyond these a table is broken; its histogram must not outgrow memory."""


@lru_cache(maxsize=1)  # three metrics of the same crowd look at them
def _steps(
    crowd: Trajectories, blocks: TimeBlocks
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 2"], Int[np.ndarray, " n"], float]:
    """The way before and after each frame, metres, the frame's block, and seconds of each way."""
    half = max(1, round(SPAN_S / 2 / crowd.dt_s))
    row = np.arange(len(crowd.xy))
    person = crowd.row_person()
    inside = (row - half >= crowd.offsets[:-1][person]) & (row + half < crowd.offsets[1:][person])
    block = block_of_frames(blocks, crowd.frames)[crowd.row_frame()]
    middle = np.flatnonzero(inside & (block >= 0))
    xy = crowd.xy.astype(np.float64)
    before, after = xy[middle] - xy[middle - half], xy[middle + half] - xy[middle]
    return before, after, block[middle], half * crowd.dt_s


class Speed(RelativeWasserstein):
    """Speed of each person in each frame; speeds end at 100 m/s.

    Distance: Wasserstein-1 of speeds rounded to 1 cm/s, divided by the recording's mean.
    """

    name = "speed"
    family = "motion"
    unit = "m/s"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, v]`: persons and frames with a speed of v cm/s."""
        before, after, block, half_s = _steps(crowd, blocks)
        speed = np.linalg.norm(before + after, axis=1) / (2 * half_s)
        speed = np.minimum(speed, FASTEST_MPS)
        return {"counts": histograms(rounded(speed, 0.01), block, len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """1 cm/s."""
        return 0.01


class Acceleration(RelativeWasserstein):
    """Size of the change of velocity, in each frame; accelerations end at 1000 m/s².

    Distance: Wasserstein-1 of accelerations rounded to 1 cm/s², divided by the recording's mean.
    """

    name = "acceleration"
    family = "motion"
    unit = "m/s²"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, a]`: persons and frames with an acceleration of a cm/s²."""
        before, after, block, half_s = _steps(crowd, blocks)
        acceleration = np.linalg.norm(after - before, axis=1) / half_s**2
        acceleration = np.minimum(acceleration, HARDEST_MPS2)
        return {"counts": histograms(rounded(acceleration, 0.01), block, len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """1 cm/s²."""
        return 0.01


class Turning(RelativeWasserstein):
    """Angle between the ways before and after each frame, where neither is slower than 0.2 m/s.

    Distance: Wasserstein-1 of angles rounded to 1°, divided by the recording's mean.
    """

    name = "turning"
    family = "motion"
    unit = "°"

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, a]`: persons and frames with a turn of a degrees, to either side."""
        before, after, block, half_s = _steps(crowd, blocks)
        slower = np.minimum(np.linalg.norm(before, axis=1), np.linalg.norm(after, axis=1))
        walks = slower >= STANDING_MPS * half_s
        cross = before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0]
        dot = (before * after).sum(axis=1)
        turn = np.degrees(np.abs(np.arctan2(cross, dot)))[walks]
        return {"counts": histograms(rounded(turn, 1.0), block[walks], len(blocks))}

    def step(self, blocks: TimeBlocks) -> float:
        """1°."""
        return 1.0
