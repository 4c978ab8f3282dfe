"""A spawn model that copies the recording and hides it a little."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from crowdbench.registry import recording_of
from crowdbench.scene import Scene
from crowdbench.spawn import BlockReplay, SpawnEvents
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.events import blocks_of


class JitteredBlocks:
    """Blocks of the whole recording, each arrival moved by up to a frame."""

    name = "my-own-process"
    start = "stationary"

    def __init__(self, scene: Scene) -> None:
        recording = recording_of(scene)
        self._blocks = BlockReplay(recording, blocks_of(recording, scene), read_areas(scene))

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        events = self._blocks.sample(horizon_s, scene, rng)
        moved = events.time_s + scene.dt_s * rng.integers(-1, 2, len(events))
        moved = np.clip(moved, 0, horizon_s - scene.dt_s)
        return replace(events, time_s=moved)[np.argsort(moved, kind="stable")]
