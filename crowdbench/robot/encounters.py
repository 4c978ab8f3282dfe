"""People during a control period: where they are, and whom a robot touches.

People walk in frames of the scene, and a robot in control periods, of which one or several fill a
frame. Within it people go straight from their positions before it to those after it.
"""

import math
from typing import NamedTuple

import numpy as np

from crowdbench.compilation import compiled

GRAZE_M = 0.06
"""People with bodies slide around a robot on an arc. The straight way that is assumed within a
frame cuts off as much of it if they walk 0.55 m around a circle with a radius of 0.6 m."""
ROUNDING_M = 1e-3


class Present(NamedTuple):
    """The people in the worlds at one time; W worlds of P slots, the robot's left out."""

    there: np.ndarray
    """(W, P) bool."""
    position: np.ndarray
    """(W, P, 2) float64 in metres."""
    velocity: np.ndarray
    """(W, P, 2) float64 in m/s."""
    touching: np.ndarray
    """(W, P) bool: whether the robot touches the person, or did when it entered or began."""

    @classmethod
    def nobody(cls, worlds: int, people: int) -> "Present":
        """Worlds without people."""
        shape = (worlds, people)
        return cls(
            there=np.zeros(shape, np.bool_),
            position=np.zeros((*shape, 2)),
            velocity=np.zeros((*shape, 2)),
            touching=np.zeros(shape, np.bool_),
        )


class Encounter(NamedTuple):
    """What happened between robots and people in a control period; each array is (W,)."""

    contacts: np.ndarray
    """Number of people whom the robot began to touch."""
    gap: np.ndarray
    """Distance from the robot's surface to that of the nearest person at the end of the period, in
    metres; infinite if nobody is there, negative where they overlap."""
    collision_s: np.ndarray
    """Time to collision at the end: the first time at which the robot would touch somebody if all
    kept their velocities, in seconds; infinite if it would touch nobody."""

    @classmethod
    def none(cls, worlds: int) -> "Encounter":
        """Nothing has happened."""
        return cls(np.zeros(worlds, np.int64), np.full(worlds, np.inf), np.full(worlds, np.inf))


@compiled
def meet(
    worlds, since, until, before, was_there, alive, position, velocity, robot_before, robot,
    robot_velocity, reach, graze, present, encounter,
):  # fmt: skip
    """Walk people from the share `since` of a frame to the share `until`, past the robots.

    Within the period people and robots move straight, so a contact between its ends is noticed.
    People who enter appear at the end of the frame. Somebody who enters within reach of the robot
    does not collide with it before they have been apart.

    Args:
        worlds: (n,) indices of worlds.
        since: share of the frame at the beginning of the period; `since` = `until` = 1 puts
            everyone where they are after the frame, without contacts.
        until: share of the frame at its end, at most 1.
        before: (W, P, 2) positions at the beginning of the frame, in metres.
        was_there: (W, P) who was there then.
        alive: (W, N) who is there after the frame.
        position: (W, N, 2) positions after the frame, in metres.
        velocity: (W, N, 2) velocities in the frame, in m/s.
        robot_before: (W, 2) the robots' positions at the beginning of the period, in metres.
        robot: (W, 2) those at its end.
        robot_velocity: (W, 2) velocities at its end, in m/s.
        reach: sum of the radii of a robot and a person, in metres.
        graze: overlap on the way that is no contact, in metres.
        present: `Present`, which is written.
        encounter: `Encounter`, which is written.
    """
    there, at, speed, touching = (
        present.there, present.position, present.velocity, present.touching,
    )  # fmt: skip
    for w in worlds:
        contacts, gap, soonest = 0, np.inf, np.inf
        rx, ry = robot[w, 0], robot[w, 1]
        for i in range(was_there.shape[1]):
            remains = alive[w, i] if until == 1.0 else was_there[w, i]
            walks = was_there[w, i] and since < until
            if not (remains or walks):
                there[w, i] = touching[w, i] = False
                continue
            to_x, to_y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
            if until < 1.0:
                x, y = np.float64(before[w, i, 0]), np.float64(before[w, i, 1])
                to_x, to_y = x + until * (to_x - x), y + until * (to_y - y)
            dx, dy = to_x - rx, to_y - ry
            off = math.sqrt(dx * dx + dy * dy)
            if walks and there[w, i]:
                ox, oy = at[w, i, 0] - robot_before[w, 0], at[w, i, 1] - robot_before[w, 1]
                touches = _nearest(ox, oy, dx - ox, dy - oy) < reach - graze - ROUNDING_M
                touches = touches or (until == 1.0 and off < reach - ROUNDING_M)
                contacts += touches and not touching[w, i]
            touching[w, i] = off < reach - ROUNDING_M
            there[w, i] = remains
            if not remains:
                touching[w, i] = False
                continue
            at[w, i, 0], at[w, i, 1] = to_x, to_y
            vx, vy = np.float64(velocity[w, i, 0]), np.float64(velocity[w, i, 1])
            speed[w, i, 0], speed[w, i, 1] = vx, vy
            gap = min(gap, off - reach)
            after = _until_contact(
                dx, dy, vx - robot_velocity[w, 0], vy - robot_velocity[w, 1], reach
            )
            soonest = min(soonest, after)
        encounter.contacts[w] = contacts
        encounter.gap[w] = gap
        encounter.collision_s[w] = soonest


@compiled
def _nearest(x, y, dx, dy):
    """Least distance from the origin on the straight way from (x, y) by d."""
    squared = dx * dx + dy * dy
    share = 0.0
    if squared > 0.0:
        share = min(1.0, max(0.0, -(x * dx + y * dy) / squared))
    return math.hypot(x + share * dx, y + share * dy)


@compiled
def _until_contact(x, y, vx, vy, reach):
    """Time until a point at (x, y) with the velocity v is within reach of the origin."""
    if x * x + y * y <= reach * reach:
        return 0.0
    towards, squared = -(x * vx + y * vy), vx * vx + vy * vy
    if towards <= 0.0:
        return np.inf
    # |p + v t|² = reach²: t² v² − 2 t towards + p² − reach² = 0
    rest = towards * towards - squared * (x * x + y * y - reach * reach)
    if rest < 0.0:
        return np.inf
    return (towards - math.sqrt(rest)) / squared
