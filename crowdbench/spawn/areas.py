"""Where people enter and where they walk to: Gaussian areas and the flows between them.

All spawn models of a scene share its areas. Source: the ICRA 2025 paper "Whenever, Wherever",
Sec. III-A, including DBSCAN; the treatment of noise points is different.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float, Float32
from msgspec import structs
from numpy.random import Generator

from crowdbench.data.table import Flags, Indices, Numbers, Points, Trajectories
from crowdbench.errors import SceneError, WeightsError
from crowdbench.files import read_struct, write_json
from crowdbench.scene import Clustering, Scene
from crowdbench.spawn import arrays
from crowdbench.spawn.drawing import choose, draw_normal
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.plans.mixtures import log_gaussians
from crowdbench.spawn.recorded_plans import cut_at_goals, plans_of

SCHEMA = 1
_FLOOR_M = 0.1  # minimum standard deviation of an area, because people are not points
_DRAWS = 1000
_QUANTILES = 101


@dataclass(frozen=True, eq=False)
class Gaussians:
    """`K` Gaussian areas."""

    mean: Float[np.ndarray, "K 2"]
    """Centres, metres."""
    covariance: Float[np.ndarray, "K 2 2"]
    """Square metres."""

    def __len__(self) -> int:
        return len(self.mean)

    def draw(self, area: Indices, scene: Scene, rng: Generator) -> Points:
        """One random point per area index; points outside the bounds or in a wall are redrawn.

        Raises:
            SceneError: an area has (almost) no walkable point.
        """
        root = np.linalg.cholesky(self.covariance)
        points = np.empty((len(area), 2))
        open_ = np.arange(len(area))
        for _ in range(_DRAWS):
            of = area[open_]
            points[open_] = draw_normal(self.mean[of], root[of], rng)
            open_ = open_[~scene.walkable(points[open_])]
            if len(open_) == 0:
                return points
        k = int(area[open_[0]])
        raise SceneError(
            scene.folder,
            got=f"an area around {self.mean[k].round(2).tolist()} m from which 1,000 consecutive "
            "draws lie outside the bounds or in a wall",
            expected="areas where people can walk",
            hint="Check the bounds and walls, or fit the scene again.",
        )

    def outline(self, area: int) -> Float[np.ndarray, "60 2"]:
        """The closed ellipse two standard deviations around an area's centre, metres."""
        root = np.linalg.cholesky(self.covariance[area])
        angle = np.linspace(0, 2 * np.pi, 60)
        circle = np.array([np.cos(angle), np.sin(angle)])
        return (self.mean[area][:, None] + 2 * root @ circle).T

    def likeliest(self, points: Points) -> Indices:
        """Index of the area whose Gaussian has the highest density at each point."""
        return log_gaussians(points, self.mean, self.covariance).argmax(axis=1)


@dataclass(frozen=True, eq=False)
class Areas:
    """Spawn areas, goal areas, the flows between them, and preferred speeds."""

    scene: str
    spawn: Gaussians
    goal: Gaussians
    flow: Float[np.ndarray, "K G"]
    """P(goal area | spawn area); rows sum to 1."""
    speed_quantiles: Float[np.ndarray, " 101"]
    """Quantiles 0, 1, …, 100 % of the persons' mean speeds outside their stops, m/s."""
    left_out: tuple[float, float]
    """Share of the starts, and of the ends, that belong to no area or only to the broad one."""

    def assign(self, crowd: Trajectories) -> Trajectories:
        """Assign the most likely areas to persons who have none; returns the new crowd.

        People who entered without a spawn area get one from their first position, people who left
        without a goal area get one from their last position.
        """
        spawn_area, goal_area = crowd.spawn_area.copy(), crowd.goal_area.copy()
        starts, ends = crowd.entered & (spawn_area < 0), crowd.left & (goal_area < 0)
        spawn_area[starts] = self.spawn.likeliest(crowd.start[starts].astype(np.float64))
        goal_area[ends] = self.goal.likeliest(crowd.end[ends].astype(np.float64))
        return replace(crowd, spawn_area=spawn_area, goal_area=goal_area)

    def instead(self, spawn: Gaussians, flow: Float[np.ndarray, "k G"]) -> "Areas":
        """Other spawn areas with the same goals and speeds."""
        return replace(self, spawn=spawn, flow=flow)

    def draw_goal_areas(self, spawn_area: Indices, rng: Generator) -> Indices:
        """Draw a goal area for each spawn area, from the flows."""
        return choose(self.flow.cumsum(axis=1)[spawn_area], rng)

    def draw(
        self, time_s: Numbers, spawn_area: Indices, scene: Scene, rng: Generator
    ) -> SpawnEvents:
        """Draw a start, a goal and a preferred speed for each arrival."""
        goal_area = self.draw_goal_areas(spawn_area, rng)
        quantile = rng.random(len(time_s)) * (_QUANTILES - 1)
        return entering(
            time_s=time_s,
            start=self.spawn.draw(spawn_area, scene, rng),
            goal=self.goal.draw(goal_area, scene, rng),
            spawn_area=spawn_area,
            goal_area=goal_area,
            speed=np.interp(quantile, np.arange(_QUANTILES), self.speed_quantiles),
        )


