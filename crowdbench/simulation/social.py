"""The observation `social-1`: the person itself, the space around it and the nearest others.

It is in the person's own frame: x along its heading, y to its left. The heading is remembered: it
is the direction of the last velocity of at least 0.3 m/s. At entry it is the direction of the entry
velocity or, if that is slower, of the target. Actions are in the same frame: the commanded velocity
along the heading and to the left of it.

Each part has a slice, see below. Values are clipped to [−1, 1], and those of absent people are
zero. There are no rays, so the settings `rays` and `ray_range_m` do not apply.
"""

import math
from typing import TypeVar

import numpy as np
from jaxtyping import Float32, Real
from numba import prange

from crowdbench.compilation import Kernel, subroutine
from crowdbench.simulation.cells import CHUNK, list_persons, neighbours, sort_into_cells
from crowdbench.simulation.free_space import REACH_M, free_distance
from crowdbench.simulation.rules import from_own_frame, to_own_frame
from crowdbench.simulation.state import TO_GOAL, WAITING

Array = TypeVar("Array")

VELOCITY = slice(0, 2)
"""Velocity / max_speed."""
HEADING = slice(2, 4)
"""Cosine and sine of the heading in the world frame, for networks that work in that frame."""
ROUTE_DIRECTION = slice(4, 6)
"""Unit vector to the next corner of the shortest path to the target, or to the target if it is in
sight; (1, 0) at the target itself."""
ROUTE_LENGTH = slice(6, 7)
"""Length of that path / `ROUTE_RANGE_M`."""
PREFERRED_SPEED = slice(7, 8)
"""Preferred speed / max_speed."""
STOP = slice(8, 9)
"""1 if the target is a stop, that is, a via point with a wait; else 0."""
WAIT_LEFT = slice(9, 10)
"""Remaining wait at the stop / `WAIT_S`; the whole wait before it begins, 0 without a stop."""
AGE = slice(10, 11)
"""Time since entry / `AGE_S`."""
WALKED = slice(11, 12)
"""Distance walked since entry / `WALKED_M`."""
STOOD = slice(12, 13)
"""Total time since entry at less than 0.3 m/s / `STOOD_S`."""
PROBES = slice(13, 38)
"""Distance from the nearest wall or bound at each of `PROBE_POINTS` / 2 m; 0 in walls and outside
the bounds. It is interpolated between points of a grid."""
NEIGHBOURS = slice(38, 102)
"""`NEAREST` people within `RANGE_M`, nearest first, of equally near ones that of the lower slot
first. `neighbours_of` returns them as an array (…, 8, 8), whose last axis is described below."""
SIZE = 102
"""Number of values."""

NEAREST, FEATURES = 8, 8
"""Number of neighbours, and of values of each."""
OFFSET = slice(0, 2)
"""Relative position / `RANGE_M`. Whoever is wider than a person is shown nearer by as much, so
that its body begins where that of a person would."""
APPROACH = slice(2, 4)
"""Relative velocity / max_speed."""
PASS_TIME = slice(4, 5)
"""Time until both are closest if they keep their velocities, at most `PASS_S`, / `PASS_S`; 0 if
they move apart."""
PASS_DISTANCE = slice(5, 6)
"""Distance at that time / `PASS_M`."""
COMPANION = slice(6, 7)
"""1 if both walk in the same group, else 0."""
PRESENT = slice(7, 8)
"""1, and 0 where there are fewer people; then all other values are 0."""

ROUTE_RANGE_M, WAIT_S, AGE_S, WALKED_M, STOOD_S = 30.0, 60.0, 120.0, 60.0, 60.0
RANGE_M, PASS_S, PASS_M = 6.0, 5.0, 3.0
PROBE_RADII_M = (0.5, 1.0, 2.0)
_ANGLE = 2 * np.pi * np.arange(8) / 8
PROBE_POINTS = np.vstack(
    [np.zeros((1, 2)), *(r * np.stack([np.cos(a), np.sin(a)])[None] for a in _ANGLE
                         for r in PROBE_RADII_M)]
)  # fmt: skip
"""(25, 2) points in the own frame in metres: the person itself, then for each of 8 directions,
counter-clockwise from the heading, those at 0.5, 1 and 2 m."""

_AHEAD, _LEFT = (np.ascontiguousarray(along) for along in PROBE_POINTS.T)
_PROBES, _NEIGHBOURS = PROBES.start, NEIGHBOURS.start


def with_velocities_times(
    factor: float, seen: Float32[np.ndarray, "A _"]
) -> Float32[np.ndarray, "A _"]:
    """Observations (A, 102) whose velocities and speeds are multiplied by a factor."""
    found = seen.copy()
    found[:, VELOCITY] *= factor
    found[:, PREFERRED_SPEED] *= factor
    neighbours_of(found)[..., APPROACH] *= factor
    return found


def neighbours_of(seen: Array) -> Array:
    """The neighbours (…, 8, 8) in observations (…, obs), numpy arrays or torch tensors."""
    part = seen[..., NEIGHBOURS]  # type: ignore[index]
    return part.reshape(*part.shape[:-1], NEAREST, FEATURES)


