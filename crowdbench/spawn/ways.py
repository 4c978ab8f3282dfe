"""Ways: from where to where a person walks, by which point, with which stop, and how fast.

Given the spawn area a and the goal area g, which is drawn from the flows of the scene:

- start, goal and log speed are Gaussian. The pairs (a, g) that ten people or more have walked have
  a Gaussian of their own, drawn towards the product of those of both areas with the weight of ten
  people. The others have that product.
- Those who do not stop have a *bend*: the point of their path that is furthest from the straight
  line from start to goal, as the fraction along it and the distance from it. Bends are Gaussian
  for each pair in the same way. A bend of more than 0.75 m becomes a via point.
- Those who stop do so in one of some common places: a mixture of Gaussians over the place and the
  logarithm of the wait, with the number of components chosen by the Bayesian information criterion.

No Gaussian stands for fewer than ten people, and none of places is narrower than 0.3 m, so that
nothing recorded can be read from it. Only trips whose end was seen are used. They are weighted by
1 / P(the end of a trip as long as this is seen) (Robins and Rotnitzky 1992), because long trips are
cut off more often.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.errors import SceneError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.plans import SLOWEST_MPS, RecordedPlans
from crowdbench.trajectories.stops import LEAST_S
from crowdbench.trajectories.table import Trajectories

WALK = 5
"""Dimensions of a trip: start, goal, log speed."""
BEND = 2
"""Dimensions of a bend: fraction along the straight line, metres to its left."""
STOP = 3
"""Dimensions of a stop: place, log wait."""
OFF_M = 0.75
"""Smallest bend that is a via point."""
FEWEST = 10.0
"""Least number of people of a Gaussian, and weight of what they have in common with others."""
NARROWEST_M = 0.3
_COMPONENTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36)
_DRAWS = 200
_FEW_STOPS = 0.5


@dataclass(frozen=True, eq=False)
class Ways:
    """Gaussians of the trips and bends of each pair of areas, and the places of stops."""

    trip_mean: Float[np.ndarray, "K G 5"]
    trip_covariance: Float[np.ndarray, "K G 5 5"]
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
        mean, covariance = _of_areas(areas, log_speed, np.ones(len(log_speed)))
        shape, count = (len(areas.spawn), len(areas.goal)), len(self.stop_mean)
        bend_mean = self.bend_mean.mean(axis=0), self.bend_covariance.mean(axis=0)
        return replace(
            self,
            trip_mean=mean,
            trip_covariance=covariance,
            bend_mean=np.broadcast_to(bend_mean[0], (*shape, BEND)),
            bend_covariance=np.broadcast_to(bend_mean[1], (*shape, BEND, BEND)),
            stopping=np.zeros(shape),
            from_area=np.ones((count, shape[0])),
            longer=np.zeros(shape[0]),
        )

    def draw(
        self,
        spawn_area: Int[np.ndarray, " n"],
        goal_area: Int[np.ndarray, " n"],
        scene: Scene,
        rng: Generator,
    ) -> Float[np.ndarray, "n 8"]:
        """A way for each person: start, goal, log speed, via, and log wait.

        Via is NaN for those who go straight, log wait for those who do not stop. Ways with a point
        outside the bounds or in a wall are drawn again.

        Raises:
            SceneError: no walkable way can be drawn.
        """
        found = np.full((len(spawn_area), 8), np.nan)
        trips = np.linalg.cholesky(self.trip_covariance)
        open_ = np.arange(len(found))
        for _ in range(_DRAWS):
            a, g = spawn_area[open_], goal_area[open_]
            drawn = np.full((len(open_), 8), np.nan)
            noise = rng.standard_normal((len(open_), WALK))
            drawn[:, :WALK] = self.trip_mean[a, g] + np.einsum("nij,nj->ni", trips[a, g], noise)
            stops = rng.random(len(open_)) < self.stopping[a, g]
            drawn[stops, 5:] = self._stops(a[stops], g[stops], rng)
            drawn[~stops, 5:7] = self._bends(a[~stops], g[~stops], drawn[~stops, :4], rng)
            good = self._possible(drawn, scene)
            found[open_[good]] = drawn[good]
            open_ = open_[~good]
            if len(open_) == 0:
                return found
        raise SceneError(
            scene.folder,
            got=f"{len(open_)} people for whom no way could be drawn in {_DRAWS} attempts",
            expected="ways whose starts, goals and via points lie inside the bounds, outside walls",
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
        root = np.linalg.cholesky(self.stop_covariance)[component]
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
        root = np.linalg.cholesky(self.bend_covariance)[a, g]
        noise = rng.standard_normal((len(a), BEND))
        along, left = (self.bend_mean[a, g] + np.einsum("nij,nj->ni", root, noise)).T
        way = ends[:, 2:] - ends[:, :2]
        length = np.maximum(np.hypot(*way.T), 1e-9)
        across = np.column_stack([-way[:, 1], way[:, 0]]) / length[:, None]
        via = ends[:, :2] + along.clip(0.05, 0.95)[:, None] * way + left[:, None] * across
        return np.asarray(np.where(np.abs(left)[:, None] > OFF_M, via, np.nan))

    def _possible(self, drawn: Float[np.ndarray, "n 8"], scene: Scene) -> Bool[np.ndarray, " n"]:
        """Whether all points are walkable, and the speed is one of those recorded."""
        low, high = np.log(SLOWEST_MPS), np.log(self.fastest_mps)
        good = (drawn[:, 4] >= low) & (drawn[:, 4] <= high)
        for columns in (slice(0, 2), slice(2, 4)):
            good &= scene.walkable(drawn[:, columns])
        with_via = np.flatnonzero(np.isfinite(drawn[:, 5]))
        good[with_via] &= scene.walkable(drawn[with_via, 5:7])
        return np.asarray(good)


def fit_ways(
    crowd: Trajectories,
    plans: RecordedPlans,
    areas: Areas,
    chosen: Bool[np.ndarray, " P"],
    seed: int = 0,
) -> Ways:
    """Fit the ways of the chosen people of a recording, which has areas.

    Raises:
        SceneError: none of them was seen to enter, walk and leave.
    """
    known = (crowd.spawn_area >= 0) & (crowd.goal_area >= 0)
    whole = np.flatnonzero(chosen & known & crowd.left & np.isfinite(plans.speed))
    if len(whole) == 0:
        raise SceneError(
            crowd.scene,
            got="a recording of people none of whom was seen to enter, walk and leave",
            expected="complete trips to learn ways from",
        )
    weight = seen_weights(crowd, chosen)[whole]
    a = crowd.spawn_area[whole].astype(np.int64)
    g = crowd.goal_area[whole].astype(np.int64)
    trip = np.column_stack([crowd.start[whole], crowd.goal[whole], np.log(plans.speed[whole])])
    stops = np.isfinite(plans.via[whole, 0])
    bend = bends_of(crowd, whole)
    shape = (len(areas.spawn), len(areas.goal))
    trip_mean, trip_covariance = _pairs(trip, weight, a, g, *_of_areas(areas, trip[:, 4], weight))
    straight = ~stops
    common = np.zeros((*shape, BEND)), np.broadcast_to(np.diag([0.04, 0.25]), (*shape, BEND, BEND))
    if weight[straight].sum() >= FEWEST:
        mean, covariance = moments(bend[straight], weight[straight])
        common = (
            np.broadcast_to(mean, (*shape, BEND)),
            np.broadcast_to(covariance, (*shape, BEND, BEND)),
        )
    bend_mean, bend_covariance = _pairs(
        bend[straight], weight[straight], a[straight], g[straight], *common
    )
    stop = np.column_stack([plans.via[whole], np.log(np.maximum(plans.wait_s[whole], LEAST_S))])
    places = _places(stop[stops], weight[stops], a[stops], g[stops], shape, seed)
    for place in (slice(0, 2), slice(2, 4)):
        trip_covariance = _widened(trip_covariance, place)
    return Ways(
        trip_mean,
        trip_covariance,
        bend_mean,
        bend_covariance,
        _stopping(stops, weight, a, g, shape) * (len(places[0]) > 0),
        *places,
        longer=np.zeros(shape[0]),
        fastest_mps=max(float(plans.speed[whole].max()), 1.01 * SLOWEST_MPS),
    )


def bends_of(crowd: Trajectories, persons: Int[np.ndarray, " n"]) -> Float[np.ndarray, "n 2"]:
    """Fraction along the straight line, and metres to its left, of the furthest point of paths."""
    found = np.zeros((len(persons), BEND))
    for k, person in enumerate(persons.tolist()):
        path = crowd.path(person).astype(np.float64)
        way = crowd.goal[person] - path[0]
        length = np.hypot(*way)
        if length < OFF_M:
            continue
        off = path - path[0]
        along = (off @ way) / length**2
        left = (off[:, 1] * way[0] - off[:, 0] * way[1]) / length
        furthest = int(np.argmax(np.abs(left)))
        found[k] = np.clip(along[furthest], 0.05, 0.95), left[furthest]
    return found


def seen_weights(crowd: Trajectories, chosen: Bool[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
    """1 / P(a trip as long as the person's is seen to its end), by Kaplan and Meier (1958)."""
    length = (crowd.last - crowd.first).astype(np.int64)
    times, at = np.unique(length, return_inverse=True)
    trips = np.bincount(at[chosen], minlength=len(times))
    cut = np.bincount(at[chosen & ~crowd.left], minlength=len(times))
    at_risk = trips[::-1].cumsum()[::-1]
    survival = np.cumprod(1 - cut / np.maximum(at_risk, 1))
    before = np.concatenate([[1.0], survival[:-1]])
    return np.asarray(1 / np.maximum(before[at], 0.1))


def moments(
    x: Float[np.ndarray, "n D"], weight: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, " D"], Float[np.ndarray, "D D"]]:
    """Weighted mean and covariance."""
    mean = weight @ x / weight.sum()
    off = x - mean
    return mean, (off * weight[:, None]).T @ off / weight.sum()