def fit_areas(
    crowd: Trajectories, scene: Scene, settings: Clustering
) -> tuple[Areas, Trajectories]:
    """Find the areas of a recording; returns them, and the recording as models and metrics use it.

    In the returned recording trips are cut off at their goals (see `cut_at_goals`), and areas are
    assigned. Starts of people who entered and ends of people who left are clustered by DBSCAN. A
    cluster with a standard deviation above `widest_m` is split by a Gaussian mixture, into as few
    parts as are needed. A Gaussian is fitted to the members of each cluster. With `keep_noise`, a
    point in no cluster then joins the cluster of the nearest member if that is within 2 ε. If at
    least `min_persons` points are further away, they form one broad area; otherwise they join the
    nearest cluster too. Noise points never affect the Gaussian of a cluster.

    Raises:
        SceneError: no cluster is found, or no person was seen to enter and to leave.
    """
    crowd = cut_at_goals(crowd, scene)
    spawn, spawn_area, starts_left_out = _cluster(
        crowd.start,
        crowd.entered,
        settings.spawn_eps_m,
        settings.spawn_min_persons,
        settings,
        scene,
    )
    goal, goal_area, ends_left_out = _cluster(
        crowd.goal, crowd.left, settings.goal_eps_m, settings.goal_min_persons, settings, scene
    )
    crowd = replace(crowd, spawn_area=spawn_area, goal_area=goal_area)

    flow = np.zeros((len(spawn), len(goal)))
    known, speed = (spawn_area >= 0) & (goal_area >= 0), plans_of(crowd).speed
    whole = known & np.isfinite(speed)
    if not whole.any():
        got = f"a recording of {len(crowd)} persons none of whom was seen to enter and to leave"
        expected = "complete trips to learn flows and speeds from"
        raise SceneError(scene.folder, got=got, expected=expected)
    np.add.at(flow, (spawn_area[known], goal_area[known]), 1.0)
    # If no trip from an area is complete, the goals of all people are used for it.
    everyone = flow.sum(axis=0)
    flow[flow.sum(axis=1) == 0] = everyone
    areas = Areas(
        scene=scene.id,
        spawn=spawn,
        goal=goal,
        flow=flow / flow.sum(axis=1, keepdims=True),
        speed_quantiles=np.percentile(
            np.minimum(speed[whole], scene.motion.max_speed_mps), np.linspace(0, 100, _QUANTILES)
        ),
        left_out=(starts_left_out, ends_left_out),
    )
    return areas, crowd


def _cluster(
    places: Float32[np.ndarray, "n 2"],
    known: Flags,
    eps_m: float,
    min_persons: int,
    settings: Clustering,
    scene: Scene,
) -> tuple[Gaussians, Indices, float]:
    """Areas of the known places, the area of each place (−1: none), and the share left out."""
    from sklearn.cluster import DBSCAN
    from sklearn.neighbors import NearestNeighbors

    points = places[known].astype(np.float64)
    label = np.empty(0, dtype=np.int64)
    if len(points):
        label = DBSCAN(eps=eps_m, min_samples=min_persons).fit_predict(points)
    if not (label >= 0).any():
        raise SceneError(
            scene.folder,
            got=f"no cluster among {len(points)} starts or ends with ε = {eps_m} m and at least "
            f"{min_persons} persons",
            expected="at least one cluster",
            hint="Increase eps_m or decrease min_persons in [clustering] of scene.toml.",
        )
    label = _split(points, label, settings.widest_m)
    clusters = [points[label == k] for k in range(label.max() + 1)]
    noise = np.flatnonzero(label < 0)
    left_out = len(noise) / len(points)
    if settings.keep_noise and len(noise):
        members = np.flatnonzero(label >= 0)
        tree = NearestNeighbors(n_neighbors=1).fit(points[members])
        gap, nearest = (x[:, 0] for x in tree.kneighbors(points[noise]))
        label[noise] = label[members][nearest]
        far = noise[gap > 2 * eps_m]
        left_out = 0.0
        if len(far) >= min_persons:
            label[far] = len(clusters)
            clusters.append(points[far])
            left_out = len(far) / len(points)
    area = np.full(len(places), -1, dtype=np.int32)
    area[known] = label
    mean = np.stack([cluster.mean(axis=0) for cluster in clusters])
    covariance = np.stack([np.cov(cluster.T, bias=True) for cluster in clusters])
    return Gaussians(mean, covariance + _FLOOR_M**2 * np.eye(2)), area, left_out


