"""Contact: people have bodies, discs that pass neither through each other nor through walls.

A step is cut into sub-steps. In each of them, nobody uses more than a fixed share of the gap to
anybody else, at most half of it, and walls are kept off by the radius. Each person's commanded
displacement is projected onto the half-planes that this allows, so people slide along each other
and along walls, and nobody is pushed. Bodies that do not overlap never will, whatever they are
commanded. The share of the gap amounts to a speed of at most gap / `HEADWAY_S`, as in the
collision-free speed model (Tordeux, Chraibi and Seyfried 2016, eq. 2.2, there with the gap ahead).

Discs that only stop each other form arches before doors and jams where people meet head-on. Two
rules dissolve them. Those who are blocked by somebody who comes towards them turn to the right for
a while. And those who stay blocked turn by random angles, which grow with time.

Everything is computed from one state of all people, and the random numbers are a hash of the
position and the frame, so the result depends neither on the numbering of people nor on threads.
"""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from crowdbench.compilation import subroutine
from crowdbench.simulation.half_planes import project
from crowdbench.simulation.rules import uniform, walk
from crowdbench.simulation.walls import CELL_M, cell_of

SUBSTEP_S = 0.1
"""Longest sub-step in seconds."""
HEADWAY_S = 0.25
"""Time in which a gap would close at the highest speed towards a neighbour, in seconds."""
PART_MPS = 0.5
"""Speed at which people who overlap part, in m/s; recorded people may enter on the same spot."""
BLOCKED = 0.5
"""A person is blocked who advances less than this share of the commanded way."""
YIELD_S = 0.4
"""Time being blocked after which a person keeps to the right of somebody who comes, in seconds."""
RESTLESS_S = 1.0
"""Time being blocked after which a person turns by random angles, in seconds."""
DESPERATE_S = 2.0
"""Time being blocked after which it tries all directions, and longest time counted, in seconds."""
CALMING = 4.0
"""Seconds of being blocked that are forgotten in a second of free walking."""
TOUCH_M = 0.1
"""Gap below which a person meets somebody who comes towards it, in metres."""
AHEAD = 0.3
"""Cosine of the angle to the command within which somebody is ahead."""
ASIDE_S = 1.0
"""Time for which a person keeps to the right after it has met somebody, in seconds."""
ASIDE_RAD = 1.2
"""Angle by which it turns to the right, in radians."""
SPREAD_RAD = 0.5
"""Largest random angle while it keeps to the right, in radians."""
PLANES = 32
"""Number of half-planes that are considered for one person."""
REACH_M = 0.02
"""Distance beyond a sub-step's reach at which neighbours and walls are considered, in metres."""


class Bodies(NamedTuple):
    """Settings of contact and working memory, W worlds of N slots."""

    radius: float
    """Radius of a person's body in metres. Bodies in slots that are `wider` are kept apart from
    others by as much more; walls keep off this radius from everyone."""
    substeps: int
    at: np.ndarray
    """(W, N, 2) float64: positions in metres."""
    moved: np.ndarray
    """(W, N, 2) float64: displacement of the sub-step; at first the length of the command. In m."""
    command: np.ndarray
    """(W, N, 2) float64: commanded displacement of a sub-step, of the scripted the real one."""
    order: np.ndarray
    """(W, N) int32: slots of those present, by x."""
    met: np.ndarray
    """(W, N) whether the person can meet somebody in this step, then whether it touches somebody
    who comes towards it."""

    @classmethod
    def of(cls, worlds: int, slots: int, radius_m: float, dt_s: float) -> "Bodies | None":
        """Bodies of a radius; None if it is 0."""
        if radius_m == 0:
            return None
        shape = (worlds, slots)
        return cls(
            radius=float(radius_m),
            substeps=max(1, math.ceil(dt_s / SUBSTEP_S - 1e-6)),
            at=np.zeros((*shape, 2)),
            moved=np.zeros((*shape, 2)),
            command=np.zeros((*shape, 2)),
            order=np.zeros(shape, np.int32),
            met=np.zeros(shape, np.bool_),
        )


