"""Scalar functions for the step of a single person.

They use no arrays of agents, so that the same source can be compiled for other devices.
"""

import math

import numpy as np

from crowdbench.compilation import subroutine

STOP_M = 1e-3  # distance of a stopped person from the wall, far above float32 rounding
AHEAD_M = 10 * STOP_M  # distance beyond the end of a move at which a wall can still stop it
JOINT = 1e-9  # share of its length by which a segment is extended, to close gaps at joints


@subroutine
def command(action_x, action_y, max_speed):
    """Velocity in m/s of an action, clipped to [−1, 1]² and then to `max_speed`."""
    x = min(1.0, max(-1.0, action_x))
    y = min(1.0, max(-1.0, action_y))
    length = math.sqrt(x * x + y * y)
    scale = max_speed / max(1.0, length)
    return x * scale, y * scale


@subroutine
def to_own_frame(x, y, cos, sin):
    """The vector (x, y) of the world frame in the own frame of a person with heading (cos, sin)."""
    return x * cos + y * sin, y * cos - x * sin


@subroutine
def from_own_frame(x, y, cos, sin):
    """The vector (x, y) of the own frame of a person with heading (cos, sin) in the world frame."""
    return x * cos - y * sin, y * cos + x * sin


@subroutine
def distance_to_segment(px, py, ax, ay, bx, by):
    """Distance from the point p to the segment from a to b, in metres."""
    dx, dy = bx - ax, by - ay
    squared = dx * dx + dy * dy
    t = 0.0
    if squared > 0.0:
        t = ((px - ax) * dx + (py - ay) * dy) / squared
        t = min(1.0, max(0.0, t))
    return math.sqrt((px - ax - t * dx) ** 2 + (py - ay - t * dy) ** 2)


@subroutine
def crossing(px, py, dx, dy, ax, ay, bx, by):
    """Fraction of the move d from p at which it meets the segment a–b; infinite if it does not.

    A move that ends in front of the segment but within the clearance also meets it, at a fraction
    above 1: after rounding to float32, its end could lie behind the segment.
    """
    ex, ey = bx - ax, by - ay
    cross = dx * ey - dy * ex
    if cross == 0.0:
        return np.inf
    along_move = ((ax - px) * ey - (ay - py) * ex) / cross
    along_wall = ((ax - px) * dy - (ay - py) * dx) / cross
    if along_move < 0.0 or along_wall < -JOINT or along_wall > 1.0 + JOINT:
        return np.inf
    beyond = along_move - 1.0
    if beyond <= 0.0:
        return along_move
    close = (beyond * cross) ** 2 < STOP_M**2 * (ex * ex + ey * ey)
    ahead = beyond**2 * (dx * dx + dy * dy) < AHEAD_M**2
    return along_move if close and ahead else np.inf


@subroutine
def walk(px, py, dx, dy, segments, near, start, stop):
    """Move p by d: stop before the first wall and slide along it with the rest of the move.

    `near[start:stop]` are the indices of the segments (x0, y0, x1, y1) that may be met. Returns x,
    y and whether a wall was hit. The move never crosses a segment.
    """
    hit = False
    for _ in range(3):  # at most two slides: along a wall and along the next wall of a corner
        first, wall = np.inf, -1
        for k in range(start, stop):
            s = near[k]
            t = crossing(
                px, py, dx, dy, segments[s, 0], segments[s, 1], segments[s, 2], segments[s, 3]
            )
            if t < first:
                first, wall = t, s
        if wall < 0:
            return px + dx, py + dy, hit
        hit = True
        ex = segments[wall, 2] - segments[wall, 0]
        ey = segments[wall, 3] - segments[wall, 1]
        length = math.sqrt(ex * ex + ey * ey)
        ex, ey = ex / length, ey / length
        into_wall = abs(dx * ey - dy * ex)
        # Step back along the move, so that no other wall can be in between.
        t = max(0.0, first - STOP_M / into_wall)
        px, py = px + t * dx, py + t * dy
        along = (1.0 - t) * (dx * ex + dy * ey)
        dx, dy = along * ex, along * ey
    return px, py, hit


@subroutine
def uniform(x, y, tick):
    """A number in [0, 1) from a position in metres and a count, by mixing their bits.

    The mixing is that of MurmurHash3's 64-bit finalizer.
    """
    h = np.uint64(tick)
    for part in (np.int64(x * 1073741824.0), np.int64(y * 1073741824.0)):
        h = (h ^ np.uint64(part)) * np.uint64(0xFF51AFD7ED558CCD)
        h ^= h >> np.uint64(33)
        h *= np.uint64(0xC4CEB9FE1A85EC53)
        h ^= h >> np.uint64(33)
    return np.float64(h >> np.uint64(11)) / 9007199254740992.0


@subroutine
def segments_apart(ax, ay, bx, by, cx, cy, dx, dy):
    """Distance between the segments a–b and c–d, which must not cross."""
    one = min(distance_to_segment(ax, ay, cx, cy, dx, dy),
              distance_to_segment(bx, by, cx, cy, dx, dy))  # fmt: skip
    other = min(distance_to_segment(cx, cy, ax, ay, bx, by),
                distance_to_segment(dx, dy, ax, ay, bx, by))  # fmt: skip
    return min(one, other)


@subroutine
def crosses(x, y, to_x, to_y, segment):
    """Whether a wall segment crosses the line from (x, y) to (to_x, to_y)."""
    dx, dy = to_x - x, to_y - y
    ax, ay = segment[0] - x, segment[1] - y
    bx, by = segment[2] - x, segment[3] - y
    # They cross if the ends of the segment are on different sides of the line and the ends of the
    # line on different sides of the segment. A line through an end of the segment is blocked too.
    side_a, side_b = dx * ay - dy * ax, dx * by - dy * bx
    if side_a * side_b <= 0.0:
        ex, ey = bx - ax, by - ay
        here = ay * ex - ax * ey
        there = here - (dy * ex - dx * ey)
        return here * there < 0.0
    return False