def _of_areas(
    areas: Areas, log_speed: Float[np.ndarray, " n"], weight: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "K G 5"], Float[np.ndarray, "K G 5 5"]]:
    """Trips between areas whose starts, goals and speeds do not depend on each other."""
    shape = (len(areas.spawn), len(areas.goal))
    mean = np.zeros((*shape, WALK))
    covariance = np.zeros((*shape, WALK, WALK))
    mean[..., :2], mean[..., 2:4] = areas.spawn.mean[:, None], areas.goal.mean[None]
    covariance[..., :2, :2] = areas.spawn.covariance[:, None]
    covariance[..., 2:4, 2:4] = areas.goal.covariance[None]
    of_speed, spread = moments(log_speed[:, None], weight)
    mean[..., 4], covariance[..., 4, 4] = of_speed[0], max(float(spread[0, 0]), 1e-4)
    return mean, covariance


def _pairs(
    x: Float[np.ndarray, "n D"],
    weight: Float[np.ndarray, " n"],
    a: Int[np.ndarray, " n"],
    g: Int[np.ndarray, " n"],
    mean: Float[np.ndarray, "K G D"],
    covariance: Float[np.ndarray, "K G D D"],
) -> tuple[Float[np.ndarray, "K G D"], Float[np.ndarray, "K G D D"]]:
    """Gaussians of the pairs that enough people walked, drawn towards the given ones."""
    mean, covariance = mean.copy(), covariance.copy()
    for pair in np.unique(np.stack([a, g], axis=1), axis=0):
        mine = (a == pair[0]) & (g == pair[1])
        total = weight[mine].sum()
        if mine.sum() < FEWEST:
            continue
        at = tuple(pair)
        own, spread = moments(x[mine], weight[mine])
        share = total / (total + FEWEST)
        off = own - mean[at]
        # Covariance of the people and of as many as FEWEST others together.
        covariance[at] = (
            share * spread + (1 - share) * covariance[at] + share * (1 - share) * np.outer(off, off)
        )
        mean[at] = share * own + (1 - share) * mean[at]
    return mean, covariance + 1e-6 * np.eye(x.shape[1])


