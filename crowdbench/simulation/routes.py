"""Ways around walls: for walkers that know the plan of the place, and for observations.

Shortest paths among polygons turn at corners only: a graph joins the corners, moved off the walls
a little, that see each other (Lozano-Pérez & Wesley, Communications of the ACM 22, 1979).
"""

import math
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int, Real
from numba import njit
from scipy.sparse.csgraph import dijkstra

from crowdbench.scene import Bounds, Scene, Wall
from crowdbench.simulation.rules import distance_to_segment
from crowdbench.simulation.walls import CELL_M, cell_of, walls_near

CLEARANCE_M = 0.2
"""How far ways keep off the corners of walls."""
_GRAZE_M = 0.05  # corners see each other past walls thicker by this, so that one near a corner does
_ROUNDING_M = 0.1
MARGIN_M = 1.0
NEAR_M = 1.0
ROOM_M = 0.25
"""Lines of sight that are no further apart, and so far from all walls, are free alike."""
_ROUNDED_M = 1e-6  # far above what lengths are rounded by

_GRAPHS: dict[tuple[tuple[Wall, ...], Bounds], "tuple[np.ndarray, np.ndarray, Sight]"] = {}


class Sight(NamedTuple):
    """What lines of sight are looked up by: the walls near each cell of a grid; `C` cells."""

    segments: np.ndarray
    """(S, 4) float64: x0, y0, x1, y1 in metres."""
    origin: np.ndarray
    """(2,) float64: lower left corner of the grid, `MARGIN_M` or more from all walls."""
    columns: int
    rows: int
    start: np.ndarray
    """(C + 1,) int32: the segments near cell c are `near[start[c]:start[c + 1]]`."""
    near: np.ndarray
    free: np.ndarray
    """(C,) float64: no other segment is nearer than that to any point of the cell, metres."""
    blockers: np.ndarray
    """(C, corners) int32: the segment that last hid a corner from a point in the cell, or −1."""

    @classmethod
    def past(cls, segments: Float[np.ndarray, "S 4"], corners: int) -> "Sight":
        """The tables for these walls."""
        ends = segments.reshape(-1, 2)
        lower = ends.min(axis=0, initial=0.0 if len(ends) == 0 else np.inf) - MARGIN_M
        upper = ends.max(axis=0, initial=0.0 if len(ends) == 0 else -np.inf) + MARGIN_M
        columns, rows = (int(np.ceil(extent / CELL_M)) for extent in upper - lower)
        start, near, free, _ = walls_near(segments, lower, columns, rows, NEAR_M)
        blockers = np.full((columns * rows, corners), -1, np.int32)
        return cls(segments, lower, columns, rows, start, near, free, blockers)


