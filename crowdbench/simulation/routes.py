"""Shortest paths around walls, for walkers with a map of the scene and for observations.

Shortest paths among polygons turn only at corners. The visibility graph connects all pairs of
corners, moved slightly away from the walls, that are in sight of each other (Lozano-Pérez & Wesley,
Communications of the ACM 22, 1979).
"""

import math
from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int, Real
from numba import prange

from crowdbench.compilation import Kernel, compiled, subroutine
from crowdbench.scene import Bounds, Scene, Wall
from crowdbench.simulation.rules import crosses, distance_to_segment, segments_apart
from crowdbench.simulation.walls import CELL_M, cell_of, walls_near

CORNER_M = 0.2
"""Distance of paths from the corners of walls."""
_GRAZE_M = 0.05  # walls are thicker by this between corners, so that people near one see the next
_ROUNDING_M = 0.1
MARGIN_M = 1.0
"""Least distance between the walls and the border of the grid."""
NEAR_M = 1.0
"""Distance from a cell up to which walls are listed for it."""
ROOM_M = 0.25
"""Greatest width of the free corridor that is stored around a line of sight."""
CHUNK = 16
"""Number of persons whose ways a thread looks up before it takes the next ones."""
MOST_GUESSES = 2**22
"""Number of remembered walls, of 16 MB. Larger scenes remember them for larger cells."""
_ROUNDED_M = 1e-6  # tolerance, far above the rounding of lengths

_GRAPHS: dict[tuple[tuple[Wall, ...], Bounds], "tuple[np.ndarray, np.ndarray, Sight]"] = {}


class Sight(NamedTuple):
    """Look-up tables for lines of sight: the walls near each of the `C` cells of a grid."""

    segments: np.ndarray
    """(S, 4) float64: x0, y0, x1, y1 in metres."""
    origin: np.ndarray
    """(2,) float64: lower left corner of the grid, at least `MARGIN_M` from all walls."""
    columns: int
    rows: int
    start: np.ndarray
    """(C + 1,) int32: cell c has the nearby segments `near[start[c]:start[c + 1]]`."""
    near: np.ndarray
    """int32: indices of the nearby segments of all cells."""
    free: np.ndarray
    """(C,) float64: lower bound of the distance from the cell to all other segments, in metres."""
    guess_m: float
    """Edge length of the cells of `blockers`, at least `CELL_M`."""
    guess_columns: int
    guess_rows: int
    blockers: np.ndarray
    """(G, corners) int32, for the `G` cells of a grid with the same origin: the segment that last
    hid a corner from a point in the cell, or −1. It is tried first."""

    @classmethod
    def past(cls, segments: Float[np.ndarray, "S 4"], corners: int) -> "Sight":
        """Tables for the given walls and number of corners."""
        segments = np.ascontiguousarray(segments, np.float64)
        ends = segments.reshape(-1, 2)
        lower = ends.min(axis=0, initial=0.0 if len(ends) == 0 else np.inf) - MARGIN_M
        upper = ends.max(axis=0, initial=0.0 if len(ends) == 0 else -np.inf) + MARGIN_M
        columns, rows = (int(np.ceil(extent / CELL_M)) for extent in upper - lower)
        start, near, free, _ = walls_near(segments, lower, columns, rows, NEAR_M)
        guess_m = max(CELL_M, CELL_M * math.sqrt(columns * rows * corners / MOST_GUESSES))
        wide, high = (math.ceil(count * CELL_M / guess_m) for count in (columns, rows))
        blockers = np.full((wide * high, corners), -1, np.int32)
        return cls(segments, lower, columns, rows, start, near, free, guess_m, wide, high, blockers)


class RouteTables(NamedTuple):
    """The visibility graph of a scene with `C` corners."""

    corners: np.ndarray
    """(C, 2) float64 positions in metres."""
    between: np.ndarray
    """(C, C) float64: lengths of the shortest paths between corners in metres."""
    sight: Sight


NO_ROUTES = RouteTables(np.zeros((0, 2)), np.zeros((0, 0)), Sight.past(np.zeros((0, 4)), 0))
"""Without walls, all ways are straight."""


