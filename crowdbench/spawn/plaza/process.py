"""The true process of the plaza, a synthetic place on which models are tested.

Who enters: a hidden Markov chain that all areas share (calm, rush) lasts for minutes, and one of
each area (quiet, busy) for tens of seconds. All chains change in steps of a frame, independently of
each other. In each frame a group enters an area with a probability that depends on both states.
Late members of it may follow: a person is followed with the probability `FOLLOWS` one frame later
and, independently, with the same probability two frames later. People who are late themselves are
followed, too.

The numbers of persons per area and frame have an exact likelihood: given the states and the numbers
in the two frames before, the number of late persons is binomial, so that the forward algorithm
applies to the joint state of all chains. What people do after they have entered (see
`crowdbench.spawn.plaza.plans`) does not depend on these numbers and does not change it.
"""

from functools import reduce
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.compilation import compiled
from crowdbench.scene import Scene
from crowdbench.spawn.events import Arrivals, SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.plaza.plans import draw_plans, true_areas

SCENE = "plaza-v0"

STAY_S = (30.0, 12.0)
"""Mean stay of an area in the quiet and in the busy state."""
GROUPS_PER_S = np.array([[0.02, 0.30], [0.03, 0.20], [0.01, 0.15], [0.02, 0.25]])
"""Groups that enter each area (west, east, north, south) in both states, when the factor is 1."""
COMMON_STAY_S = (120.0, 60.0)
"""Mean stay of the whole plaza in calm and in rush."""
FACTOR = np.array([0.5, 2.0])
"""By which all rates are multiplied in calm and in rush; its mean is 1."""
SIZES = np.array([0.67, 0.20, 0.09, 0.03, 0.01])
"""P(1, 2, … members of a group enter in the same frame)."""
FOLLOWS = 0.05
"""P(a person is followed by a late member of its group), one frame later and two frames later."""
LATE = 2
"""Number of frames by which late members follow at most."""


class PlazaArrivals:
    """The true process as a spawn model; no fitted model can do better on new data."""

    name = "plaza-truth"
    start: ClassVar[Start] = "stationary"

    def __init__(self, scene: Scene) -> None:
        self.areas = true_areas(SCENE)
        self._grid_s = scene.grid_s
        self._common = _chain_of(COMMON_STAY_S, scene.grid_s)
        self._own = _chain_of(STAY_S, scene.grid_s)
        rate = FACTOR[:, None, None] * GROUPS_PER_S.T[None]
        self._enters: Float[np.ndarray, "2 2 K"] = 1 - np.exp(-rate * scene.grid_s)
        """P(a group enters in a frame) by common state, state of the area, and area."""

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds. Nobody was there before."""
        frames = int(np.ceil(horizon_s / scene.grid_s - 1e-6))
        areas = self._enters.shape[2]
        rush = _states(rng.random((1, frames)), *self._common)[0]
        busy = _states(rng.random((areas, frames)), *self._own)
        enters = self._enters[rush, busy, np.arange(areas)[:, None]]
        area, frame = np.nonzero(rng.random((areas, frames)) < enters)
        size = rng.choice(np.arange(1, len(SIZES) + 1), len(area), p=SIZES)
        group = np.repeat(np.arange(len(area)), size)
        frame, group = _with_late(frame[group], group, rng)
        inside = frame < frames
        frame, group = frame[inside], group[inside]
        order = np.lexsort((group, area[group], frame))
        return draw_plans(frame[order] * scene.grid_s, area, group[order], self.areas, scene, rng)

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Exact log-probability of the arrivals, in nats per person.

        Computed by the forward algorithm (Rabiner 1989, eqs. 19 and 20). Each window counts as a
        stretch before which nobody entered: who follows a person of the last two frames before it
        counts as a group.
        """
        from scipy.stats import binom

        counts = arrivals.counts()
        stops = np.cumsum(np.diff(arrivals.windows, axis=1)[:, 0])
        states = np.indices((2,) * (1 + arrivals.areas)).reshape(1 + arrivals.areas, -1)
        enters = self._enters[states[0], states[1:], np.arange(arrivals.areas)[:, None]].T
        chains = [self._common, *[self._own] * arrivals.areas]
        stationary, step = (reduce(np.kron, [c[k] for c in chains]) for k in (0, 1))
        total = 0.0
        for window in np.split(counts, stops[:-1]):
            before = np.zeros_like(window)
            for lag in range(1, LATE + 1):
                before[lag:] += window[:-lag]
            alone = binom.pmf(window, before, FOLLOWS)
            joined = sum(
                share * binom.pmf(window - size, before, FOLLOWS)
                for size, share in enumerate(SIZES.tolist(), start=1)
            )
            total += _forward(alone, joined, stationary, step, enters)
        return total / max(1, len(arrivals.tick))

    def rates_per_s(self) -> Float[np.ndarray, " K"]:
        """Mean number of persons who enter each area per second."""
        common, own = self._common[0], self._own[0]
        per_frame = np.einsum("c,z,cza->a", common, own, self._enters)
        members = SIZES @ np.arange(1, len(SIZES) + 1) / (1 - LATE * FOLLOWS)
        return np.asarray(per_frame * members / self._grid_s)

    def correlations(self, delay_s: Float[np.ndarray, " L"]) -> Float[np.ndarray, "L K K"]:
        """Pair correlation of groups, E[n_a(t) n_b(t + h)] / m_a m_b, for delays h > 0 in seconds.

        That of persons is the same at delays that are long compared with those of late members.
        """
        mean = np.einsum("c,z,cza->a", self._common[0], self._own[0], self._enters)
        of_rush = np.einsum("z,cza->ca", self._own[0], self._enters)
        found = np.empty((len(delay_s), len(mean), len(mean)))
        same = np.eye(len(mean), dtype=bool)
        for k, h in enumerate(delay_s.tolist()):
            common, own = (_joint(*c, h / self._grid_s) for c in (self._common, self._own))
            found[k] = np.einsum("cd,ca,db->ab", common, of_rush, of_rush)
            enters = (self._enters, self._enters)
            found[k][same] = np.einsum("cd,yz,cya,dza->a", common, own, *enters)
        return found / np.outer(mean, mean)