@njit(error_model="numpy")
def push_through(w, frame, dt, slots, bodies, walls):
    """Walk all bodies of a world; `bodies.at` becomes the positions after the step.

    `bodies.at` and `bodies.command` are the positions before it and the commanded displacements of
    one sub-step. Sets `hit_wall`, adds to `held`, and keeps `blocked` and `aside` of `slots`.
    """
    at, order, step_s = bodies.at, bodies.order, dt / bodies.substeps
    count, part, widest = _walk_freely(w, step_s, slots, bodies, walls)
    plane = np.empty((PLANES, 3))
    for sub in range(bodies.substeps):
        for k in range(count):  # recorded people walk as recorded; all others see where they are
            walk_script(w, order[w, k], slots, bodies)
        _sort(w, count, at, order)
        for k in range(count):
            choose_way(w, k, count, frame * bodies.substeps + sub, step_s, part, widest, slots,
                       bodies, walls, plane)  # fmt: skip
        for k in range(count):
            go(w, order[w, k], step_s, slots, bodies)


@subroutine
def walk_script(w, i, slots, bodies):
    """Walk a recorded person by a sub-step."""
    if slots.scripted[w, i]:
        bodies.at[w, i, 0] += bodies.command[w, i, 0]
        bodies.at[w, i, 1] += bodies.command[w, i, 1]


@subroutine
def choose_way(w, k, count, tick, step_s, part, widest, slots, bodies, walls, plane):
    """Write the displacement in a sub-step of the k-th by x to `bodies.moved`, and add to `held`.

    `plane` (`PLANES`, 3) is working memory.
    """
    i = bodies.order[w, k]
    if slots.scripted[w, i]:
        return
    dx, dy, bodiless, planes = _free_way(
        w, k, count, tick, step_s, part, widest, slots, bodies, walls, plane
    )
    bodies.moved[w, i, 0], bodies.moved[w, i, 1] = dx, dy
    if bodiless > 0:
        cx, cy = bodies.command[w, i, 0], bodies.command[w, i, 1]
        share = _held(cx, cy, dx, dy, plane, bodiless, planes)
        slots.held[w, i] = np.float64(slots.held[w, i]) + share / bodies.substeps


@subroutine
def go(w, i, step_s, slots, bodies):
    """Walk a person by the displacement in `bodies.moved`; keep `blocked` and `aside`."""
    if slots.scripted[w, i]:
        return
    dx, dy = bodies.moved[w, i, 0], bodies.moved[w, i, 1]
    bodies.at[w, i, 0] += dx
    bodies.at[w, i, 1] += dy
    cx, cy = bodies.command[w, i, 0], bodies.command[w, i, 1]
    blocked_s = np.float64(slots.blocked[w, i])
    slots.aside[w, i] = max(0.0, np.float64(slots.aside[w, i]) - step_s)
    if dx * cx + dy * cy < BLOCKED * (cx * cx + cy * cy):
        blocked_s += step_s
        if bodies.met[w, i] and blocked_s > YIELD_S:
            slots.aside[w, i] = ASIDE_S
    else:
        blocked_s -= CALMING * step_s
    slots.blocked[w, i] = min(DESPERATE_S, max(0.0, blocked_s))


@subroutine
def _walk_freely(w, step_s, slots, bodies, walls):
    """Walk those who can meet nobody and no wall in this step, and list the others in `order`.

    Returns the number of the others, by how much people who overlap may part in a sub-step, which
    is 0 if nobody can overlap, and the largest `wider`. Most people are free in most steps.
    """
    at, command, order, busy = bodies.at, bodies.command, bodies.order, bodies.met
    wider, two, share = slots.wider, 2.0 * bodies.radius, step_s / HEADWAY_S
    count, longest, widest, recorded = 0, 0.0, 0.0, False
    for i in range(slots.alive.shape[1]):
        if slots.alive[w, i]:
            order[w, count] = i
            count += 1
            dx, dy = command[w, i, 0], command[w, i, 1]
            bodies.moved[w, i, 0] = math.sqrt(dx * dx + dy * dy)
            longest = max(longest, bodies.moved[w, i, 0])
            widest = max(widest, np.float64(wider[w, i]))
            busy[w, i] = slots.blocked[w, i] > 0.0 or slots.aside[w, i] > 0.0
            # Recorded people walk into others. A robot, which never leaves, hardly does, and must
            # change nothing for those who are far from it.
            recorded = recorded or (slots.scripted[w, i] and slots.leave[w, i] >= 0)
    _sort(w, count, at, order)
    part = (
        PART_MPS * step_s if recorded or _overlap(w, count, two, widest, wider, at, order) else 0.0
    )
    for k in range(count):
        i = order[w, k]
        x, y, mine = at[w, i, 0], at[w, i, 1], bodies.moved[w, i, 0] + part
        mine_wide = two + np.float64(wider[w, i])
        if near_wall(x, y, mine, bodies, walls):
            busy[w, i] = True
        for m in range(k + 1, count):
            j = order[w, m]
            ex, ey = at[w, j, 0] - x, at[w, j, 1] - y
            if ex > reach_of(mine, longest + part, mine_wide + widest, share, bodies.substeps):
                break
            touch = mine_wide + np.float64(wider[w, j])
            reach = reach_of(mine, bodies.moved[w, j, 0] + part, touch, share, bodies.substeps)
            if ex * ex + ey * ey < reach * reach:
                busy[w, i] = True
                busy[w, j] = True
    others = 0
    for k in range(count):
        i = order[w, k]
        if busy[w, i]:
            order[w, others] = i
            others += 1
        else:
            at[w, i, 0] += bodies.substeps * command[w, i, 0]
            at[w, i, 1] += bodies.substeps * command[w, i, 1]
    return others, part, widest


