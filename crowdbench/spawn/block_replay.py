"""`block-replay`: time blocks of a recording, drawn at random and played one after another.

What memory alone achieves: within a block the arrivals are the recorded ones, from block to
block they are independent.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import Arrivals, SpawnEvents, entering
from crowdbench.spawn.model import Start
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import Trajectories

NAME = "block-replay"


@dataclass(frozen=True, eq=False)
class BlockReplay:
    """The arrivals of blocks of a recording, drawn with replacement.

    A person walks to where its record ends, with its mean speed. Who was not seen to leave walks
    to a goal drawn from the scene's areas given its spawn area, whose record is of one frame
    only with a drawn speed: no arrival is lost.
    """

    recording: Trajectories
    blocks: TimeBlocks
    areas: Areas
    name: str = NAME
    start: ClassVar[Start] = "stationary"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Events in [0, `horizon_s`), on the recording's grid."""
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
        return self._events(persons[at][inside], played[inside] * grid_s, scene, rng)

    def _events(
        self,
        persons: Int[np.ndarray, " E"],
        time_s: Float[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> SpawnEvents:
        crowd = self.recording
        spawn_area = crowd.spawn_area[persons]
        start = scene.nearest_walkable(crowd.start[persons].astype(np.float64))
        end = scene.nearest_walkable(crowd.end[persons].astype(np.float64))
        to_centre = np.linalg.norm(start[:, None] - self.areas.spawn.mean, axis=2)
        known = np.where(spawn_area >= 0, spawn_area, to_centre.argmin(axis=1))
        # Everyone gets a draw, those who need none too, in the order of the persons.
        drawn = self.areas.draw(np.arange(len(persons)) * 1.0, known, scene, rng)
        left = crowd.left[persons]
        speed = crowd.mean_speeds()[persons]
        return entering(
            time_s=time_s,
            start=start,
            goal=np.where(left[:, None], end, drawn.goal),
            spawn_area=spawn_area,
            goal_area=np.where(left, crowd.goal_area[persons], drawn.goal_area),
            speed=np.where(np.isfinite(speed), speed, drawn.speed),
        )

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Block replay is no distribution of arrivals in continuous stretches.

        Raises:
            SettingError: always.
        """
        raise SettingError(NAME, got="a request for a likelihood", expected="a model that has one")


def _draw(
    length: Int[np.ndarray, " B"], horizon: int, rng: Generator
) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Blocks, and the grid points at which each begins, that fill [0, `horizon`).

    The first is that which stands at a random grid point of all blocks, and is under way; so the
    expected number of arrivals is the same at every grid point.
    """
    of_point = np.repeat(np.arange(len(length)), length)
    point = int(rng.integers(len(of_point)))
    drawn = [int(of_point[point])]
    begin = [int(np.searchsorted(of_point, drawn[0])) - point]
    while begin[-1] + length[drawn[-1]] < horizon:
        begin.append(begin[-1] + int(length[drawn[-1]]))
        drawn.append(int(rng.integers(len(length))))
    return np.array(drawn), np.array(begin)