def _split(points: Points, label: Indices, widest_m: float) -> Indices:
    """The labels of the clusters, numbered anew, with those that are too wide split into parts."""
    from sklearn.mixture import GaussianMixture

    split = np.full(len(label), -1, dtype=np.int64)
    for k in range(label.max() + 1):
        inside = label == k
        of = points[inside]
        part, parts = np.zeros(len(of), dtype=np.int64), 1
        while max(_width(of[part == p]) for p in np.unique(part)) > widest_m:
            parts += 1
            mixture = GaussianMixture(parts, reg_covar=_FLOOR_M**2, n_init=3, random_state=0)
            part = mixture.fit_predict(of)
        split[inside] = split.max() + 1 + np.unique(part, return_inverse=True)[1]
    return split


def _width(points: Points) -> float:
    """Largest standard deviation of the points in any direction, metres."""
    return float(np.sqrt(np.linalg.eigvalsh(np.cov(points.T, bias=True))[-1]))


class _AreasFile(arrays.Fit, frozen=True):
    spawn_mean_m: Float[np.ndarray, "K 2"]
    spawn_covariance_m2: Float[np.ndarray, "K 2 2"]
    goal_mean_m: Float[np.ndarray, "G 2"]
    goal_covariance_m2: Float[np.ndarray, "G 2 2"]
    flow: Float[np.ndarray, "K G"]
    speed_quantiles_mps: Float[np.ndarray, " 101"]
    left_out: tuple[float, float]

    def rules(self, scene: Scene) -> list[arrays.Rule]:
        """Covariances are definite, there are areas, and flows and speeds are possible."""
        flow, ascends = self.flow, np.diff(self.speed_quantiles_mps, prepend=0) >= 0
        shares = flow.size > 0 and (flow >= 0).all() and np.allclose(flow.sum(axis=1), 1)
        return [
            ("spawn_covariance_m2", arrays.are_definite(self.spawn_covariance_m2), arrays.DEFINITE),
            ("goal_covariance_m2", arrays.are_definite(self.goal_covariance_m2), arrays.DEFINITE),
            ("flow", shares, "rows that sum to 1"),
            ("speed_quantiles_mps", ascends.all(), "ascending speeds"),
        ]


def write_areas(areas: Areas, path: Path) -> None:
    """Write the areas as JSON."""
    spawn, goal = areas.spawn, areas.goal
    parts = spawn.mean, spawn.covariance, goal.mean, goal.covariance, areas.flow
    file = _AreasFile(*parts, areas.speed_quantiles, areas.left_out)
    content = {"schema": SCHEMA, "scene": areas.scene, **structs.asdict(file)}
    write_json(path, msgspec.Raw(msgspec.json.encode(content, enc_hook=np.ndarray.tolist)))


def read_areas(scene: Scene) -> Areas:
    """The areas that a scene ships (`areas.json`).

    Raises:
        WeightsError: the file is missing, broken or inconsistent, or belongs to another scene.
    """
    path, how = scene.folder / "areas.json", arrays.hint(scene)
    raw = read_struct(path, dict, WeightsError, how)
    arrays.check_origin(raw, "areas", ["areas", scene.id, SCHEMA], path, how)
    file = arrays.checked(raw, _AreasFile, scene, {}, f"{path}, areas")
    spawn = Gaussians(file.spawn_mean_m, file.spawn_covariance_m2)
    goal = Gaussians(file.goal_mean_m, file.goal_covariance_m2)
    return Areas(scene.id, spawn, goal, file.flow, file.speed_quantiles_mps, file.left_out)
