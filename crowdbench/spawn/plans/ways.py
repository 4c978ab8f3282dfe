"""Ways: from where to where a person walks, by which point, with which stop, and how fast.

Given the spawn area a and the goal area g, which is drawn from the flows of the scene:

- start, goal and log speed are drawn from a mixture of Gaussians, see
  `crowdbench.spawn.plans.trip_mixtures`.
- Those who do not stop have a *bend*: the point of their path that is furthest from the straight
  line from start to goal, as the fraction along it and the distance from it. The pairs (a, g) that
  ten people or more have walked have a Gaussian of bends, drawn towards that of all people with the
  weight of 20 people. The others have that of all. A bend of more than 0.75 m becomes a via point.
- Those who stop do so in one of some common places: a mixture of Gaussians over the place and the
  logarithm of the wait, with the number of components chosen by the Bayesian information criterion.
  If fewer than ten people stop, they stop half way, and their waits are mixed with usual ones.

Starts, goals and via points are places where people have room: social forces keep them away from
walls, so that they would never arrive at others. No Gaussian stands for fewer than ten people, and
none of places is narrower than 0.3 m, so that nothing recorded can be read from it. Only trips
whose end was seen are used. They are weighted by 1 / P(the end of a trip as long as this is seen)
(Robins and Rotnitzky 1992), because long trips are cut off more often.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.errors import SceneError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.plans.mixtures import log_gaussians
from crowdbench.spawn.plans.trip_mixtures import TRIP, Places, TripMixtures
from crowdbench.spawn.recorded_plans import SLOWEST_MPS

BEND = 2
"""Dimensions of a bend: fraction along the straight line, metres to its left."""
STOP = 3
"""Dimensions of a stop: place, log wait."""
OFF_M = 0.75
"""Smallest bend that is a via point."""
_DRAWS = 1000
_DRAWS_IN_PLACE = 50
"""One in ten has room in the worst place of Grand Central."""


@dataclass(frozen=True, eq=False)
class Trips:
    """What `n` recorded people did, who were seen to enter, walk and leave."""

    weight: Float[np.ndarray, " n"]
    """1 / P(a trip as long as this is seen to its end)."""
    spawn_area: Int[np.ndarray, " n"]
    goal_area: Int[np.ndarray, " n"]
    trip: Float[np.ndarray, "n 5"]
    """Start, goal, log speed."""
    bend: Float[np.ndarray, "n 2"]
    stop: Float[np.ndarray, "n 3"]
    """Place and log wait; NaN for those who do not stop."""

    @property
    def stops(self) -> Bool[np.ndarray, " n"]:
        """Whether they stop."""
        return np.isfinite(self.stop[:, 0])


@dataclass(frozen=True, eq=False)
class Ways:
    """Mixtures of trips, Gaussians of the bends of each pair of areas, and the places of stops."""

    trips: TripMixtures
    bend_mean: Float[np.ndarray, "K G 2"]
    bend_covariance: Float[np.ndarray, "K G 2 2"]
    stopping: Float[np.ndarray, "K G"]
    """P(a person stops on its way)."""
    stop_mean: Float[np.ndarray, "C 3"]
    stop_covariance: Float[np.ndarray, "C 3 3"]
    from_area: Float[np.ndarray, "C K"]
    """P(component | spawn area), but for a factor."""
    to_area: Float[np.ndarray, "C G"]
    """P(component | goal area), but for a factor."""
    longer: Float[np.ndarray, " K"]
    """Added to the log waits of people from each spawn area; 0 unless it is steered."""
    fastest_mps: float

    @cached_property
    def _bend_roots(self) -> Float[np.ndarray, "K G 2 2"]:
        return np.linalg.cholesky(self.bend_covariance)

    @cached_property
    def _stop_roots(self) -> Float[np.ndarray, "C 3 3"]:
        return np.linalg.cholesky(self.stop_covariance)

    def mean_wait_s(self, area: int, flow: Float[np.ndarray, " G"]) -> float:
        """Mean wait of people from an area who stop, for these probabilities of goals."""
        share = self.from_area[:, area] * (self.to_area * flow * self.stopping[area]).sum(axis=1)
        if share.sum() == 0:  # as if all areas had the same people
            share = self.from_area.sum(axis=1)
        log_wait, variance = self.stop_mean[:, 2], self.stop_covariance[:, 2, 2]
        return float(share @ np.exp(log_wait + variance / 2) / share.sum())

    def instead(self, areas: Areas) -> "Ways":
        """Ways from other spawn areas to the same goals, without stops."""
        log_speed = np.log(np.clip(areas.speed_quantiles, SLOWEST_MPS, self.fastest_mps))
        speeds = np.array([log_speed.mean(), log_speed.var()])
        shape, count = (len(areas.spawn), len(areas.goal)), len(self.stop_mean)
        bend_mean = self.bend_mean.mean(axis=0), self.bend_covariance.mean(axis=0)
        return replace(
            self,
            trips=TripMixtures.apart(Places.of(areas.spawn), self.trips.goals, speeds),
            bend_mean=np.broadcast_to(bend_mean[0], (*shape, BEND)),
            bend_covariance=np.broadcast_to(bend_mean[1], (*shape, BEND, BEND)),
            stopping=np.zeros(shape),
            from_area=np.ones((count, shape[0])),
            longer=np.zeros(shape[0]),
        )

    def log_trips(self, trips: Trips) -> Float[np.ndarray, " n"]:
        """Log density of starts, goals and log speeds, given the areas.

        Walls and bounds, at which ways are drawn again, are left out of account.
        """
        return self.trips.log_density(trips.spawn_area, trips.goal_area, trips.trip)

    def log_stopping(self, trips: Trips) -> Float[np.ndarray, " n"]:
        """Log probability that they stop, or that they do not, given the areas."""
        p = self.stopping[trips.spawn_area, trips.goal_area]
        return np.asarray(np.log(np.where(trips.stops, p, 1 - p)))

    def log_stops(self, trips: Trips) -> Float[np.ndarray, " m"]:
        """Log density of the places and log waits of the `m` people who stop."""
        stops = trips.stops
        x = trips.stop[stops]
        share = self.from_area[:, trips.spawn_area[stops]] * self.to_area[:, trips.goal_area[stops]]
        each = log_gaussians(x, self.stop_mean, self.stop_covariance).T
        return np.asarray(np.logaddexp.reduce(each + np.log(share / share.sum(axis=0)), axis=0))

    def draw(
        self,
        spawn_area: Int[np.ndarray, " n"],
        goal_area: Int[np.ndarray, " n"],
        scene: Scene,
        rng: Generator,
    ) -> Float[np.ndarray, "n 8"]:
        """A way for each person: start, goal, log speed, via, and log wait.

        Via is NaN for those who go straight, log wait for those who do not stop. Ways with a point
        where a person has no room are drawn again, between the same places: the shares of places,
        and of people who stop, remain what they are. Only places in which nobody has room, after
        50 draws, are chosen again.

        Raises:
            SceneError: no way with room can be drawn.
        """
        found = np.full((len(spawn_area), 8), np.nan)
        chosen = self.trips.choose(spawn_area, goal_area, rng)
        stopping = rng.random(len(found)) < self.stopping[spawn_area, goal_area]
        open_ = np.arange(len(found))
        for attempt in range(1, _DRAWS + 1):
            a, g, stops = spawn_area[open_], goal_area[open_], stopping[open_]
            drawn = np.full((len(open_), 8), np.nan)
            drawn[:, :TRIP] = self.trips.draw(chosen[open_], rng)
            drawn[stops, 5:] = self._stops(a[stops], g[stops], rng)
            drawn[~stops, 5:7] = self._bends(a[~stops], g[~stops], drawn[~stops, :4], rng)
            good = self._possible(drawn, scene)
            found[open_[good]] = drawn[good]
            open_ = open_[~good]
            if len(open_) == 0:
                return found
            if attempt % _DRAWS_IN_PLACE == 0:
                chosen[open_] = self.trips.choose(spawn_area[open_], goal_area[open_], rng)
        raise SceneError(
            scene.folder,
            got=f"{len(open_)} people for whom no way could be drawn in {_DRAWS} attempts",
            expected="starts, goals and via points inside the bounds, a person's radius from walls",
            hint="Check the bounds and walls, or fit the scene again.",
        )

    def _stops(
        self, a: Int[np.ndarray, " n"], g: Int[np.ndarray, " n"], rng: Generator
    ) -> Float[np.ndarray, "n 3"]:
        """Places and log waits of stops."""
        if len(a) == 0:
            return np.zeros((0, STOP))
        cumulative = (self.from_area[:, a] * self.to_area[:, g]).cumsum(axis=0)
        u = rng.random(len(a)) * cumulative[-1]
        component = (u >= cumulative).sum(axis=0)
        root = self._stop_roots[component]
        noise = rng.standard_normal((len(a), STOP))
        drawn = self.stop_mean[component] + np.einsum("nij,nj->ni", root, noise)
        drawn[:, 2] += self.longer[a]
        return drawn

    def _bends(
        self,
        a: Int[np.ndarray, " n"],
        g: Int[np.ndarray, " n"],
        ends: Float[np.ndarray, "n 4"],
        rng: Generator,
    ) -> Float[np.ndarray, "n 2"]:
        """Via points of people who do not stop; NaN for those who go straight."""
        root = self._bend_roots[a, g]
        noise = rng.standard_normal((len(a), BEND))
        along, left = (self.bend_mean[a, g] + np.einsum("nij,nj->ni", root, noise)).T
        way = ends[:, 2:] - ends[:, :2]
        length = np.maximum(np.hypot(*way.T), 1e-9)
        across = np.column_stack([-way[:, 1], way[:, 0]]) / length[:, None]
        via = ends[:, :2] + along.clip(0.05, 0.95)[:, None] * way + left[:, None] * across
        return np.asarray(np.where(np.abs(left)[:, None] > OFF_M, via, np.nan))

    def _possible(self, drawn: Float[np.ndarray, "n 8"], scene: Scene) -> Bool[np.ndarray, " n"]:
        """Whether a person has room at all points, and the speed is one of those recorded."""
        low, high = np.log(SLOWEST_MPS), np.log(self.fastest_mps)
        good = (drawn[:, 4] >= low) & (drawn[:, 4] <= high)
        with_via = np.flatnonzero(np.isfinite(drawn[:, 5]))
        points = np.concatenate([drawn[:, :2], drawn[:, 2:4], drawn[with_via, 5:7]])
        at_starts, at_goals, at_via = np.split(scene.has_room(points), [len(drawn), 2 * len(drawn)])
        good &= at_starts & at_goals
        good[with_via] &= at_via
        return np.asarray(good)
