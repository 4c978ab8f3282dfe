"""The true process of the plaza, a synthetic place on which models are tested.

Who enters: a hidden Markov chain that all areas share (calm, rush) lasts for minutes, and one of
each area (quiet, busy) for tens of seconds. All chains change in steps of a frame, independently of
each other. In each frame a group enters an area with a probability that depends on both states.
Late members of it may follow: a person is followed with the probability `FOLLOWS` one frame later
and, independently, with the same probability two frames later. People who are late themselves are
followed, too.

The numbers of persons per area and frame have an exact likelihood: given the states and the numbers
in the two frames before, the number of late persons is binomial, so that the forward algorithm
applies to the joint state of all chains. What people do after they have entered does not depend on
these numbers and does not change it.

What they do: a group has one start, goal, speed and plan. Its members stand in a line across the
way, in the order in which they entered, with the middle of the line at the group's place, and keep
their place in it. Some groups stop once. Places are redrawn until the whole group has room there.
"""

from functools import reduce
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.compilation import compiled
from crowdbench.data.table import Indices, Numbers
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import Arrivals, SpawnEvents, entering
from crowdbench.spawn.model import Start

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

CENTRES_M = np.array(
    [[1.5, 9.5], [28.5, 10.0], [16.5, 18.5], [12.0, 1.5]]
)  # west, east, north, south
SPREAD_M = np.array([[0.4, 0.9], [0.4, 0.8], [0.9, 0.4], [0.8, 0.4]])
FLOW = np.array(
    [[0.0, 0.5, 0.3, 0.2], [0.6, 0.0, 0.1, 0.3], [0.3, 0.2, 0.0, 0.5], [0.2, 0.3, 0.5, 0.0]]
)
SPEED_MPS, SPEED_SD_MPS = 1.34, 0.26  # Weidmann (1993), Transporttechnik der Fußgänger

ABREAST_M, ABREAST_SD_M = 0.7, 0.1
"""Distance from one member of a group to the next."""
SLOWER = 0.9
"""Speed of groups, relative to that of people who are alone."""
STOPPING = 0.15
"""P(a group, or a person who is alone, stops on its way)."""
PLACES_M = np.array([[19.5, 10.8], [9.0, 12.0]])  # in front of the kiosk, at a bench
PLACE_SPREAD_M = np.array([[0.5, 0.4], [0.5, 0.4]])
PLACE_SHARE = np.array([0.6, 0.4])
WAIT_S = np.array([12.0, 20.0])
"""Median wait at each place."""
WAIT_LOG_SD = np.array([0.4, 0.4])
_DRAWS = 100


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

        states = np.indices((2,) * (1 + arrivals.areas)).reshape(1 + arrivals.areas, -1)
        enters = self._enters[states[0], states[1:], np.arange(arrivals.areas)[:, None]].T
        chains = [self._common, *[self._own] * arrivals.areas]
        stationary, step = (reduce(np.kron, [c[k] for c in chains]) for k in (0, 1))
        total = 0.0
        for window in arrivals.by_window():
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


def _chain_of(
    stay_s: tuple[float, float], grid_s: float
) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "2 2"]]:
    """Stationary and transition probabilities of a chain with these mean stays."""
    leave = 1 - np.exp(-grid_s / np.array(stay_s))
    step = np.array([[1 - leave[0], leave[0]], [leave[1], 1 - leave[1]]])
    return leave[::-1] / leave.sum(), step