def in_own_frame(
    actions: Real[np.ndarray, "*n 2"], heading: Real[np.ndarray, "*n 2"]
) -> Float32[np.ndarray, "*n 2"]:
    """Actions in the own frames of people with these headings, from actions in the world frame.

    They are first clipped as in a step, because the clipping to [−1, 1]² depends on the frame.
    """
    x, y = np.moveaxis(np.clip(actions.astype(np.float64), -1, 1), -1, 0)
    scale = 1 / np.maximum(1.0, np.hypot(x, y))
    cos, sin = np.moveaxis(heading.astype(np.float64), -1, 0)
    own = np.stack([scale * (x * cos + y * sin), scale * (y * cos - x * sin)], axis=-1)
    return own.clip(-1, 1).astype(np.float32)


@Kernel
def observe_social(
    slots, queue, clock, target, beyond, cells, free, constants, remaining, nearest, out
):
    """Write the observations of everyone present or ended in this step to `out` (W, N, SIZE).

    `target` (W, N, 2), `beyond`, `remaining` and `nearest` (W, N) are as in the kernel of
    `observations`. `nearest` is infinite if nobody is visible within `RANGE_M`.
    """
    # Arrays are unpacked once, because each access through a bundle has a cost.
    alive, ended, spawned = slots.alive, slots.ended, slots.spawned
    position, heading, wider = slots.position, slots.heading, slots.wider
    start, sorted_xy, sorted_slot, person = cells.start, cells.xy, cells.slot, cells.person
    grid = (cells.origin[0], cells.origin[1], cells.size, cells.columns, cells.rows)
    distance, free_grid = (
        free.distance,
        (free.x_min, free.y_min, free.per_x, free.per_y, free.columns, free.rows),
    )
    widest = np.empty(alive.shape[0])
    for w in prange(alive.shape[0]):
        widest[w] = sort_into_cells(w, alive, ended, position, wider, grid, start, sorted_xy,
                                    sorted_slot)  # fmt: skip
    total = list_persons(cells)
    for chunk in prange((total + CHUNK - 1) // CHUNK):
        near = np.empty((alive.shape[1] + 1, 2), np.float32)
        who = np.empty(alive.shape[1] + 1, np.int32)
        best = np.empty(NEAREST, np.int32)
        gaps = np.empty(NEAREST, np.float32)
        for at in range(chunk * CHUNK, min(total, (chunk + 1) * CHUNK)):
            w, i = person[at, 0], person[at, 1]
            me = out[w, i]
            remaining[w, i] = see_itself(w, i, slots, queue, clock, target, beyond, constants, me)
            x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
            cos, sin = np.float64(heading[w, i, 0]), np.float64(heading[w, i, 1])
            probe(x, y, cos, sin, distance, free_grid, me)
            count = neighbours(w, i, x, y, RANGE_M + widest[w], ended, spawned, grid, start,
                               sorted_xy, sorted_slot, near, who)  # fmt: skip
            if widest[w] > 0.0:
                count = _draw_nearer(w, count, near, who, wider)
            count = _choose(count, near, who, best, gaps)
            nearest[w, i] = math.sqrt(gaps[0]) if count > 0 else np.inf
            see_nearest(w, i, count, best, slots, queue, constants, me)


@subroutine
def _clipped(value):
    return max(-1.0, min(1.0, value))


@subroutine
def see_itself(w, i, slots, queue, clock, target, beyond, constants, me):
    """Write the parts before the probes to `me` and return the length of the path in metres."""
    cos, sin = np.float64(slots.heading[w, i, 0]), np.float64(slots.heading[w, i, 1])
    vx, vy = to_own_frame(
        np.float64(slots.velocity[w, i, 0]), np.float64(slots.velocity[w, i, 1]), cos, sin
    )
    me[0], me[1] = _clipped(vx / constants.max_speed), _clipped(vy / constants.max_speed)
    me[2], me[3] = _clipped(cos), _clipped(sin)
    gx = np.float64(target[w, i, 0]) - np.float64(slots.position[w, i, 0])
    gy = np.float64(target[w, i, 1]) - np.float64(slots.position[w, i, 1])
    distance = math.sqrt(gx * gx + gy * gy)
    remaining = distance + beyond[w, i]
    gx, gy = to_own_frame(gx, gy, cos, sin)
    me[4] = _clipped(gx / distance) if distance > 0.0 else 1.0
    me[5] = _clipped(gy / distance) if distance > 0.0 else 0.0
    me[6] = min(remaining, ROUTE_RANGE_M) / ROUTE_RANGE_M
    me[7] = min(1.0, np.float64(slots.speed[w, i]) / constants.max_speed)
    wait, frame = queue.wait[w, slots.event[w, i]], clock.frame[w]
    stop = slots.stage[w, i] != TO_GOAL and wait > 0
    if slots.stage[w, i] == WAITING:
        wait = slots.until[w, i] - frame
    me[8] = 1.0 if stop else 0.0
    me[9] = min(1.0, wait * constants.dt / WAIT_S) if stop else 0.0
    me[10] = min(1.0, (frame - slots.born[w, i]) * constants.dt / AGE_S)
    me[11] = min(1.0, np.float64(slots.walked[w, i]) / WALKED_M)
    me[12] = min(1.0, slots.stood[w, i] * constants.dt / STOOD_S)
    return remaining


@subroutine
def probe(x, y, cos, sin, distance, grid, me):
    """Write the probes of somebody at (x, y) with the heading (cos, sin) to its observation."""
    for k in range(_NEIGHBOURS - _PROBES):
        dx, dy = from_own_frame(_AHEAD[k], _LEFT[k], cos, sin)
        me[_PROBES + k] = free_distance(x + dx, y + dy, distance, grid) / REACH_M


@subroutine
def _draw_nearer(w, count, near, who, wider):
    """Move whoever is wider than a person nearer by as much, and drop all beyond `RANGE_M`.

    A body then begins where that of a person would. Returns the number of those left.
    """
    left = 0
    for k in range(count):
        x, y, gap = drawn_nearer(near[k, 0], near[k, 1], wider[w, who[k]])
        if gap < RANGE_M:
            near[left, 0], near[left, 1], who[left] = x, y, who[k]
            left += 1
    return left


@subroutine
def drawn_nearer(dx, dy, wider):
    """Where the body of somebody at (dx, dy) begins as if it were a person's, and how far away."""
    x, y = np.float64(dx), np.float64(dy)
    distance = math.sqrt(x * x + y * y)
    gap = max(0.0, distance - np.float64(wider))
    scale = gap / distance if distance > 0.0 else 0.0
    return np.float32(x * scale), np.float32(y * scale), gap


@subroutine
def _choose(count, near, who, best, gaps):
    """Choose the nearest of `count` people and return their number, at most `NEAREST`.

    Writes their slots to `best` and their squared distances to `gaps`, nearest first.
    """
    chosen = 0
    for k in range(count):
        gap = near[k, 0] * near[k, 0] + near[k, 1] * near[k, 1]
        chosen = consider(gap, who[k], chosen, best, gaps)
    return chosen


@subroutine
def consider(gap, j, chosen, best, gaps):
    """Put slot j among the `chosen` nearest so far, if it is one of them; return their number.

    Of equally near people the lower slot is first, so that the order of cells is irrelevant.
    """
    at = chosen
    if chosen == NEAREST:
        at = NEAREST - 1
        if not (gap < gaps[at] or (gap == gaps[at] and j < best[at])):
            return chosen
    else:
        chosen += 1
    while at > 0 and (gap < gaps[at - 1] or (gap == gaps[at - 1] and j < best[at - 1])):
        gaps[at], best[at] = gaps[at - 1], best[at - 1]
        at -= 1
    gaps[at], best[at] = gap, j
    return chosen


@subroutine
def see_nearest(w, i, count, best, slots, queue, constants, me):
    """Write the parts of the `count` nearest people, whose slots are in `best`, to `me`."""
    position, velocity, wider = slots.position, slots.velocity, slots.wider
    x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
    cos, sin = np.float64(slots.heading[w, i, 0]), np.float64(slots.heading[w, i, 1])
    mine = queue.group[w, slots.event[w, i]]
    for k in range(count):
        j, first = best[k], _NEIGHBOURS + FEATURES * k
        dx = np.float32(np.float64(position[w, j, 0]) - x)
        dy = np.float32(np.float64(position[w, j, 1]) - y)
        if wider[w, j] > 0.0:
            dx, dy, _ = drawn_nearer(dx, dy, wider[w, j])
        see_other(
            np.float64(dx), np.float64(dy),
            np.float64(velocity[w, j, 0]) - np.float64(velocity[w, i, 0]),
            np.float64(velocity[w, j, 1]) - np.float64(velocity[w, i, 1]),
            cos, sin, constants.max_speed, me[first : first + FEATURES],
        )  # fmt: skip
        theirs = queue.group[w, slots.event[w, j]]
        me[first + 6] = 1.0 if mine >= 0 and theirs == mine else 0.0
        me[first + 7] = 1.0
    for k in range(_NEIGHBOURS + FEATURES * count, SIZE):
        me[k] = 0.0


@subroutine
def see_other(dx, dy, vx, vy, cos, sin, max_speed, other):
    """Write position, velocity and closest pass of a neighbour at (dx, dy) with velocity (vx, vy).

    Both are relative to the person, in the world frame, in metres and m/s.
    """
    approach, squared = -(dx * vx + dy * vy), vx * vx + vy * vy
    time = min(PASS_S, approach / squared) if approach > 0.0 else 0.0
    px, py = dx + time * vx, dy + time * vy
    dx, dy = to_own_frame(dx, dy, cos, sin)
    vx, vy = to_own_frame(vx, vy, cos, sin)
    other[0], other[1] = _clipped(dx / RANGE_M), _clipped(dy / RANGE_M)
    other[2], other[3] = _clipped(vx / max_speed), _clipped(vy / max_speed)
    other[4] = time / PASS_S
    other[5] = min(1.0, math.sqrt(px * px + py * py) / PASS_M)
