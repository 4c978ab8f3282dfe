"""Small recordings on a square without walls, for tests of demonstrations."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np
import pytest
from worlds import square

from crowdbench.data.companions import with_companions
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.scene import Scene

DT = 0.4
SQUARE = square(half_m=40.0)


def recorded(*paths: tuple[int, np.ndarray], frames: int = 80) -> Trajectories:
    """A recording of people by first frame and path, with companions by the usual rule."""
    sizes = [len(path) for _, path in paths]
    crowd = from_rows(
        scene="drawn",
        dt_s=DT,
        frames=frames,
        person_id=np.repeat(np.arange(len(paths)), sizes),
        frame=np.concatenate([first + np.arange(len(path)) for first, path in paths]),
        xy=np.concatenate([path for _, path in paths]),
        where="test",
    )
    return with_companions(crowd)


def straight(start: tuple[float, float], velocity: tuple[float, float], rows: int) -> np.ndarray:
    """The path of someone who walks straight on, positions (rows, 2) in metres."""
    return np.array(start) + np.arange(rows)[:, None] * DT * np.array(velocity)


def wandering(rng: np.random.Generator, rows: int) -> np.ndarray:
    """The path of someone who changes velocity all the time, at up to 2 m/s."""
    velocity = np.cumsum(rng.normal(0, 0.3, (rows - 1, 2)), axis=0) + rng.normal(0, 1, 2)
    speed = np.hypot(*velocity.T)[:, None]
    velocity *= np.minimum(1, 2.0 / np.maximum(speed, 1e-9))
    steps = np.concatenate([rng.uniform(-8, 8, (1, 2)), DT * velocity])
    return np.cumsum(steps, axis=0)


@contextmanager
def recording_is(crowd: Trajectories) -> Iterator[Scene]:
    """The recording of every scene is this one; returns a scene for it."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("crowdbench.registry.recording_of", lambda scene: crowd)
        yield SQUARE
