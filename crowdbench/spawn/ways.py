"""Ways: where a person starts, by which point it walks, how long it waits there, and its goal.

A recorded trip is of one of three kinds: direct, by a via point without stopping (the point that is
furthest from the straight line, if that is more than 0.75 m), or with a stop. Each kind is a
mixture of Gaussians over (start, goal, log speed), with the via point and the logarithm of the wait
where the kind has them. The number of components is chosen by the Bayesian information criterion.
No component stands for fewer than ten people or is narrower than 0.3 m, so that nothing recorded
can be read from it.

The way of a person who enters area a is drawn from the components with the weights P(component | a)
of the recorded people who entered there. Trips whose end was not seen are left out, and the others
weighted by 1 / P(the end of such a trip is seen) (Robins and Rotnitzky 1992), because long trips
are cut off more often.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.errors import SceneError
from crowdbench.scene import Scene
from crowdbench.spawn.plans import SLOWEST_MPS, RecordedPlans
from crowdbench.trajectories.stops import LEAST_S
from crowdbench.trajectories.table import Trajectories

DIRECT, DETOUR, STOP = range(3)
SIZES = (5, 7, 8)
"""Number of dimensions of each kind."""
PLACES = (4, 6, 6)
"""Number of these that are coordinates: start, goal, via."""
OFF_M = 0.75
"""Distance from the straight line from which a trip is a detour."""
FEWEST = 10.0
NARROWEST_M = 0.3
_COMPONENTS = (1, 2, 3, 4, 6, 8, 11, 15, 20, 27, 36)
_DRAWS = 200
_PRIOR = 0.5
"""Persons of an average area that are added to each area."""


@dataclass(frozen=True, eq=False)
class Mixture:
    """The components of one kind: `C` Gaussians over `D` dimensions."""

    mean: Float[np.ndarray, "C D"]
    covariance: Float[np.ndarray, "C D D"]
    persons: Float[np.ndarray, "C K"]
    """Weight of the people of each area."""


@dataclass(frozen=True, eq=False)
class Ways:
    """The mixtures of the three kinds; kinds that nobody walked have no components."""

    kinds: tuple[Mixture, Mixture, Mixture]
    slowest_mps: float
    fastest_mps: float

    def draw(
        self, area: Int[np.ndarray, " n"], scene: Scene, rng: Generator
    ) -> tuple[Float[np.ndarray, "n 8"], Int[np.ndarray, " n"]]:
        """A way for each person, and its kind.

        The columns are start, goal, log speed, via and log wait; NaN for those that the kind does
        not have. Ways with a point outside the bounds or in a wall are drawn again.

        Raises:
            SceneError: no walkable way can be drawn.
        """
        kind = np.concatenate([np.full(len(m.mean), k) for k, m in enumerate(self.kinds)])
        within = np.concatenate([np.arange(len(m.mean)) for m in self.kinds])
        weight = np.concatenate([m.persons for m in self.kinds])
        cumulative = (weight / weight.sum(axis=0)).cumsum(axis=0).T
        roots = [np.linalg.cholesky(m.covariance) for m in self.kinds]
        found = np.full((len(area), 8), np.nan)
        found_kind = np.zeros(len(area), dtype=np.int64)
        open_ = np.arange(len(area))
        for _ in range(_DRAWS):
            u = rng.random((len(open_), 1)) * cumulative[area[open_], -1:]
            component = (u >= cumulative[area[open_]]).sum(axis=1)
            drawn = np.full((len(open_), 8), np.nan)
            for k, mixture in enumerate(self.kinds):
                mine = np.flatnonzero(kind[component] == k)
                c = within[component[mine]]
                noise = rng.standard_normal((len(mine), SIZES[k]))
                drawn[mine, : SIZES[k]] = mixture.mean[c] + np.einsum(
                    "nij,nj->ni", roots[k][c], noise
                )
            good = self._possible(drawn, scene)
            found[open_[good]] = drawn[good]
            found_kind[open_[good]] = kind[component[good]]
            open_ = open_[~good]
            if len(open_) == 0:
                return found, found_kind
        raise SceneError(
            scene.folder,
            got=f"{len(open_)} people for whom no way could be drawn in {_DRAWS} attempts",
            expected="ways whose starts, goals and via points lie inside the bounds, outside walls",
            hint="Check the bounds and walls, or fit the scene again.",
        )

    def _possible(self, drawn: Float[np.ndarray, "n 8"], scene: Scene) -> Bool[np.ndarray, " n"]:
        """Whether all points are walkable, and the speed is one of those recorded."""
        low, high = np.log(self.slowest_mps), np.log(self.fastest_mps)
        good = (drawn[:, 4] >= low) & (drawn[:, 4] <= high)
        for columns in (slice(0, 2), slice(2, 4)):
            good &= scene.walkable(drawn[:, columns])
        with_via = np.flatnonzero(np.isfinite(drawn[:, 5]))
        good[with_via] &= scene.walkable(drawn[with_via, 5:7])
        return np.asarray(good)


def fit_ways(
    crowd: Trajectories,
    plans: RecordedPlans,
    chosen: Bool[np.ndarray, " P"],
    areas: int,
    seed: int = 0,
) -> Ways:
    """Fit the mixtures to the chosen people of a recording, who have a spawn area.

    Raises:
        SceneError: none of them was seen to leave, or walks.
    """
    whole = chosen & crowd.left & np.isfinite(plans.speed)
    if not whole.any():
        raise SceneError(
            crowd.scene,
            got="a recording of people none of whom was seen to enter, walk and leave",
            expected="complete trips to learn ways from",
        )
    weight = seen_weights(crowd, chosen)[whole]
    features, kind = features_of(crowd, plans, np.flatnonzero(whole))
    area = crowd.spawn_area[whole].astype(np.int64)
    average = np.bincount(area, weight, minlength=areas)
    average /= average.sum()
    kinds = []
    for k, size in enumerate(SIZES):
        mine = kind == k
        kinds.append(
            _mixture(features[mine, :size], weight[mine], area[mine], areas, PLACES[k], seed)
        )
    total = sum(float(m.persons.sum()) for m in kinds)
    kinds = [
        Mixture(m.mean, m.covariance, m.persons + _PRIOR * m.persons.sum(1, keepdims=True) / total)
        for m in kinds
    ]
    speed = plans.speed[whole]
    fastest = max(float(speed.max()), 1.01 * SLOWEST_MPS)
    return Ways((kinds[0], kinds[1], kinds[2]), SLOWEST_MPS, fastest)


def features_of(
    crowd: Trajectories, plans: RecordedPlans, persons: Int[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "n 8"], Int[np.ndarray, " n"]]:
    """The way of each person, and its kind; the columns are those of `Ways.draw`."""
    start = crowd.start[persons].astype(np.float64)
    goal = crowd.goal[persons].astype(np.float64)
    via, wait_s = plans.via[persons], plans.wait_s[persons]
    stops = np.isfinite(via[:, 0])
    kind = np.where(stops, STOP, DIRECT)
    for k in np.flatnonzero(~stops).tolist():
        path = crowd.path(int(persons[k])).astype(np.float64)
        way = goal[k] - start[k]
        length = np.hypot(*way)
        off = path - start[k]
        across = np.abs(off[:, 0] * way[1] - off[:, 1] * way[0]) / max(length, 1e-9)
        if length < 1e-6:
            across = np.hypot(*off.T)
        furthest = int(np.argmax(across))
        if across[furthest] > OFF_M:
            kind[k], via[k] = DETOUR, path[furthest]
    wait = np.log(np.maximum(wait_s, LEAST_S))
    found = np.column_stack([start, goal, np.log(plans.speed[persons]), via, wait])
    found[kind != STOP, 7] = np.nan
    return found, kind


def seen_weights(crowd: Trajectories, chosen: Bool[np.ndarray, " P"]) -> Float[np.ndarray, " P"]:
    """1 / P(a trip as long as the person's is seen to its end), by Kaplan and Meier (1958)."""
    length = (crowd.last - crowd.first).astype(np.int64)
    times = np.unique(length[chosen])
    at_risk = np.array([(length[chosen] >= t).sum() for t in times])
    censored = np.array([(length[chosen & ~crowd.left] == t).sum() for t in times])
    survival = np.cumprod(1 - censored / np.maximum(at_risk, 1))
    before = np.concatenate([[1.0], survival])[np.searchsorted(times, length)]
    return np.asarray(1 / np.maximum(before, 0.1))


def _mixture(
    features: Float[np.ndarray, "n D"],
    weight: Float[np.ndarray, " n"],
    area: Int[np.ndarray, " n"],
    areas: int,
    places: int,
    seed: int,
) -> Mixture:
    """The mixture with the best criterion whose components all stand for enough people."""
    size = features.shape[1]
    if len(features) == 0 or weight.sum() < FEWEST:
        return Mixture(np.zeros((0, size)), np.zeros((0, size, size)), np.zeros((0, areas)))
    best: tuple[float, np.ndarray] | None = None
    for count in _components(len(features)):
        shares = _shares(features, count, seed)
        if count > 1 and (shares * weight[:, None]).sum(axis=0).min() < FEWEST:
            continue
        criterion = _criterion(features, shares)
        if best is not None and criterion > best[0] + 20.0:
            break  # larger mixtures are worse by now
        if best is None or criterion < best[0]:
            best = criterion, shares
    assert best is not None
    shares = best[1] * weight[:, None]
    mean, covariance = _moments(features, shares)
    covariance = np.stack([_widened(matrix, places) for matrix in covariance])
    persons = np.stack(
        [np.bincount(area, shares[:, c], minlength=areas) for c in range(shares.shape[1])]
    )
    return Mixture(mean, covariance, persons)


def _components(people: int) -> Sequence[int]:
    return [count for count in _COMPONENTS if count == 1 or people >= 2 * FEWEST * count]


def _shares(features: Float[np.ndarray, "n D"], count: int, seed: int) -> Float[np.ndarray, "n C"]:
    """Responsibility of each component for each person, by expectation maximisation."""
    from sklearn.mixture import GaussianMixture

    fitted = GaussianMixture(
        count, reg_covar=1e-3, max_iter=60, tol=1e-3, random_state=seed, init_params="k-means++"
    )
    return np.asarray(_quietly(fitted, features).predict_proba(features))


def _quietly(mixture: "object", features: Float[np.ndarray, "n D"]) -> "object":
    """Fit without the warning that 60 iterations were not enough; the criterion decides."""
    import warnings

    from sklearn.exceptions import ConvergenceWarning

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        return mixture.fit(features)  # type: ignore[attr-defined]


def _criterion(features: Float[np.ndarray, "n D"], shares: Float[np.ndarray, "n C"]) -> float:
    """The Bayesian information criterion (Schwarz 1978) of the mixture with these shares."""
    from scipy.special import logsumexp
    from scipy.stats import multivariate_normal

    (people, size), count = features.shape, shares.shape[1]
    mean, covariance = _moments(features, shares)
    share = shares.mean(axis=0)
    logs = np.stack(
        [
            np.log(share[c]) + multivariate_normal(mean[c], covariance[c]).logpdf(features)
            for c in range(count)
        ]
    )
    free = count * (1 + size + size * (size + 1) / 2) - 1
    return float(free * np.log(people) - 2 * logsumexp(logs, axis=0).sum())


def _moments(
    features: Float[np.ndarray, "n D"], shares: Float[np.ndarray, "n C"]
) -> tuple[Float[np.ndarray, "C D"], Float[np.ndarray, "C D D"]]:
    total = shares.sum(axis=0)
    mean = (shares.T @ features) / total[:, None]
    covariance = []
    for c in range(shares.shape[1]):
        off = features - mean[c]
        covariance.append((off * shares[:, c, None]).T @ off / total[c])
    return mean, np.stack(covariance) + 1e-3 * np.eye(features.shape[1])


def _widened(covariance: Float[np.ndarray, "D D"], places: int) -> Float[np.ndarray, "D D"]:
    """The covariance, with a standard deviation of at least 0.3 m in every direction of a place."""
    columns = _columns_of_places(covariance.shape[0], places)
    block = covariance[np.ix_(columns, columns)]
    value, vector = np.linalg.eigh(block)
    wide = (vector * np.maximum(value, NARROWEST_M**2)) @ vector.T
    found = covariance.copy()
    found[np.ix_(columns, columns)] = wide
    # Widening a block keeps the matrix positive definite: what is added is not negative.
    return found


def _columns_of_places(size: int, places: int) -> Int[np.ndarray, " places"]:
    """Columns with coordinates: start and goal, and via where there are six."""
    return np.array([0, 1, 2, 3] if places == 4 or size == SIZES[DIRECT] else [0, 1, 2, 3, 5, 6])