@subroutine
def near_wall(x, y, mine, bodies, walls):
    """Whether somebody can meet a wall in a step; `mine` is its longest way in a sub-step."""
    grid = (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows)
    room = bodies.radius + REACH_M + (bodies.substeps + 1) * mine
    return walls.clear[cell_of(x, y, grid)] < room


@subroutine
def reach_of(mine, others, touch, share, parts):
    """Distance beyond which two people do not matter to each other in a step.

    `mine` and `others` are the longest ways that they can go in a sub-step, and `touch` is the sum
    of their radii.
    """
    longer = max(mine, others)
    return touch + max(longer / share, TOUCH_M) + REACH_M + parts * (mine + others)


@subroutine
def _overlap(w, count, two, widest, wider, at, order):
    """Whether two bodies overlap; `two` is a person's diameter, `widest` the largest excess."""
    for k in range(count):
        i = order[w, k]
        mine = two + np.float64(wider[w, i])
        for m in range(k + 1, count):
            j = order[w, m]
            ex, ey = at[w, j, 0] - at[w, i, 0], at[w, j, 1] - at[w, i, 1]
            if ex > mine + widest:
                break
            touch = mine + np.float64(wider[w, j])
            if ex * ex + ey * ey < touch * touch:
                return True
    return False


@subroutine
def _sort(w, count, at, order):
    """Insertion sort by x, then y: nearly sorted from the second sub-step on."""
    for k in range(1, count):
        i = order[w, k]
        x, y = at[w, i, 0], at[w, i, 1]
        m = k - 1
        while m >= 0:
            j = order[w, m]
            if at[w, j, 0] < x or (at[w, j, 0] == x and at[w, j, 1] <= y):
                break
            order[w, m + 1] = j
            m -= 1
        order[w, m + 1] = i


