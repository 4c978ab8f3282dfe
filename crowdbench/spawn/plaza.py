"""Arrivals on the plaza, a synthetic place with a known true process, for testing models.

Arrivals are bursty and in groups, independently for each area. A hidden Markov chain with two
states (quiet, busy) changes in steps of a frame. In each frame a group enters with a probability
that depends on the state, and its size is geometric. A Poisson model cannot represent this process,
and the exact likelihood is available from the forward algorithm.
"""

from dataclasses import replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numba import njit
from numpy.random import Generator

from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start

SCENE = "plaza-v0"

CENTRES_M = np.array(
    [[1.5, 9.5], [28.5, 10.0], [16.5, 18.5], [12.0, 1.5]]
)  # west, east, north, south
SPREAD_M = np.array([[0.4, 0.9], [0.4, 0.8], [0.9, 0.4], [0.8, 0.4]])
FLOW = np.array(
    [[0.0, 0.5, 0.3, 0.2], [0.6, 0.0, 0.1, 0.3], [0.3, 0.2, 0.0, 0.5], [0.2, 0.3, 0.5, 0.0]]
)
SPEED_MPS, SPEED_SD_MPS = 1.34, 0.26  # Weidmann (1993), Transporttechnik der Fußgänger
STAY_S = (30.0, 12.0)  # mean stay in the quiet and in the busy state
GROUPS_PER_S = np.array([[0.02, 0.30], [0.03, 0.20], [0.01, 0.15], [0.02, 0.25]])  # by state
NEXT_MEMBER = 0.4  # P(a group has one more member)


class PlazaArrivals:
    """The true process as a spawn model; no fitted model can do better on new data."""

    name = "plaza-truth"
    start: ClassVar[Start] = "stationary"

    def __init__(self, scene: Scene) -> None:
        self.areas = true_areas()
        dt_s = scene.grid_s
        leave = 1 - np.exp(-dt_s / np.array(STAY_S))
        self._step = np.array([[1 - leave[0], leave[0]], [leave[1], 1 - leave[1]]])
        self._stationary = leave[::-1] / leave.sum()
        self._group = 1 - np.exp(-GROUPS_PER_S * dt_s)

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds.

        Members of a group enter at the same time and have the same goal area.
        """
        frames = int(np.ceil(horizon_s / scene.grid_s - 1e-6))
        areas = len(self._group)
        changes = rng.random((areas, frames))
        busy = _chain(changes, self._stationary, self._step)
        enters = rng.random((areas, frames)) < np.take_along_axis(self._group, busy, axis=1)
        area, frame = np.nonzero(enters)
        size = rng.geometric(1 - NEXT_MEMBER, len(area))
        events = self.areas.draw(
            np.repeat(frame * scene.grid_s, size), np.repeat(area, size), scene, rng
        )
        return self._together(events, scene, rng)

    def _together(self, events: SpawnEvents, scene: Scene, rng: Generator) -> SpawnEvents:
        """The events with all members of a group given the goal area of the first."""
        key = np.stack([events.time_s, events.spawn_area], axis=1)
        _, first, group = np.unique(key, axis=0, return_index=True, return_inverse=True)
        goal_area = events.goal_area[first][group]
        goal = self.areas.goal.draw(goal_area, scene, rng).astype(np.float32)
        return replace(events, goal_area=goal_area, goal=goal)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Exact log-probability of the arrivals, in nats per person.

        Computed by the forward algorithm (Rabiner 1989, eqs. 19 and 20).
        """
        counts = arrivals.counts()
        stops = np.cumsum(np.diff(arrivals.windows, axis=1)[:, 0])
        total = 0.0
        for window in np.split(counts, stops[:-1]):
            for area in range(arrivals.areas):
                total += _forward(
                    window[:, area], self._stationary, self._step, self._group[area], NEXT_MEMBER
                )
        return total / max(1, len(arrivals.tick))


def true_areas() -> Areas:
    """The true areas, flows and speeds of the plaza."""
    from scipy.stats import norm

    gaussians = Gaussians(CENTRES_M, np.stack([np.diag(sd**2) for sd in SPREAD_M]))
    levels = np.linspace(0.005, 0.995, 101)  # a normal truncated at 2.6 standard deviations
    return Areas(
        scene=SCENE,
        spawn=gaussians,
        goal=gaussians,
        flow=FLOW,
        speed_quantiles=SPEED_MPS + SPEED_SD_MPS * norm.ppf(levels),
        left_out=(0.0, 0.0),
    )


@njit(cache=True)
def _chain(
    u: Float[np.ndarray, "K T"], stationary: Float[np.ndarray, " 2"], step: Float[np.ndarray, "2 2"]
) -> Int[np.ndarray, "K T"]:
    busy = np.zeros(u.shape, np.int64)
    for k in range(u.shape[0]):
        for t in range(u.shape[1]):
            p = stationary[1] if t == 0 else step[busy[k, t - 1], 1]
            busy[k, t] = u[k, t] < p
    return busy


@njit(cache=True)
def _forward(
    counts: Int[np.ndarray, " T"],
    stationary: Float[np.ndarray, " 2"],
    step: Float[np.ndarray, "2 2"],
    group: Float[np.ndarray, " 2"],
    next_member: float,
) -> float:
    """Log-probability of the counts of one area in one window."""
    total = 0.0
    belief = stationary.copy()
    for t in range(len(counts)):
        n = counts[t]
        if n == 0:
            seen = belief * (1 - group)
        else:
            seen = belief * group * ((1 - next_member) * next_member ** (n - 1))
        probability = seen.sum()
        total += np.log(probability)
        belief = step.T @ (seen / probability)
    return total