def _with_late(
    frame: Int[np.ndarray, " n"], group: Int[np.ndarray, " n"], rng: Generator
) -> tuple[Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    frames, groups = [frame], [group]
    while len(frame):
        followed = rng.random((LATE, len(frame))) < FOLLOWS
        lag, person = np.nonzero(followed)
        frame, group = frame[person] + lag + 1, group[person]
        frames.append(frame)
        groups.append(group)
    return np.concatenate(frames), np.concatenate(groups)


def true_areas(scene: str) -> Areas:
    """The true areas, flows and speeds of the plaza. The places are those of whole groups."""
    from scipy.stats import norm

    gaussians = _gaussians(CENTRES_M, SPREAD_M)
    levels = np.linspace(0.005, 0.995, 101)  # a normal truncated at 2.6 standard deviations
    return Areas(
        scene=scene,
        spawn=gaussians,
        goal=gaussians,
        flow=FLOW,
        speed_quantiles=SPEED_MPS + SPEED_SD_MPS * norm.ppf(levels),
        left_out=(0.0, 0.0),
    )


def _gaussians(mean: Float[np.ndarray, "K 2"], spread: Float[np.ndarray, "K 2"]) -> Gaussians:
    return Gaussians(mean, np.stack([np.diag(sd**2) for sd in spread]))


def draw_plans(
    time_s: Float[np.ndarray, " E"],
    area: Int[np.ndarray, " G"],
    group: Int[np.ndarray, " E"],
    areas: Areas,
    scene: Scene,
    rng: Generator,
) -> SpawnEvents:
    """Draw the plans of people who enter at these times (ascending, seconds).

    `area` is the spawn area of each group, `group` the group of each person.
    """
    size = np.bincount(group, minlength=len(area))
    # Places, speeds and goals of the groups are drawn as for people who are alone.
    alone = areas.draw(np.zeros(len(area)), area, scene, rng)
    goal_area = alone.goal_area.astype(np.int64)
    speed = alone.speed * np.where(size > 1, SLOWER, 1.0)
    stops = rng.random(len(area)) < STOPPING
    place = rng.choice(len(PLACES_M), len(area), p=PLACE_SHARE)
    wait_s = WAIT_S[place] * np.exp(WAIT_LOG_SD[place] * rng.standard_normal(len(area)))
    aside_m, places = _aside_m(group, size, rng), _gaussians(PLACES_M, PLACE_SPREAD_M)
    kinds = ((areas.spawn, area), (areas.goal, goal_area), (places, place))
    start, goal, via = _in_lines(kinds, group, aside_m, scene, rng)
    number = np.cumsum(size > 1) - 1
    return entering(
        time_s=time_s,
        start=start,
        goal=goal,
        spawn_area=area[group],
        goal_area=goal_area[group],
        speed=speed[group],
        group=np.where(size > 1, number, -1)[group],
        via=np.where(stops[group, None], via, np.nan),
        wait_s=np.where(stops, wait_s, 0.0)[group],
    )


def _aside_m(group: Indices, size: Int[np.ndarray, " G"], rng: Generator) -> Numbers:
    """Place of each person in the line of its group: metres to the left of the middle."""
    order = np.argsort(group, kind="stable")
    along = np.empty(len(group))
    # The gap before the first member shifts the line, no more.
    along[order] = np.cumsum(rng.normal(ABREAST_M, ABREAST_SD_M, len(group)))
    middle = np.bincount(group, along, len(size)) / np.maximum(size, 1)
    side = np.where(rng.random(len(size)) < 0.5, -1.0, 1.0)
    return np.asarray(side[group] * (along - middle[group]))


def _in_lines(
    kinds: tuple[tuple[Gaussians, Int[np.ndarray, " G"]], ...],
    group: Indices,
    aside_m: Numbers,
    scene: Scene,
    rng: Generator,
) -> Float[np.ndarray, "3 n 2"]:
    """Start, goal and place of a stop of each person, drawn from areas of each group."""
    groups = len(kinds[0][1])
    middle, points = np.empty((3, groups, 2)), np.empty((3, len(group), 2))
    open_ = np.arange(groups)
    for _ in range(_DRAWS):
        for k, (gaussians, of_group) in enumerate(kinds):
            middle[k, open_] = gaussians.draw(of_group[open_], scene, rng)
        way = middle[1] - middle[0]
        left = np.column_stack([-way[:, 1], way[:, 0]]) / np.linalg.norm(way, axis=1)[:, None]
        points = middle[:, group] + aside_m[:, None] * left[group]
        inside = scene.walkable(points.reshape(-1, 2)).reshape(3, -1).all(axis=0)
        open_ = np.unique(group[~inside])
        if len(open_) == 0:
            return points
    # The largest groups are wider than their street: some of them stand at its walls.
    return scene.nearest_walkable(points.reshape(-1, 2)).reshape(3, -1, 2)


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
