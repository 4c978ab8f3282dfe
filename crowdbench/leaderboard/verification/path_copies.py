"""Copied paths: trips whose course follows the one that the same person walked in the recording.

Start and goal say where a person walks on the whole, and honest walkers pass them as the recorded
people did. What is left, the small turns and changes of pace, nobody can know who has not seen the
path. So a trip is compared without its trend: a polynomial of degree three in time, which takes
away bows, constant speeds and drifts. The similarity of two courses is the correlation of the rest,
for the best of all rotations, reflections and shifts in time. A copy stays similar when it is bowed
sideways, mirrored, delayed or put beside other trips.
"""

import numpy as np
from jaxtyping import Complex, Float

from crowdbench.data.table import Trajectories
from crowdbench.run.judge import matched
from crowdbench.scene import Scene

SHORTEST_S = 6.0
"""Shorter trips are not compared: without their trend, little is left of them."""
LAG_S = 2.0
SIMILAR = 0.8
"""A trip whose course correlates above this is copied."""
DEGREE = 3
FEWEST = 10
"""With fewer trips there is no share."""


class PathCopies:
    """Finds the trips of a crowd whose course is copied from the recording."""

    def __init__(self, recorded: Trajectories, scene: Scene) -> None:
        """Keep the recording, whose people are recognised by where and when they enter."""
        self._recorded = recorded
        self._frames = max(DEGREE + 2, round(SHORTEST_S / scene.dt_s))
        self._lag = round(LAG_S / scene.dt_s)

    def share(self, crowd: Trajectories) -> float | None:
        """Share of trips of at least 6 s that follow the recorded path of the same person.

        Of people who enter as recorded ones did. None if there are fewer than 10 such trips.
        """
        found = self.similarities(crowd)
        return float((found > SIMILAR).mean()) if len(found) >= FEWEST else None

    def similarities(self, crowd: Trajectories) -> Float[np.ndarray, " n"]:
        """The similarity of each of these trips to the recorded one, from 0 to 1."""
        person = matched(crowd, self._recorded)
        found = []
        for mine in np.flatnonzero(person >= 0).tolist():
            path, other = crowd.path(mine), self._recorded.path(int(person[mine]))
            both = min(len(path), len(other))
            if both > self._frames:
                found.append(similarity(_course(path[:both]), _course(other[:both]), self._lag))
        return np.array(found)


def similarity(a: Complex[np.ndarray, " n"], b: Complex[np.ndarray, " n"], lag: int) -> float:
    """Largest correlation of two courses over shifts of up to `lag` frames and reflections."""
    lag = min(lag, len(a) // 2)
    shifts = np.arange(-lag, lag + 1)
    shifted = np.lib.stride_tricks.sliding_window_view(np.pad(a, lag), len(a))
    products = np.abs(shifted @ np.stack([b.conj(), b], axis=1)).max(axis=1)
    norms = np.sqrt(_overlaps(a, shifts) * _overlaps(b, -shifts))
    known = norms > 1e-12
    return float((products[known] / norms[known]).max(initial=0.0))


def _overlaps(a: Complex[np.ndarray, " n"], shifts: np.ndarray) -> Float[np.ndarray, " s"]:
    """Sum of squares of the part of a course that overlaps with one that is shifted."""
    sums = np.concatenate([[0.0], np.cumsum(np.abs(a) ** 2)])
    return np.asarray(
        sums[len(a) + np.minimum(shifts, 0)] - sums[np.maximum(shifts, 0)], dtype=np.float64
    )


def _course(path: Float[np.ndarray, "n 2"]) -> Complex[np.ndarray, " n"]:
    """A path without its trend, as complex numbers."""
    xy = path.astype(np.float64)
    basis = np.linalg.qr(np.vander(np.linspace(-1, 1, len(xy)), DEGREE + 1))[0]
    rest = xy - basis @ (basis.T @ xy)
    return np.asarray(rest[:, 0] + 1j * rest[:, 1])
