"""`block-replay`: time blocks of a recording, drawn at random and replayed one after another.

This is a memorisation baseline: the arrivals within a block are the recorded ones, and different
blocks are independent.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Int
from numpy.random import Generator

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.table import Indices, Trajectories
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.model import Start
from crowdbench.spawn.recorded_plans import places_of, plans_of


@dataclass(frozen=True, eq=False)
class BlockReplay:
    """The arrivals in blocks of a recording, which are drawn with replacement.

    People have their recorded goals, companions, stops and preferred speeds; see `plans_of`. So
    that no arrival is discarded, people who were not seen to leave get a goal drawn from the
    scene's areas given their spawn area, and people without a preferred speed get one drawn from
    the scene's.
    """

    recording: Trajectories
    blocks: TimeBlocks
    areas: Areas
    name: str = "block-replay"
    start: ClassVar[Start] = "stationary"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds; times are on the grid."""
        persons, block, tick = self.blocks.of_arrivals(self.recording)
        grid_s = self.blocks.grid_s
        first, stop = np.ceil(self.blocks.arrival_s / grid_s - 1e-6).astype(np.int64).T
        horizon = int(np.ceil(horizon_s / grid_s - 1e-6))
        drawn, begin = _draw(stop - first, horizon, rng)

        # Arrivals are sorted by tick, hence by block.
        edges = np.searchsorted(block, np.arange(len(self.blocks) + 1))
        chosen = [np.arange(edges[b], edges[b + 1]) for b in drawn]
        at = np.concatenate([np.empty(0, dtype=np.int64), *chosen])
        played = np.repeat(begin - first[drawn], [len(c) for c in chosen]) + tick[at]
        inside = (played >= 0) & (played < horizon)
        piece = np.repeat(np.arange(len(drawn)), [len(c) for c in chosen])
        persons, piece = persons[at][inside], piece[inside]

        crowd, plans = self.recording, plans_of(self.recording)
        start, end, via = (of[persons] for of in places_of(crowd, scene))
        spawn_area = crowd.spawn_area[persons]
        to_centre = np.linalg.norm(start[:, None] - self.areas.spawn.mean, axis=2)
        known = np.where(spawn_area >= 0, spawn_area, to_centre.argmin(axis=1))
        # Drawn for everyone, even if not needed, so that the use of random numbers is simple.
        usual = self.areas.draw(np.arange(len(persons)) * 1.0, known, scene, rng)
        left, speed = crowd.left[persons], plans.speed[persons]
        speed = np.where(np.isfinite(speed), speed, usual.speed)
        # A block that is played twice has its groups twice.
        groups = int(crowd.group.max(initial=-1)) + 1
        group = np.where(crowd.group[persons] < 0, -1, piece * groups + crowd.group[persons])
        return entering(
            time_s=played[inside] * grid_s,
            start=start,
            goal=np.where(left[:, None], end, usual.goal),
            spawn_area=spawn_area,
            goal_area=np.where(left, crowd.goal_area[persons], usual.goal_area),
            speed=np.minimum(speed, scene.motion.max_speed_mps),
            group=group,
            via=via,
            wait_s=plans.wait_s[persons],
        )


def _draw(length: Int[np.ndarray, " B"], horizon: int, rng: Generator) -> tuple[Indices, Indices]:
    """Draw blocks that fill [0, `horizon`); returns them and the grid point where each begins.

    The first block is the one that contains a random grid point of all blocks, and it begins so
    that this point is at 0. The expected number of arrivals is then the same at every grid point.
    """
    of_point = np.repeat(np.arange(len(length)), length)
    point = int(rng.integers(len(of_point)))
    drawn = [int(of_point[point])]
    begin = [int(np.searchsorted(of_point, drawn[0])) - point]
    while begin[-1] + length[drawn[-1]] < horizon:
        begin.append(begin[-1] + int(length[drawn[-1]]))
        drawn.append(int(rng.integers(len(length))))
    return np.array(drawn), np.array(begin)
