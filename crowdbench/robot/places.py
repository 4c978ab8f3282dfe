"""Where robots can drive: starts, goals, and paths that keep a robot's radius off walls."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int
from numpy.random import Generator, default_rng

from crowdbench.errors import SettingError
from crowdbench.robot.config import PERSON_TASKS, RobotConfig
from crowdbench.scene import Scene, Wall
from crowdbench.simulation.routes import Routes
from crowdbench.spawn.areas import read_areas

MARGIN_M = 0.05
"""Distance beyond a robot's radius that paths, starts and goals keep from walls."""
POINTS = 512
"""Number of points from which starts and goals are drawn."""
_DRAWS = 64
_RINGS_M = np.arange(0.5, 6.1, 0.5)
_DIRECTIONS = 16
_USABLE = 0.8  # share of the largest distance between points that may be asked for


class Places:
    """The free part of a scene for a robot of some radius, and the points that it drives between.

    Starts and goals are drawn uniformly from points in the areas of the scene: half of the points
    are distributed as people's starts, half as their goals, each area alike. All keep the robot's
    radius off walls and bounds. Starts and goals are `least_m` or more apart, in a straight line,
    and a way leads from each to the next.
    """

    def __init__(self, scene: Scene, radius_m: float, config: RobotConfig) -> None:
        """Compute the free part and the points.

        Raises:
            WeightsError: the areas of the scene are missing or broken.
            SettingError: there is no room for the robot in the areas, or at a given start or goal;
                or no places are as far from each other as asked for.
        """
        self.scene, self._off_m, self._config = scene, radius_m + MARGIN_M, config
        self.least_m = config.min_distance_m or 0.0
        b = scene.bounds
        whole = shapely.box(b.x_min_m, b.y_min_m, b.x_max_m, b.y_max_m)
        solid = scene.obstacles.buffer(self._off_m)
        free = whole.buffer(-radius_m, join_style="mitre").difference(solid)
        self._parts = [p for p in shapely.get_parts(free) if p.geom_type == "Polygon"]
        for part in self._parts:
            shapely.prepare(part)
        self.points, self._far = np.empty((0, 2)), list[np.ndarray]()
        """The points, and the indices of those that are far enough from each."""
        fixed = config.start is not None and config.goal is not None and config.goals == 1
        if not fixed and config.task not in PERSON_TASKS:  # a scene without areas will do otherwise
            self._spread(radius_m)
        self._first, self._before_goal = self._ends()

    def _spread(self, radius_m: float) -> None:
        """Choose the points."""
        scene, rng = self.scene, default_rng(0)
        areas = read_areas(scene)
        drawn = [
            kind.draw(rng.integers(len(kind), size=4 * POINTS), scene, rng)
            for kind in (areas.spawn, areas.goal)
        ]
        self.points = np.concatenate([p[self.part_of(p) >= 0][: POINTS // 2] for p in drawn])
        if len(self.points) < 2:
            raise SettingError(
                f"radius_m of a robot in {scene.id}",
                got=f"{radius_m:g}",
                expected="a robot for which there is room where people enter and leave",
            )
        part = self.part_of(self.points)
        apart = np.linalg.norm(self.points[:, None] - self.points, axis=2)
        apart = np.where(part[:, None] == part, apart, -1.0)
        self.least_m = self._checked_distance(float(apart.max()))
        self._far = [np.flatnonzero(row >= self.least_m) for row in apart]

    def part_of(self, points: Float[np.ndarray, "n 2"]) -> Int[np.ndarray, " n"]:
        """Index of the connected free part in which each point lies, −1 for none.

        A robot can drive between two points if they lie in the same part.
        """
        found = np.full(len(points), -1)
        for k, part in enumerate(self._parts):
            found[shapely.intersects_xy(part, points[:, 0], points[:, 1])] = k
        return found

    def around(self, point: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "n 2"]:
        """Free places within 6 m of a point that are connected, nearest first."""
        angle = 2 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
        directions = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rings = (point + _RINGS_M[:, None, None] * directions).reshape(-1, 2)
        places = np.vstack([point, rings])
        part = self.part_of(places)
        free = np.flatnonzero(part >= 0)
        return places[free[part[free] == part[free[0]]]] if len(free) else places[:0]

    def _checked_distance(self, longest_m: float) -> float:
        """The least distance between starts and goals, metres."""
        asked = self._config.min_distance_m
        least_m = longest_m / 2 if asked is None else asked
        if not 0 <= least_m <= _USABLE * longest_m:
            raise SettingError(
                "min_distance_m",
                got=repr(asked),
                expected=f"0 to {_USABLE * longest_m:.1f} metres in {self.scene.id}",
            )
        return least_m

    def _ends(self) -> tuple[Int[np.ndarray, " n"], Bool[np.ndarray, " points"]]:
        """Which points may come first, after a given start, and which before a given goal."""
        config, size = self._config, len(self.points)
        first = np.array([len(far) > 0 for far in self._far], bool)
        before_goal = np.ones(size, bool)
        for name in ("start", "goal"):
            chosen = getattr(config, name)
            if chosen is None:
                continue
            point = np.array([chosen], np.float64)
            part = int(self.part_of(point)[0])
            if part < 0:
                raise SettingError(
                    name,
                    got=str(tuple(chosen)),
                    expected=f"a point inside the bounds of {self.scene.id}, at least "
                    f"{self._off_m:g} m away from walls",
                )
            far = np.linalg.norm(self.points - point, axis=1) >= self.least_m
            far &= self.part_of(self.points) == part
            if len(self.points) and not far.any():
                raise SettingError(
                    name,
                    got=str(tuple(chosen)),
                    expected=f"a point to which there are others at a distance of "
                    f"{self.least_m:g} m",
                    hint="Choose another one, or a smaller min_distance_m.",
                )
            if name == "start":
                first = far
            else:
                before_goal = far
        given = [p for p in (config.start, config.goal) if p is not None]
        if len(given) == 2 and len(set(self.part_of(np.array(given, np.float64)).tolist())) == 2:
            raise SettingError(
                "goal",
                got=str(config.goal),
                expected=f"a point to which the robot can drive from {config.start}",
            )
        if config.goals == 1 and config.start is None:
            first &= before_goal
        return np.flatnonzero(first), before_goal

    def draw(
        self, rng: Generator, people: Float[np.ndarray, "P 2"], clearance_m: float
    ) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "goals 2"]]:
        """Draw a start and goals; those that are given in the settings are kept.

        The start is redrawn while somebody is within `clearance_m` of it, up to 64 times, after
        which the emptiest is taken.
        """
        widest, found = -np.inf, np.empty((0, 2))
        for _ in range(_DRAWS):
            way = self._way(rng)
            room = np.inf
            if len(people):
                room = float(((people - way[0]) ** 2).sum(axis=1).min())
            if room > widest:
                widest, found = room, way
            if room > clearance_m**2 or self._config.start is not None:
                break
        return found[0], found[1:]

    def _way(self, rng: Generator) -> Float[np.ndarray, "points 2"]:
        """A start and goals without regard to people."""
        start, goal, goals = self._config.start, self._config.goal, self._config.goals
        way = [] if start is None else [np.array(start, np.float64)]
        allowed = self._first
        while len(way) <= goals:
            if goal is not None and len(way) == goals:
                way.append(np.array(goal, np.float64))
                break
            if goal is not None and len(way) == goals - 1:
                far = allowed[self._before_goal[allowed]]
                allowed = far if len(far) else allowed
            drawn = allowed[rng.integers(len(allowed))]
            way.append(self.points[drawn])
            allowed = self._far[drawn]
        return np.array(way)


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
