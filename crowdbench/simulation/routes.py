"""Ways around walls: for walkers that know the plan of the place, and for observations.

Shortest paths among polygons turn at corners only: a graph joins the corners, moved off the walls
a little, that see each other (Lozano-Pérez & Wesley, Communications of the ACM 22, 1979).
"""

import math

import numpy as np
import shapely
from jaxtyping import Float, Int, Real
from numba import njit
from scipy.sparse.csgraph import dijkstra

from crowdbench.scene import Bounds, Scene, Wall

CLEARANCE_M = 0.2
"""How far ways keep off the corners of walls."""
_GRAZE_M = 0.05  # corners see each other past walls thicker by this, so that one near a corner does
_ROUNDING_M = 0.1

_GRAPHS: dict[tuple[tuple[Wall, ...], Bounds], tuple[np.ndarray, np.ndarray]] = {}


class Routes:
    """Where each person is to walk next so as to take the shortest way to its goal.

    Keeps what it found for a goal as long as the person in a slot is the same.
    """

    def __init__(
        self,
        segments: Float[np.ndarray, "S 4"],
        corners: Float[np.ndarray, "C 2"],
        between: Float[np.ndarray, "C C"],
    ) -> None:
        self._segments = segments
        self._corners = corners
        self._between = between
        self._person = np.empty((0, 0), dtype=np.int64)
        self._to_goal = np.empty((0, 0, len(corners)))

    @classmethod
    def on(cls, scene: Scene) -> "Routes":
        """Routes in a scene whose graph of corners, once drawn, is kept."""
        graph = _GRAPHS.get((scene.walls, scene.bounds))
        if graph is None:
            corners = _corners(scene)
            graph = _GRAPHS[scene.walls, scene.bounds] = (corners, _distances(corners, scene))
        return cls(scene.wall_segments, *graph)

    def next_of(
        self,
        world: Int[np.ndarray, " A"],
        slot: Int[np.ndarray, " A"],
        person: Int[np.ndarray, " A"],
        position: Real[np.ndarray, "A 2"],
        goal: Real[np.ndarray, "A 2"],
    ) -> tuple[Float[np.ndarray, "A 2"], Float[np.ndarray, " A"]]:
        """Where to walk next, metres, and how much of the way is left from there, metres.

        That is the goal, or where a wall hides it the next corner of the way there. A goal that
        cannot be reached is walked at straight.
        """
        target, beyond = goal.astype(np.float64), np.zeros(len(slot))
        if len(self._segments) and len(slot):
            self._make_room(int(world.max()) + 1, int(slot.max()) + 1)
            _next(
                world,
                slot,
                person.astype(np.int64),
                position.astype(np.float64),
                target,
                beyond,
                self._person,
                self._to_goal,
                self._segments,
                self._corners,
                self._between,
            )
        return target, beyond

    def _make_room(self, worlds: int, slots: int) -> None:
        known = self._person.shape
        if worlds <= known[0] and slots <= known[1]:
            return
        shape = (max(worlds, known[0]), max(2 * slots, known[1]))
        person = np.full(shape, -1, dtype=np.int64)
        person[: known[0], : known[1]] = self._person
        to_goal = np.full((*shape, len(self._corners)), np.inf)
        to_goal[: known[0], : known[1]] = self._to_goal
        self._person, self._to_goal = person, to_goal


def _corners(scene: Scene) -> Float[np.ndarray, "C 2"]:
    """Corners of the walls that ways can turn at, moved off by the clearance."""
    solid = scene.obstacles
    grown = solid.buffer(CLEARANCE_M, join_style="mitre", mitre_limit=2.0)
    # Rounding inwards must not bring corners to the walls.
    grown = grown.buffer(_ROUNDING_M, join_style="mitre").simplify(_ROUNDING_M / 2)
    found: list[tuple[float, float]] = []
    for part in shapely.get_parts(grown):
        if part.geom_type != "Polygon":
            continue
        part = shapely.orient_polygons(part)
        for ring in (part.exterior, *part.interiors):
            points = np.array(ring.coords)[:-1]
            along = points - np.roll(points, 1, axis=0)
            onward = np.roll(points, -1, axis=0) - points
            turns = along[:, 0] * onward[:, 1] - along[:, 1] * onward[:, 0]
            found += [tuple(p) for p in points[turns > 0]]  # the wall is on the left: convex
    corners = np.array(found).reshape(-1, 2)
    return corners[scene.walkable(corners)]