def group_sizes(most: int) -> Float[np.ndarray, " most"]:
    """P(a group has 1, 2, …, `most` members), late members included.

    The total progeny of a branching process with as many ancestors as enter together (Dwass 1969,
    Journal of Applied Probability 6): P(n members | k together) = k/n P(n persons are followed by
    n − k).
    """
    from scipy.stats import binom

    n, k = np.arange(1, most + 1)[:, None], np.arange(1, len(SIZES) + 1)
    return np.asarray((k / n * binom.pmf(n - k, LATE * n, FOLLOWS)) @ SIZES)


def _chain_of(
    stay_s: tuple[float, float], grid_s: float
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]:
    """Stationary and transition probabilities of a chain with these mean stays."""
    leave = 1 - np.exp(-grid_s / np.array(stay_s))
    step = np.array([[1 - leave[0], leave[0]], [leave[1], 1 - leave[1]]])
    return leave[::-1] / leave.sum(), step


def _joint(
    stationary: Float[np.ndarray, " 2"], step: Float[np.ndarray, "2 2"], steps: float
) -> Float[np.ndarray, "2 2"]:
    """Probabilities of the states at two times this number of steps apart."""
    kept = (step[0, 0] + step[1, 1] - 1) ** steps  # the second eigenvalue; the first one is 1
    return np.asarray(stationary[:, None] * (kept * np.eye(2) + (1 - kept) * stationary[None, :]))


def _with_late(
    frame: Int[np.ndarray, " n"], group: Int[np.ndarray, " n"], rng: Generator
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Frames and groups of these people and of all who follow them."""
    frames, groups = [frame], [group]
    while len(frame):
        followed = rng.random((LATE, len(frame))) < FOLLOWS
        lag, person = np.nonzero(followed)
        frame, group = frame[person] + lag + 1, group[person]
        frames.append(frame)
        groups.append(group)
    return np.concatenate(frames), np.concatenate(groups)


@compiled(error_model="python")
def _states(
    u: Float[np.ndarray, "K T"], stationary: Float[np.ndarray, " 2"], step: Float[np.ndarray, "2 2"]
) -> Int[np.ndarray, "K T"]:
    """States (0 or 1) of K independent chains, from uniform random numbers."""
    state = np.zeros(u.shape, np.int64)
    for k in range(u.shape[0]):
        for t in range(u.shape[1]):
            p = stationary[1] if t == 0 else step[state[k, t - 1], 1]
            state[k, t] = u[k, t] < p
    return state


@compiled(error_model="python")
def _forward(
    alone: Float[np.ndarray, "T K"],
    joined: Float[np.ndarray, "T K"],
    stationary: Float[np.ndarray, " S"],
    step: Float[np.ndarray, "S S"],
    enters: Float[np.ndarray, "S K"],
) -> float:
    """Log-probability of the numbers of persons in one window.

    `alone` and `joined` are their probabilities given that no group enters and that one does,
    `enters` is the probability that one does, in each of the S joint states.
    """
    total = 0.0
    belief = stationary.copy()
    for t in range(len(alone)):
        for s in range(len(belief)):
            for a in range(alone.shape[1]):
                p = enters[s, a]
                belief[s] *= (1 - p) * alone[t, a] + p * joined[t, a]
        probability = belief.sum()
        if probability <= 0.0:
            return -np.inf
        total += np.log(probability)
        belief = step.T @ (belief / probability)
    return total