class Routes:
    """Computes the next point on the shortest path of each person to its goal.

    The results for a goal are cached as long as a slot has the same goal.
    """

    def __init__(
        self,
        corners: Float[np.ndarray, "C 2"],
        between: Float[np.ndarray, "C C"],
        sight: Sight,
    ) -> None:
        # The kernel is compiled once, for arrays of these types and in this order.
        self._corners = np.ascontiguousarray(corners, np.float64)
        self._between = np.ascontiguousarray(between, np.float64)
        self._sight = sight
        self._forget(0, 0)

    @classmethod
    def on(cls, scene: Scene) -> "Routes":
        """Routes in a scene. The visibility graph of a scene is computed once and cached."""
        key = scene.walls, scene.bounds
        if key not in _GRAPHS:
            corners = _corners(scene)
            sight = Sight.past(scene.wall_segments, len(corners))
            _GRAPHS[key] = corners, _distances(corners, scene, sight), sight
        return cls(*_GRAPHS[key])

    @property
    def tables(self) -> RouteTables:
        """The visibility graph."""
        return RouteTables(self._corners, self._between, self._sight)

    def next_of(
        self,
        world: Int[np.ndarray, " A"],
        slot: Int[np.ndarray, " A"],
        position: Real[np.ndarray, "A 2"],
        goal: Real[np.ndarray, "A 2"],
    ) -> tuple[Float[np.ndarray, "A 2"], Float[np.ndarray, " A"]]:
        """Next point (A, 2) of each path, and remaining path length (A,) from there, in metres.

        The next point is the goal if it is in sight or cannot be reached, else the next corner of
        the shortest path.
        """
        target, beyond = np.array(goal, np.float64, order="C"), np.zeros(len(slot))
        if len(self._sight.segments) and len(slot):
            worlds, slots = int(world.max()) + 1, int(slot.max()) + 1
            most_worlds, most_slots = self._known.shape[:2]
            if worlds > most_worlds or slots > most_slots:
                self._forget(max(worlds, most_worlds), max(2 * slots, most_slots))
            _next(
                len(slot),
                np.ascontiguousarray(world, np.int64),
                np.ascontiguousarray(slot, np.int64),
                np.ascontiguousarray(position, np.float64),
                target,
                beyond,
                self._known,
                self._goal,
                self._seen,
                self._to_goal,
                self._corners,
                self._between,
                self._sight,
            )
        return target, beyond

    def _forget(self, worlds: int, slots: int) -> None:
        """Make room for so many people; what was cached before is computed again."""
        self._known = np.full((worlds, slots, 2), -1, np.int64)
        self._goal = np.full((worlds, slots, 2), np.nan)
        self._seen = np.full((worlds, slots, 5), np.nan)
        self._to_goal = np.full((worlds, slots, len(self._corners)), np.inf)


def _corners(scene: Scene) -> Float[np.ndarray, "C 2"]:
    """Convex corners of the walls, moved away from the walls by the clearance."""
    solid = scene.obstacles
    grown = solid.buffer(CORNER_M, join_style="mitre", mitre_limit=2.0)
    # Grown a little further, so that simplification does not move corners closer to the walls.
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
            found += [tuple(p) for p in points[turns > 0]]  # left turns: convex corners of the wall
    corners = np.array(found).reshape(-1, 2)
    return corners[scene.walkable(corners)]


def _distances(
    corners: Float[np.ndarray, "C 2"], scene: Scene, sight: Sight
) -> Float[np.ndarray, "C C"]:
    """Lengths of the shortest paths between corners in metres; infinite if there is none."""
    from scipy.sparse.csgraph import dijkstra  # slow to import, and not needed without walls

    count = len(corners)
    if count == 0:
        return np.zeros((0, 0))
    solid = scene.obstacles.buffer(_GRAZE_M)
    shapely.prepare(solid)
    a, b = np.triu_indices(count, 1)
    seen = _unhidden(corners, sight)[a, b]  # most pairs are hidden, and this is much faster
    a, b = a[seen], b[seen]
    lines = shapely.linestrings(np.stack([corners[a], corners[b]], axis=1))
    free = ~shapely.intersects(solid, lines)
    edges = np.zeros((count, count))  # in scipy's dense graphs, 0 means no edge
    edges[a[free], b[free]] = np.linalg.norm(corners[a[free]] - corners[b[free]], axis=1)
    return np.asarray(dijkstra(edges, directed=False))


@compiled
def _unhidden(corners, sight):
    """Whether no wall crosses the line between two corners, (C, C) for pairs a < b."""
    seen = np.zeros((len(corners), len(corners)), np.bool_)
    room = np.empty(5)
    for a in range(len(corners)):
        wall = -1
        for b in range(a + 1, len(corners)):
            x, y, to_x, to_y = corners[a, 0], corners[a, 1], corners[b, 0], corners[b, 1]
            wall = _blocker(x, y, to_x, to_y, wall, sight, room)
            seen[a, b] = wall < 0
    return seen


