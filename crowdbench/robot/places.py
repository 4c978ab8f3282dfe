"""Where robots can drive: starts, goals, and paths that keep a robot's radius off walls."""

from dataclasses import replace
from functools import cached_property, lru_cache

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy.random import Generator, default_rng

from crowdbench.errors import SettingError
from crowdbench.robot.config import RobotConfig
from crowdbench.scene import Scene, Wall
from crowdbench.simulation.routes import Routes
from crowdbench.spawn.areas import read_areas

MARGIN_M = 0.05
"""Distance beyond a robot's radius that paths, starts and goals keep from walls."""
POINTS = 512
"""Number of points from which starts and goals are drawn."""
_DRAWS = 64
_USABLE = 0.8  # share of the largest distance between points that may be asked for


class Places:
    """The free part of a scene for a robot of some radius, and the points that it drives between.

    Starts and goals are drawn uniformly among points in the spawn and goal areas of the scene: half
    of the points are normally distributed as people's starts, half as their goals. All keep the
    robot's radius off walls and bounds.
    """

    def __init__(self, scene: Scene, radius_m: float) -> None:
        """Compute the free part.

        Raises:
            WeightsError: the areas of the scene are missing or broken.
            SettingError: there is no room for the robot in the areas.
        """
        self.scene, self._off_m = scene, radius_m + MARGIN_M
        b = scene.bounds
        whole = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
        self._solid = scene.obstacles.buffer(self._off_m)
        free = whole.buffer(-radius_m, join_style="mitre").difference(self._solid)
        self._parts = [p for p in shapely.get_parts(free) if p.geom_type == "Polygon"]
        for part in self._parts:
            shapely.prepare(part)
        areas, rng = read_areas(scene), default_rng(0)
        drawn = [
            kind.draw(rng.integers(len(kind), size=4 * POINTS), scene, rng)
            for kind in (areas.spawn, areas.goal)
        ]
        inside = [points[self.part_of(points) >= 0][: POINTS // 2] for points in drawn]
        self.points = np.concatenate(inside)
        if len(self.points) < 2:
            raise SettingError(
                f"radius_m of a robot in {scene.id}",
                got=f"{radius_m:g}",
                expected="a robot for which there is room where people enter and leave",
            )

    def part_of(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Index of the connected free part in which each point lies, −1 for none.

        A robot can drive between two points if they lie in the same part.
        """
        found = np.full(len(points), -1)
        for k, part in enumerate(self._parts):
            found[shapely.intersects_xy(part, points[:, 0], points[:, 1])] = k
        return found

    def check(self, name: str, point: tuple[float, float]) -> None:
        """Check a start or goal that a user has chosen.

        Raises:
            SettingError: the robot has no room there.
        """
        if self.part_of(np.array([point], np.float64))[0] < 0:
            raise SettingError(
                name,
                got=str(tuple(point)),
                expected=f"a point inside the bounds of {self.scene.id}, at least "
                f"{self._off_m:g} m away from walls",
            )

    @cached_property
    def _apart(self) -> Float[np.ndarray, "n n"]:
        """Distances between points; −1 where no way leads from one to the other."""
        part = self.part_of(self.points)
        apart = np.linalg.norm(self.points[:, None] - self.points, axis=2)
        return np.where(part[:, None] == part, apart, -1.0)

    def least_m(self, config: RobotConfig) -> float:
        """The least distance between starts and goals in metres, checked with the given ones.

        Raises:
            SettingError: there are too few places that are as far from each other, or no way leads
                from the start to the goal.
        """
        longest_m = float(self._apart.max())
        least_m = config.min_distance_m
        if least_m is None:
            least_m = longest_m / 2
        if not 0 <= least_m <= _USABLE * longest_m:
            raise SettingError(
                "min_distance_m",
                got=repr(least_m),
                expected=f"0 to {_USABLE * longest_m:.1f} metres in {self.scene.id}",
            )
        given = [np.array(p, np.float64) for p in (config.start, config.goal) if p is not None]
        for point in given:
            if len(given) < 2 or config.goals > 1:
                self._far_from(point, least_m)
        if len(given) == 2 and len(set(self.part_of(np.array(given)).tolist())) == 2:
            raise SettingError(
                "goal",
                got=str(config.goal),
                expected=f"a point to which the robot can drive from {config.start}",
            )
        return least_m

    def draw(
        self,
        goals: int,
        min_distance_m: float,
        rng: Generator,
        people: Float[np.ndarray, "P 2"],
        clearance_m: float,
        start: tuple[float, float] | None,
        goal: tuple[float, float] | None,
    ) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "goals 2"]]:
        """Draw a start and one or several goals, each `min_distance_m` or more from the previous.

        The start is redrawn while somebody is within `clearance_m` of it, up to 64 times, after
        which the emptiest is taken. A given `start` or `goal` (then the last one) is kept.
        """
        best, found = -np.inf, (np.empty(2), np.empty((goals, 2)))
        for _ in range(_DRAWS):
            way = self._way(goals, min_distance_m, rng, start, goal)
            room = np.inf
            if len(people):
                room = float(np.linalg.norm(people - way[0], axis=1).min())
            if room > best:
                best, found = room, (way[0], way[1:])
            if room > clearance_m or start is not None:
                break
        return found

    def _way(
        self,
        goals: int,
        min_distance_m: float,
        rng: Generator,
        start: tuple[float, float] | None,
        goal: tuple[float, float] | None,
    ) -> Float[np.ndarray, "points 2"]:
        """A start and goals without regard to people."""
        ways = [] if start is None else [np.array(start, np.float64)]
        allowed: Bool[np.ndarray, " n"] = (self._apart >= min_distance_m).any(axis=1)
        if start is not None and (goal is None or goals > 1):
            allowed = self._far_from(ways[0], min_distance_m)
        while len(ways) <= goals:
            if goal is not None and len(ways) == goals:
                ways.append(np.array(goal, np.float64))
                break
            if goal is not None and len(ways) == goals - 1:
                far = allowed & self._far_from(np.array(goal, np.float64), min_distance_m)
                allowed = far if far.any() else allowed
            drawn = int(rng.choice(np.flatnonzero(allowed)))
            ways.append(self.points[drawn])
            allowed = self._apart[drawn] >= min_distance_m
        return np.stack(ways)

    def _far_from(
        self, point: Float[np.ndarray, " 2"], min_distance_m: float
    ) -> Bool[np.ndarray, " n"]:
        """Which points lie `min_distance_m` or more from a point, in the same part.

        Raises:
            SettingError: none does.
        """
        away = np.linalg.norm(self.points - point, axis=1) >= min_distance_m
        away &= self.part_of(self.points) == self.part_of(point[None])
        if not away.any():
            raise SettingError(
                "min_distance_m",
                got=f"{min_distance_m:g}",
                expected=f"a distance at which there are places around {point.round(2).tolist()}",
            )
        return away


@lru_cache(maxsize=16)
def _wide_walls(walls: tuple[Wall, ...], off_m: float) -> tuple[Wall, ...]:
    """Walls grown by `off_m`, joined where they overlap, as simple polygons."""
    solid = shapely.union_all([shapely.Polygon(wall.corners_m) for wall in walls])
    grown = solid.buffer(off_m, quad_segs=2)
    return tuple(
        Wall(name="", corners_m=tuple(tuple(p) for p in np.array(part.exterior.coords)[:-1]))
        for part in _without_holes(grown)
    )


def _without_holes(shape: shapely.Geometry) -> list[shapely.Geometry]:
    """Polygons without holes that cover the same area: those with holes are cut through them."""
    whole: list[shapely.Geometry] = []
    for part in shapely.get_parts(shape):
        if part.geom_type != "Polygon":
            continue
        if not len(part.interiors):
            whole.append(part)
            continue
        x = part.interiors[0].centroid.x
        left, low, right, top = part.bounds
        for half in (shapely.box(left, low, x, top), shapely.box(x, low, right, top)):
            whole += _without_holes(part.intersection(half))
    return whole


def routes_for(scene: Scene, radius_m: float) -> Routes:
    """Shortest paths in a scene for a robot of some radius.

    The walls are grown by the radius, so that a path for a point is one for the robot.
    """
    if not scene.walls:
        return Routes.on(scene)
    return Routes.on(replace(scene, walls=_wide_walls(scene.walls, radius_m + MARGIN_M)))