def _distances(corners: Float[np.ndarray, "C 2"], scene: Scene) -> Float[np.ndarray, "C C"]:
    """Lengths of the shortest ways between corners; infinite where there is none."""
    count = len(corners)
    if count == 0:
        return np.zeros((0, 0))
    solid = scene.obstacles.buffer(_GRAZE_M)
    shapely.prepare(solid)
    a, b = np.triu_indices(count, 1)
    lines = shapely.linestrings(np.stack([corners[a], corners[b]], axis=1))
    free = ~shapely.intersects(solid, lines)
    edges = np.zeros((count, count))  # of a dense graph, 0 is no edge
    edges[a[free], b[free]] = np.linalg.norm(corners[a[free]] - corners[b[free]], axis=1)
    return np.asarray(dijkstra(edges, directed=False))


@njit(cache=True, error_model="numpy")
def _next(world, slot, person, position, goal, beyond, known, to_goal, segments, corners, between):
    """Replace hidden goals by the next corner; `known` and `to_goal` keep the way to each goal."""
    for a in range(len(slot)):
        x, y = position[a, 0], position[a, 1]
        if not _hidden(x, y, goal[a, 0], goal[a, 1], segments):
            continue
        w, i = world[a], slot[a]
        if known[w, i] != person[a]:
            known[w, i] = person[a]
            _to_goal(goal[a, 0], goal[a, 1], segments, corners, between, to_goal[w, i])
        # The first corner in sight, in the order of the ways' lengths, is on the shortest.
        tried, last = -1.0, -1  # of two as long the first comes first
        while True:
            best, length = -1, np.inf
            for c in range(len(corners)):
                off = math.hypot(corners[c, 0] - x, corners[c, 1] - y)
                way = off + to_goal[w, i, c]
                later = way > tried or (way == tried and c > last)
                if off > _GRAZE_M and later and way < length:
                    best, length = c, way
            if best < 0:
                break
            if not _hidden(x, y, corners[best, 0], corners[best, 1], segments):
                goal[a, 0], goal[a, 1] = corners[best, 0], corners[best, 1]
                beyond[a] = to_goal[w, i, best]
                break
            tried, last = length, best


@njit(cache=True, error_model="numpy")
def _to_goal(x, y, segments, corners, between, result):
    """Length of the shortest way from each corner to (x, y)."""
    result[:] = np.inf
    for c in range(len(corners)):
        if not _hidden(x, y, corners[c, 0], corners[c, 1], segments):
            off = math.hypot(corners[c, 0] - x, corners[c, 1] - y)
            for d in range(len(corners)):
                result[d] = min(result[d], off + between[d, c])


@njit(cache=True, error_model="numpy")
def _hidden(x, y, to_x, to_y, segments):
    """Whether an edge of a wall crosses the line from (x, y) to (to_x, to_y)."""
    dx, dy = to_x - x, to_y - y
    for s in range(len(segments)):
        ax, ay = segments[s, 0] - x, segments[s, 1] - y
        bx, by = segments[s, 2] - x, segments[s, 3] - y
        # Its ends on different sides of the line, and the line's ends on different sides of it. Who
        # meets but a corner, or an edge end-on, is stopped by it too.
        side_a, side_b = dx * ay - dy * ax, dx * by - dy * bx
        if side_a * side_b <= 0.0:
            ex, ey = bx - ax, by - ay
            here = ay * ex - ax * ey
            there = here - (dy * ex - dx * ey)
            if here * there < 0.0:
                return True
    return False