@Kernel
def _next(world, slot, position, goal, beyond, known, of, seen, to_goal, corners, between, sight):
    """Replace hidden goals in `goal` by the next corner; write the path length from it to `beyond`.

    Results are cached for the next step: `known` contains the wall that hides a person's goal and
    its next corner, `to_goal` the path lengths from all corners to the goal `of`, and `seen` its
    line of sight, see `_blocker`. Threads share `sight.blockers` without locks: these are guesses,
    which change no result.
    """
    corner_x, corner_y = corners[:, 0].copy(), corners[:, 1].copy()
    for chunk in prange((len(slot) + CHUNK - 1) // CHUNK):
        ways, tried = np.empty(len(corners)), np.empty(len(corners), np.int64)
        spare = np.empty(5)
        for a in range(chunk * CHUNK, min(len(slot), (chunk + 1) * CHUNK)):
            next_of(
                world[a], slot[a], position[a], goal[a], beyond, a, known, of, seen, to_goal,
                corners, corner_x, corner_y, between, sight, ways, tried, spare,
            )  # fmt: skip


@subroutine
def next_of(
    w, i, at, goal, beyond, a, known, of, seen, to_goal, corners, corner_x, corner_y, between,
    sight, ways, tried, spare,
):  # fmt: skip
    """The same for one person.

    `ways` and `tried`, with a number per corner, and `spare`, with five, are working memory.
    """
    count, blockers = len(corners), sight.blockers
    x, y = at[0], at[1]
    room = seen[w, i]
    if _still_in_sight(x, y, goal[0], goal[1], room):
        return
    wall = _blocker(x, y, goal[0], goal[1], known[w, i, 0], sight, room)
    if wall < 0:
        return
    known[w, i, 0] = wall
    own = to_goal[w, i]
    if of[w, i, 0] != goal[0] or of[w, i, 1] != goal[1]:
        of[w, i, 0], of[w, i, 1], known[w, i, 1] = goal[0], goal[1], -1
        _to_goal(goal[0], goal[1], corners, between, sight, own, spare)
    cell = _guess_cell(x, y, sight)
    # Usually the next corner is that of the previous step, or one with a shorter path now.
    last, limit = known[w, i, 1], np.inf
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
    # Corners are tested in the order of path length (ties by index). The first one in sight is
    # on the shortest path.
    known[w, i, 1] = -1
    for _ in range(few):
        k = 0
        for c in range(1, few):
            if ways[c] < ways[k]:
                k = c
        best = tried[k]
        wall = -1
        if best != last or limit == np.inf:
            to_x, to_y = corner_x[best], corner_y[best]
            wall = _blocker(x, y, to_x, to_y, np.int64(blockers[cell, best]), sight, room)
        if wall < 0:
            goal[0], goal[1] = corner_x[best], corner_y[best]
            beyond[a] = own[best]
            known[w, i, 1] = best
            return
        blockers[cell, best] = wall
        ways[k] = np.inf


@compiled
def _to_goal(x, y, corners, between, sight, result, room):
    """Write the length of the shortest path from each corner to (x, y) to `result`.

    `room` is working memory, see `_blocker`.
    """
    for c in range(len(corners)):
        result[c] = np.inf
    cell, blockers = _guess_cell(x, y, sight), sight.blockers
    for c in range(len(corners)):
        guess = np.int64(blockers[cell, c])
        wall = _blocker(x, y, corners[c, 0], corners[c, 1], guess, sight, room)
        if wall < 0:
            off = math.hypot(corners[c, 0] - x, corners[c, 1] - y)
            for d in range(len(corners)):
                result[d] = min(result[d], off + between[d, c])
        else:
            blockers[cell, c] = wall


@subroutine
def _cell(x, y, sight):
    return cell_of(x, y, (sight.origin[0], sight.origin[1], CELL_M, sight.columns, sight.rows))


@subroutine
def _guess_cell(x, y, sight):
    grid = (sight.origin[0], sight.origin[1], sight.guess_m, sight.guess_columns, sight.guess_rows)
    return cell_of(x, y, grid)


@subroutine
def _still_in_sight(x, y, to_x, to_y, room):
    """Whether the line from (x, y) stays in the free corridor of an earlier line to that point."""
    if room[2] != to_x or room[3] != to_y:
        return False
    return distance_to_segment(x, y, room[0], room[1], to_x, to_y) < room[4]


@subroutine
def _blocker(x, y, to_x, to_y, guess, sight, room):
    """Index of a wall segment that crosses the line from (x, y) to (to_x, to_y), −1 if none does.

    Tests `guess` first. Then it moves along the line and tests the segments near each visited cell;
    no other segment can be met before the next visited cell. If none crosses, it writes the ends
    of the line and its distance from all walls, at most `ROOM_M`, to `room`.
    """
    segments = sight.segments
    if guess >= 0 and crosses(x, y, to_x, to_y, segments[guess]):
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
            at += off + MARGIN_M - ROOM_M  # outside the grid: no wall is within off + MARGIN_M
            continue
        cell = _cell(px, py, sight)
        for k in range(sight.start[cell], sight.start[cell + 1]):
            wall = segments[sight.near[k]]
            if crosses(x, y, to_x, to_y, wall):
                return sight.near[k]
            wide = min(wide, segments_apart(x, y, to_x, to_y, wall[0], wall[1], wall[2], wall[3]))
        at += sight.free[cell] - ROOM_M
    room[0], room[1], room[2], room[3] = x, y, to_x, to_y
    room[4] = wide - _ROUNDED_M
    return -1