class Routes:
    """Where each person is to walk next so as to take the shortest way to its goal.

    Keeps what it found for a goal as long as the person in a slot is the same.
    """

    def __init__(
        self,
        segments: Float[np.ndarray, "S 4"],
        corners: Float[np.ndarray, "C 2"],
        between: Float[np.ndarray, "C C"],
        sight: Sight | None = None,
    ) -> None:
        self._corners = corners
        self._between = between
        self._sight = sight or Sight.past(segments, len(corners))
        self._known = np.empty((0, 0, 3), dtype=np.int64)
        self._seen = np.empty((0, 0, 5))
        self._to_goal = np.empty((0, 0, len(corners)))

    @classmethod
    def on(cls, scene: Scene) -> "Routes":
        """Routes in a scene whose graph of corners, once drawn, is kept."""
        graph = _GRAPHS.get((scene.walls, scene.bounds))
        if graph is None:
            corners = _corners(scene)
            sight = Sight.past(scene.wall_segments, len(corners))
            graph = _GRAPHS[scene.walls, scene.bounds] = (
                corners, _distances(corners, scene), sight,
            )  # fmt: skip
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
        if len(self._sight.segments) and len(slot):
            self._make_room(int(world.max()) + 1, int(slot.max()) + 1)
            _next(
                world,
                slot,
                person.astype(np.int64),
                position.astype(np.float64),
                target,
                beyond,
                self._known,
                self._seen,
                self._to_goal,
                self._corners,
                self._between,
                self._sight,
            )
        return target, beyond

    def _make_room(self, worlds: int, slots: int) -> None:
        known = self._known.shape
        if worlds <= known[0] and slots <= known[1]:
            return
        shape = (max(worlds, known[0]), max(2 * slots, known[1]))
        person = np.full((*shape, 3), -1, dtype=np.int64)
        person[: known[0], : known[1]] = self._known
        seen = np.full((*shape, 5), np.nan)
        seen[: known[0], : known[1]] = self._seen
        to_goal = np.full((*shape, len(self._corners)), np.inf)
        to_goal[: known[0], : known[1]] = self._to_goal
        self._known, self._seen, self._to_goal = person, seen, to_goal


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
def _next(
    world, slot, person, position, goal, beyond, known, seen, to_goal, corners, between, sight
):
    """Replace hidden goals by the next corner, and say how far it is from there.

    What was found is kept for the next step: in `known` the person, the wall that hides its goal
    and its next corner, in `to_goal` its ways, and in `seen` its line of sight, see `_blocker`.
    """
    count = len(corners)
    corner_x, corner_y = corners[:, 0].copy(), corners[:, 1].copy()
    ways, tried, blockers = np.empty(count), np.empty(count, np.int64), sight.blockers
    for a in range(len(slot)):
        x, y = position[a, 0], position[a, 1]
        w, i = world[a], slot[a]
        room = seen[w, i]
        if _still_in_sight(x, y, goal[a, 0], goal[a, 1], room):
            continue
        wall = _blocker(x, y, goal[a, 0], goal[a, 1], known[w, i, 1], sight, room)
        if wall < 0:
            continue
        known[w, i, 1] = wall
        own = to_goal[w, i]
        if known[w, i, 0] != person[a]:
            known[w, i, 0], known[w, i, 2] = person[a], -1
            _to_goal(goal[a, 0], goal[a, 1], corners, between, sight, own)
        cell = _cell(x, y, sight)
        # Most often it is the corner of the step before, or one whose way has become shorter.
        last, limit = known[w, i, 2], np.inf
        if last >= 0:
            to_x, to_y = corners[last, 0], corners[last, 1]
            off = math.hypot(to_x - x, to_y - y)
            if off > _GRAZE_M and (
                _still_in_sight(x, y, to_x, to_y, room)
                or _blocker(x, y, to_x, to_y, -1, sight, room) < 0
            ):
                limit = off + own[last]
        for c in range(count):
            dx, dy = corner_x[c] - x, corner_y[c] - y
            ways[c] = math.sqrt(dx * dx + dy * dy) + own[c]
        few = 0
        for c in range(count):
            if ways[c] <= limit + _ROUNDED_M and ways[c] < np.inf:
                off = math.hypot(corner_x[c] - x, corner_y[c] - y)
                if off > _GRAZE_M:
                    tried[few], ways[few] = c, off + own[c]
                    few += 1
        # The first corner in sight, in the order of the ways' lengths, is on the shortest: of two
        # as long, the first.
        known[w, i, 2] = -1
        for _ in range(few):
            k = ways[:few].argmin()
            best = tried[k]
            wall = -1
            if best != last or limit == np.inf:
                to_x, to_y = corner_x[best], corner_y[best]
                wall = _blocker(x, y, to_x, to_y, blockers[cell, best], sight, room)
            if wall < 0:
                goal[a, 0], goal[a, 1] = corner_x[best], corner_y[best]
                beyond[a] = own[best]
                known[w, i, 2] = best
                break
            blockers[cell, best] = wall
            ways[k] = np.inf


