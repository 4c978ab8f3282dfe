"""Mixtures of trips: where people start, where they go, and how fast, given both areas.

Areas are wide: people enter one by several doors, and stand at several counters. So

- every spawn area has some *places* of starts, and every goal area some of goals: a mixture of
  Gaussians;
- given both areas, a place of starts and one of goals are drawn together, with a probability that
  depends on both: who enters on the left goes to the left;
- given both places, start, goal and log speed are Gaussian. The pairs of places that ten people or
  more walked have a Gaussian of their own. The others have the product of those of both places and
  of all people's log speeds.

`crowdbench.spawn.plans.way_fitting` fits them.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.spawn.areas import Gaussians
from crowdbench.spawn.drawing import Indices, choose, draw_normal
from crowdbench.spawn.plans.mixtures import widened

TRIP = 5
"""Dimensions of a trip: start, goal, log speed."""
START, GOAL, SPEED = slice(0, 2), slice(2, 4), 4
_LEAST_VARIANCE = 1e-4
"""Of log speeds."""


@dataclass(frozen=True, eq=False)
class Places:
    """`C` Gaussian places in areas; those of one area are a mixture."""

    area: Int[np.ndarray, " C"]
    """Area of each place. Every area has a place."""
    weight: Float[np.ndarray, " C"]
    """P(place | area)."""
    mean: Float[np.ndarray, "C 2"]
    """Centres, metres."""
    covariance: Float[np.ndarray, "C 2 2"]
    """Square metres."""

    @classmethod
    def of(cls, areas: Gaussians) -> "Places":
        """One place in each area: all of it."""
        count = len(areas)
        wide = widened(areas.covariance, START)
        return cls(np.arange(count), np.ones(count), areas.mean, wide)

    def __len__(self) -> int:
        return len(self.area)


@dataclass(frozen=True, eq=False)
class TripMixtures:
    """Starts, goals and log speeds from `I` places in spawn areas to `J` in goal areas."""

    starts: Places
    goals: Places
    log_speed: Float[np.ndarray, " 2"]
    """Mean and variance over all people."""
    weight: Float[np.ndarray, "I J"]
    """P(both places | the areas in which they are)."""
    own: Int[np.ndarray, "T 2"]
    """The pairs of places that have a Gaussian of their own."""
    mean: Float[np.ndarray, "T 5"]
    covariance: Float[np.ndarray, "T 5 5"]

    @classmethod
    def apart(
        cls, starts: Places, goals: Places, log_speed: Float[np.ndarray, " 2"]
    ) -> "TripMixtures":
        """Trips whose starts, goals and log speeds do not depend on each other."""
        return cls(
            starts,
            goals,
            np.array([log_speed[0], max(float(log_speed[1]), _LEAST_VARIANCE)]),
            np.outer(starts.weight, goals.weight),
            np.zeros((0, 2), dtype=np.int64),
            np.zeros((0, TRIP)),
            np.zeros((0, TRIP, TRIP)),
        )

    @cached_property
    def gaussians(self) -> tuple[Float[np.ndarray, "I J 5"], Float[np.ndarray, "I J 5 5"]]:
        """Means and covariances of the trips from each place to each other one."""
        mean = np.zeros((len(self.starts), len(self.goals), TRIP))
        covariance = np.zeros((*mean.shape, TRIP))
        mean[..., START], mean[..., GOAL] = self.starts.mean[:, None], self.goals.mean
        covariance[..., START, START] = self.starts.covariance[:, None]
        covariance[..., GOAL, GOAL] = self.goals.covariance
        mean[..., SPEED], covariance[..., SPEED, SPEED] = self.log_speed
        at = tuple(self.own.T)
        mean[at], covariance[at] = self.mean, self.covariance
        return mean, covariance

    def between(self, spawn_area: int, goal_area: int) -> tuple[Indices, Indices]:
        """The pairs of a place in one area and a place in the other one."""
        i = np.flatnonzero(self.starts.area == spawn_area)
        j = np.flatnonzero(self.goals.area == goal_area)
        return np.repeat(i, len(j)), np.tile(j, len(i))

    def choose(self, spawn_area: Indices, goal_area: Indices, rng: Generator) -> Indices:
        """A pair of places for each person, as the number i J + j."""
        number, cumulative = self._choices
        column = choose(cumulative[spawn_area, goal_area], rng)
        return np.asarray(number[spawn_area, goal_area, column])

    def draw(self, chosen: Indices, rng: Generator) -> Float[np.ndarray, "n 5"]:
        """A start, a goal and a log speed for each person, whose places are chosen."""
        mean = self.gaussians[0].reshape(-1, TRIP)
        return draw_normal(mean[chosen], self._roots[chosen], rng)

    @cached_property
    def _roots(self) -> Float[np.ndarray, "pairs 5 5"]:
        return np.linalg.cholesky(self.gaussians[1].reshape(-1, TRIP, TRIP))

    @cached_property
    def _choices(self) -> tuple[Int[np.ndarray, "K G most"], Float[np.ndarray, "K G most"]]:
        """Numbers i J + j of the pairs of places between areas, and their cumulative weights.

        Fewer pairs than the most are filled up with the last one, which is never exceeded.
        """
        areas = self.starts.area.max() + 1, self.goals.area.max() + 1
        most = np.bincount(self.starts.area).max() * np.bincount(self.goals.area).max()
        number = np.zeros((*areas, most), dtype=np.int64)
        cumulative = np.ones((*areas, most))
        for a, g in np.ndindex(*number.shape[:2]):
            i, j = self.between(a, g)
            up_to = np.minimum(np.arange(most), len(i) - 1)
            number[a, g] = (i * len(self.goals) + j)[up_to]
            cumulative[a, g] = self.weight[i, j].cumsum()[up_to]
        return number, cumulative