@subroutine
def _free_way(w, k, count, tick, step_s, part, widest, slots, bodies, walls, plane):
    """Displacement in this sub-step of the k-th by x; `part` and `widest` as in `_walk_freely`.

    Also returns how many half-planes of bodies and how many half-planes `plane` begins with.
    """
    at, command, order, wider = bodies.at, bodies.command, bodies.order, slots.wider
    i = order[w, k]
    mine = 2.0 * bodies.radius + np.float64(wider[w, i])
    x, y = at[w, i, 0], at[w, i, 1]
    bodies.met[w, i] = False
    dx, dy = command[w, i, 0], command[w, i, 1]
    length = math.sqrt(dx * dx + dy * dy)
    share = step_s / HEADWAY_S
    most = length + part
    matters = max(most / share, TOUCH_M)
    planes, least = 0, np.inf
    part_x, part_y = 0.0, 0.0
    for side in range(2):
        m = k + 1 if side == 0 else k - 1
        while 0 <= m < count:
            j = order[w, m]
            ex, ey = at[w, j, 0] - x, at[w, j, 1] - y
            if abs(ex) > mine + widest + matters + REACH_M:
                break
            m += 1 if side == 0 else -1
            squared = ex * ex + ey * ey
            touch = mine + np.float64(wider[w, j])
            reach = touch + matters + REACH_M
            if squared > reach * reach or squared == 0.0:
                continue
            distance = math.sqrt(squared)
            gap = distance - touch
            ux, uy = ex / distance, ey / distance
            if gap < 0.0:
                part_x += 0.5 * gap * ux
                part_y += 0.5 * gap * uy
            elif gap < TOUCH_M and dx * ux + dy * uy > AHEAD * length:
                comes = dx * command[w, j, 0] + dy * command[w, j, 1] < 0.0
                bodies.met[w, i] = bodies.met[w, i] or comes
            may = share * max(0.0, gap)
            if may < most:
                least = min(least, may)
                if planes < PLANES:
                    plane[planes, 0], plane[planes, 1], plane[planes, 2] = ux, uy, may
                planes += 1
    if slots.blocked[w, i] > RESTLESS_S or slots.aside[w, i] > 0.0:
        dx, dy = _turned(dx, dy, x, y, tick, slots.blocked[w, i], slots.aside[w, i])
    parting = math.sqrt(part_x * part_x + part_y * part_y)
    if parting > 0.0:
        scale = min(1.0, part / parting)
        dx, dy = dx + scale * part_x, dy + scale * part_y
    cell = cell_of(x, y, (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows))
    first, stop = walls.step_start[cell], walls.step_start[cell + 1]
    if most + bodies.radius + REACH_M < walls.clear[cell]:
        stop = first  # no wall is within reach
    bodiless = planes
    for m in range(first, stop):
        s = walls.step_segment[m]
        ex, ey = _to_segment(x, y, walls.segments[s])
        distance = math.sqrt(ex * ex + ey * ey)
        may = max(0.0, distance - bodies.radius)
        if distance > 0.0 and may < most:
            least = min(least, may)
            if planes < PLANES:
                plane[planes, 0], plane[planes, 1] = ex / distance, ey / distance
                plane[planes, 2] = may
            planes += 1
    for m in range(bodiless, min(planes, PLANES)):
        if dx * plane[m, 0] + dy * plane[m, 1] > plane[m, 2]:
            slots.hit_wall[w, i] = True
    if planes > PLANES:  # more than are considered: a way that all allow in every direction
        length = math.sqrt(dx * dx + dy * dy)
        scale = min(1.0, least / length) if length > 0.0 else 0.0
        dx, dy = dx * scale, dy * scale
    else:
        dx, dy = project(dx, dy, plane, planes)
        if stop > first:  # nobody crosses a wall, not even who began nearer than its radius
            _, _, hit = walk(x, y, dx, dy, walls.segments, walls.step_segment, first, stop)
            if hit:
                dx, dy = 0.0, 0.0
    return dx, dy, bodiless, planes


@subroutine
def _held(cx, cy, dx, dy, plane, bodiless, planes):
    """Share of the command c that was not walked by d, where bodies do not allow all of c.

    The first `bodiless` planes are those of bodies. What the worst of the walls takes away is not
    counted.
    """
    ahead, wall = False, 0.0
    for k in range(min(planes, PLANES)):
        along = cx * plane[k, 0] + cy * plane[k, 1]
        over = along - plane[k, 2]
        if over > 0.0 and k < bodiless:
            ahead = True
        elif over > 0.0:
            wall = max(wall, over * along)
    squared = cx * cx + cy * cy
    if not ahead or squared == 0.0:
        return 0.0
    return max(0.0, squared - wall - max(0.0, dx * cx + dy * cy)) / squared


@subroutine
def _turned(dx, dy, x, y, tick, blocked, aside):
    """The command of somebody who is blocked or keeps to the right."""
    share = (np.float64(blocked) - RESTLESS_S) / (DESPERATE_S - RESTLESS_S)
    angle = max(0.0, share) * (2.0 * uniform(x, y, tick) - 1.0)
    angle = angle * SPREAD_RAD - ASIDE_RAD if aside > 0.0 else angle * math.pi
    cos, sin = math.cos(angle), math.sin(angle)
    return dx * cos - dy * sin, dx * sin + dy * cos


@subroutine
def _to_segment(x, y, segment):
    """Vector from a position to the nearest point of a segment, in metres."""
    ax, ay = segment[0] - x, segment[1] - y
    ex, ey = segment[2] - segment[0], segment[3] - segment[1]
    t = min(1.0, max(0.0, -(ax * ex + ay * ey) / (ex * ex + ey * ey)))
    return ax + t * ex, ay + t * ey