@njit(cache=True, error_model="numpy")
def _to_goal(x, y, corners, between, sight, result):
    """Length of the shortest way from each corner to (x, y)."""
    result[:] = np.inf
    cell, blockers, room = _cell(x, y, sight), sight.blockers, np.empty(5)
    for c in range(len(corners)):
        wall = _blocker(x, y, corners[c, 0], corners[c, 1], blockers[cell, c], sight, room)
        if wall < 0:
            off = math.hypot(corners[c, 0] - x, corners[c, 1] - y)
            for d in range(len(corners)):
                result[d] = min(result[d], off + between[d, c])
        else:
            blockers[cell, c] = wall


@njit(error_model="numpy")
def _cell(x, y, sight):
    return cell_of(x, y, (sight.origin[0], sight.origin[1], CELL_M, sight.columns, sight.rows))


@njit(error_model="numpy")
def _still_in_sight(x, y, to_x, to_y, room):
    """Whether a line from (x, y) keeps within the room around an earlier one to the same place."""
    if room[2] != to_x or room[3] != to_y:
        return False
    return distance_to_segment(x, y, room[0], room[1], to_x, to_y) < room[4]


@njit(error_model="numpy")
def _blocker(x, y, to_x, to_y, guess, sight, room):
    """An edge of a wall that crosses the line from (x, y) to (to_x, to_y), −1 if there is none.

    Looks at `guess` first, then goes along the line, and in each cell that it comes to looks at
    the edges near that cell: no other is met before the next one. If there is none, the ends of
    the line and its distance from all walls, `ROOM_M` at most, go into `room`.
    """
    segments = sight.segments
    if guess >= 0 and _crosses(x, y, to_x, to_y, segments[guess]):
        return guess
    dx, dy = to_x - x, to_y - y
    length = math.sqrt(dx * dx + dy * dy)
    left, low = sight.origin[0], sight.origin[1]
    right, top = left + sight.columns * CELL_M, low + sight.rows * CELL_M
    at, wide = 0.0, ROOM_M
    while at <= length:
        along = at / length if length > 0.0 else 0.0
        px, py = x + along * dx, y + along * dy
        off = max(max(left - px, px - right), max(low - py, py - top))
        if off > 0.0:
            at += off + MARGIN_M - ROOM_M  # outside the grid, which reaches so far beyond all walls
            continue
        cell = _cell(px, py, sight)
        for k in range(sight.start[cell], sight.start[cell + 1]):
            wall = segments[sight.near[k]]
            if _crosses(x, y, to_x, to_y, wall):
                return sight.near[k]
            wide = min(wide, _apart(x, y, to_x, to_y, wall[0], wall[1], wall[2], wall[3]))
        at += sight.free[cell] - ROOM_M
    room[0], room[1], room[2], room[3] = x, y, to_x, to_y
    room[4] = wide - _ROUNDED_M
    return -1


@njit(error_model="numpy")
def _apart(ax, ay, bx, by, cx, cy, dx, dy):
    """Distance of the segments a–b and c–d that do not cross."""
    one = min(distance_to_segment(ax, ay, cx, cy, dx, dy),
              distance_to_segment(bx, by, cx, cy, dx, dy))  # fmt: skip
    other = min(distance_to_segment(cx, cy, ax, ay, bx, by),
                distance_to_segment(dx, dy, ax, ay, bx, by))  # fmt: skip
    return min(one, other)


@njit(error_model="numpy")
def _crosses(x, y, to_x, to_y, segment):
    """Whether an edge of a wall crosses the line from (x, y) to (to_x, to_y)."""
    dx, dy = to_x - x, to_y - y
    ax, ay = segment[0] - x, segment[1] - y
    bx, by = segment[2] - x, segment[3] - y
    # Its ends on different sides of the line, and the line's ends on different sides of it. Who
    # meets but a corner, or an edge end-on, is stopped by it too.
    side_a, side_b = dx * ay - dy * ax, dx * by - dy * bx
    if side_a * side_b <= 0.0:
        ex, ey = bx - ax, by - ay
        here = ay * ex - ax * ey
        there = here - (dy * ex - dx * ey)
        return here * there < 0.0
    return False