def _stopping(
    stops: Bool[np.ndarray, " n"],
    weight: Float[np.ndarray, " n"],
    a: Int[np.ndarray, " n"],
    g: Int[np.ndarray, " n"],
    shape: tuple[int, int],
) -> Float[np.ndarray, "K G"]:
    """Share of people who stop, drawn towards that of the spawn area, and this to that of all."""
    overall = weight[stops].sum() / weight.sum()
    of_area = np.bincount(a, weight, minlength=shape[0])
    stop_area = np.bincount(a[stops], weight[stops], minlength=shape[0])
    area = (stop_area + FEWEST * overall) / (of_area + FEWEST)
    both, stop_both = np.zeros(shape), np.zeros(shape)
    np.add.at(both, (a, g), weight)
    np.add.at(stop_both, (a[stops], g[stops]), weight[stops])
    return np.asarray((stop_both + FEWEST * area[:, None]) / (both + FEWEST))


def _places(
    x: Float[np.ndarray, "n 3"],
    weight: Float[np.ndarray, " n"],
    a: Int[np.ndarray, " n"],
    g: Int[np.ndarray, " n"],
    shape: tuple[int, int],
    seed: int,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """The mixture of stops: means, covariances, and weights by spawn and by goal area."""
    if len(x) < FEWEST:
        none = np.zeros((0, STOP)), np.zeros((0, STOP, STOP))
        return *none, np.zeros((0, shape[0])), np.zeros((0, shape[1]))
    shares = _shares(x, seed) * weight[:, None]
    fitted = [moments(x, shares[:, c]) for c in range(shares.shape[1])]
    total = shares.sum(axis=0)[:, None] / shares.sum()
    of_spawn = np.stack([np.bincount(a, s, minlength=shape[0]) for s in shares.T])
    of_goal = np.stack([np.bincount(g, s, minlength=shape[1]) for s in shares.T])
    # P(c | a, g) ∝ P(c) P(a | c) P(g | c), each drawn towards what does not depend on c.
    from_area = of_spawn + FEWEST * total * of_spawn.sum(axis=0).clip(_FEW_STOPS) / len(x)
    to_area = of_goal + FEWEST * total * of_goal.sum(axis=0).clip(_FEW_STOPS) / len(x)
    return (
        np.stack([mean for mean, _ in fitted]),
        _widened(np.stack([covariance for _, covariance in fitted]), slice(0, 2)),
        from_area,
        to_area / to_area.sum(axis=1, keepdims=True),
    )


def _shares(x: Float[np.ndarray, "n D"], seed: int) -> Float[np.ndarray, "n C"]:
    """Responsibilities of the best mixture whose components all stand for enough people."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning
    from sklearn.mixture import GaussianMixture

    best: tuple[float, np.ndarray] = np.inf, np.ones((len(x), 1))
    for count in _COMPONENTS:
        if count > 1 and len(x) < 2 * FEWEST * count:
            break
        mixture = GaussianMixture(
            count, reg_covar=1e-2, max_iter=60, random_state=seed, init_params="k-means++"
        )
        with warnings.catch_warnings():  # the criterion decides, whether it converged or not
            warnings.simplefilter("ignore", ConvergenceWarning)
            shares = mixture.fit(x).predict_proba(x)
        criterion = mixture.bic(x)
        if shares.sum(axis=0).min() >= FEWEST and criterion < best[0]:
            best = criterion, shares
    return best[1]


def _widened(covariance: Float[np.ndarray, "*pairs D D"], place: slice) -> np.ndarray:
    """Covariances with a standard deviation of at least 0.3 m in each direction of a place."""
    found = covariance + 1e-6 * np.eye(covariance.shape[-1])
    value, vector = np.linalg.eigh(found[..., place, place])
    wide = np.maximum(value, NARROWEST_M**2)
    found[..., place, place] = (vector * wide[..., None, :]) @ vector.swapaxes(-1, -2)
    return np.asarray(found)
