"""Ways: from where to where a person walks, by which point, with which stop, and how fast.

`crowdbench.spawn.plans.way_fitting` fits them.

Given the spawn area a and the goal area g, which is drawn from the flows of the scene:

- Start, goal and log speed are drawn from a mixture. Areas are wide: people enter one by several
  doors, and stand at several counters. So every spawn area has some *places* of starts, and every
  goal area some of goals: a mixture of Gaussians. A place of starts and one of goals are drawn
  together, with a probability that depends on both: who enters on the left goes to the left. Given
  both places, start, goal and log speed are Gaussian. The pairs of places that ten people or more
  walked have a Gaussian of their own. The others have the product of those of both places and of
  all people's log speeds. Log speeds are then moved to those of the same rank among recorded ones:
  those of people have fewer fast and more slow ones than a Gaussian.
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
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.data.table import Flags, Indices, Numbers, Points
from crowdbench.errors import SceneError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.drawing import choose, draw_normal
from crowdbench.spawn.plans.mixtures import widened
from crowdbench.spawn.recorded_plans import SLOWEST_MPS

TRIP = 5
"""Dimensions of a trip: start, goal, log speed."""
START, GOAL, SPEED = slice(0, 2), slice(2, 4), 4
_LEAST_VARIANCE = 1e-4  # of log speeds
BEND = 2
"""Dimensions of a bend: fraction along the straight line, metres to its left."""
STOP = 3
"""Dimensions of a stop: place, log wait."""
VIA, LOG_WAIT = slice(5, 7), 7
DrawnWays = Float[np.ndarray, "n 8"]
"""Rows of a trip (start, goal, log speed), `VIA` and `LOG_WAIT`. Via is NaN for those who go
straight, the log wait for those who do not stop."""
OFF_M = 0.75
"""Smallest bend that is a via point."""
SAME = np.array([[0.0, 0.0], [1.0, 1.0]])
"""Ranks that change nothing."""
_DRAWS = 1000
_DRAWS_IN_PLACE = 50  # one in ten has room in the worst place of Grand Central


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
    ranks: Float[np.ndarray, "R 2"]
    """Ascending log speeds as drawn, and recorded ones of the same ranks; see `ranked`."""
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
        shape = len(areas.spawn), len(areas.goal)
        return replace(
            self,
            trips=TripMixtures.apart(Places.of(areas.spawn), self.trips.goals, speeds),
            bend_mean=np.broadcast_to(self.bend_mean.mean(axis=0), (*shape, BEND)),
            bend_covariance=np.broadcast_to(
                self.bend_covariance.mean(axis=0), (*shape, BEND, BEND)
            ),
            ranks=SAME,
            stopping=np.zeros(shape),
            from_area=np.ones((len(self.stop_mean), shape[0])),
            longer=np.zeros(shape[0]),
        )

    def draw(
        self, spawn_area: Indices, goal_area: Indices, scene: Scene, rng: Generator
    ) -> DrawnWays:
        """A way for each person.

        Ways with a point where a person has no room are drawn again, between the same places: the
        shares of places, and of people who stop, remain what they are. Only places in which nobody
        has room, after 50 draws, are chosen again.

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
            drawn[:, :5] = self.trips.draw(chosen[open_], rng)
            drawn[:, SPEED] = ranked(drawn[:, SPEED], self.ranks)
            drawn[stops, 5:8] = self._stops(a[stops], g[stops], rng)
            drawn[~stops, VIA] = self._bends(a[~stops], g[~stops], drawn[~stops], rng)
            ends, via = have_room(drawn, scene)
            good = ends & via & (drawn[:, SPEED] == self.possible_speed(drawn[:, SPEED]))
            found[open_[good]] = drawn[good]
            open_ = open_[~good]
            if len(open_) == 0:
                return found
            if attempt % _DRAWS_IN_PLACE == 0:
                chosen[open_] = self.trips.choose(spawn_area[open_], goal_area[open_], rng)
        got = f"{len(open_)} people for whom no way could be drawn in {_DRAWS} attempts"
        expected = "starts, goals and via points inside the bounds, a person's radius from walls"
        hint = "Check the bounds and walls, or fit the scene again."
        raise SceneError(scene.folder, got=got, expected=expected, hint=hint)

    def possible_speed(self, log_speed: Numbers) -> Numbers:
        """The log speeds, or the nearest ones that are not slower or faster than recorded ones."""
        return np.clip(log_speed, *np.log([SLOWEST_MPS, self.fastest_mps]))

    def _stops(self, a: Indices, g: Indices, rng: Generator) -> Float[np.ndarray, "n 3"]:
        if len(a) == 0:
            return np.zeros((0, STOP))
        shares = self.from_area[:, a] * self.to_area[:, g]
        component = choose(shares.cumsum(axis=0).T, rng)
        drawn = draw_normal(self.stop_mean[component], self._stop_roots[component], rng)
        drawn[:, 2] += self.longer[a]
        return drawn

    def _bends(self, a: Indices, g: Indices, ways: DrawnWays, rng: Generator) -> Points:
        """Via points of people who do not stop; NaN for those who go straight."""
        along, left = draw_normal(self.bend_mean[a, g], self._bend_roots[a, g], rng).T
        way = ways[:, GOAL] - ways[:, START]
        length = np.maximum(np.hypot(*way.T), 1e-9)
        across = np.column_stack([-way[:, 1], way[:, 0]]) / length[:, None]
        via = ways[:, START] + along.clip(0.05, 0.95)[:, None] * way + left[:, None] * across
        return np.asarray(np.where(np.abs(left)[:, None] > OFF_M, via, np.nan))


def ranked(x: Numbers, ranks: Float[np.ndarray, "R 2"]) -> Numbers:
    """Numbers moved as the first column of `ranks` is to the second one.

    Linear in between; beyond the ends as far as before.
    """
    before, after = ranks.T
    beyond = np.minimum(x - before[0], 0) + np.maximum(x - before[-1], 0)
    return np.asarray(np.interp(x, before, after) + beyond)


def have_room(ways: DrawnWays, scene: Scene) -> tuple[Flags, Flags]:
    """Whether a person has room at start and goal, and at the via point if there is one."""
    with_via = np.flatnonzero(np.isfinite(ways[:, 5]))
    # One call, which takes hardly longer than each of three.
    points = np.concatenate([ways[:, START], ways[:, GOAL], ways[with_via, VIA]])
    starts, goals, there = np.split(scene.has_room(points), [len(ways), 2 * len(ways)])
    via = np.ones(len(ways), dtype=bool)
    via[with_via] = there
    return starts & goals, via
