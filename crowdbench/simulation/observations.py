"""The versions of the observation, and the kernel of those with rays.

Each is a float32 vector with values in [−1, 1]. `social-1` shows the nearest people and is in the
person's own frame; its parts and its kernel are in `crowdbench.simulation.social`. Those named
`lidar` are in the world frame and end with R rays. They contain, by index:

- 0, 1: velocity / max_speed
- 2: min(length of the way to the goal, GOAL_RANGE_M) / GOAL_RANGE_M. The way is straight in
  `lidar-1` and the shortest path around walls from `lidar-2` on.
- 3, 4: cosine and sine of the direction to the goal, or to the next corner of that path if the goal
  is not in sight (1, 0 at the goal itself)
- 5, from `lidar-2` on: preferred speed / max_speed
- 6 … 9, in `lidar-3`: min(distance to the western, eastern, southern, northern bound, ray_range) /
  ray_range. Trips end at the bounds and rays do not detect them.
- then: distance along ray k / ray_range; 1 if nothing is in range. Ray k = 0 … R − 1 has the angle
  2πk/R in the world frame. The disc of somebody who is `wider` than a person is that much larger.

`lidar-2-contact` and `social-1-contact` begin with the base that their names say and end with two
more values, at `CONTACT`:

- (commanded velocity − walked velocity) / max_speed in the last step, clipped, in the frame of the
  base: what bodies and walls kept the person from walking. The base shows the walked velocity only,
  so that without these values somebody who stands looks the same as somebody who is stopped.

The *goal* is the person's target: its via point until its wait there is over, then its goal (see
`Simulation`). Rays end at walls and at the discs of other people. A person inside another person's
disc sees distance 0 in the half-plane towards the centre of that disc. Actions are in the frame of
the observation.
"""

import math
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float32
from numba import prange

from crowdbench.compilation import Kernel, subroutine
from crowdbench.errors import SettingError, did_you_mean
from crowdbench.plugins import instance_of, names, part
from crowdbench.simulation import social
from crowdbench.simulation.cells import CHUNK, list_persons, neighbours, sort_into_cells
from crowdbench.simulation.state import CrowdState
from crowdbench.simulation.walls import CELL_M, cell_of


@dataclass(frozen=True)
class Version:
    """What is in a built-in version of the observation."""

    head: int
    """Number of values before the rays, or of all values if there are no rays."""
    rays: bool = True
    """Whether it ends with rays. If not, `Settings.rays` and `ray_range_m` do not apply."""
    own_frame: bool = False
    """Whether it and the actions are in the person's own frame: x along its remembered heading, y
    to its left. If not, they are in the world frame."""
    around_walls: bool = True
    """Whether the way to the target leads around walls. If not, it is straight."""


OBSERVATIONS = {
    "lidar-1": Version(5, around_walls=False),
    "lidar-2": Version(6),
    "lidar-3": Version(10),
    "social-1": Version(social.SIZE, rays=False, own_frame=True),
}
"""Built-in versions of the observation."""
OBSERVATION = "lidar-2"
"""Default version."""
GOAL_RANGE_M = social.ROUTE_RANGE_M
"""Goal distances are clipped at this value."""
GOAL_DISTANCE, GOAL_DIRECTION, PREFERRED_SPEED = slice(2, 3), slice(3, 5), slice(5, 6)
"""Slices of an observation with rays. `lidar-1` has no preferred speed."""
CONTACT = slice(-2, None)
"""Slice of the last values of `lidar-2-contact` and `social-1-contact`."""


class Observation(ABC):
    """Base class of observations that begin with one of `OBSERVATIONS` and add numbers to it.

    Those with `contact` in their names are built in, others can be registered.
    """

    name: ClassVar[str]
    base: ClassVar[str] = OBSERVATION
    """Name of the observation that it begins with, one of `OBSERVATIONS`."""
    extra: ClassVar[int]
    """Number of additional values."""

    @abstractmethod
    def observe(self, simulation: CrowdState, out: Float32[np.ndarray, "W N extra"]) -> None:
        """Write the additional values, in [−1, 1], for everyone present or just ended to `out`.

        `simulation.slots` contains the state of everyone, and `simulation.observation` starts with
        the values of `base`.
        """


class _Contact(Observation):
    extra = 2

    def observe(self, simulation: CrowdState, out: Float32[np.ndarray, "W N 2"]) -> None:
        slots, most = simulation.slots, simulation.scene.motion.max_speed_mps
        kept = (slots.commanded - slots.velocity) / most
        own_frame = OBSERVATIONS[self.base].own_frame
        out[:] = social.in_own_frame(kept, slots.heading) if own_frame else kept.clip(-1, 1)


class LidarContact(_Contact):
    """`lidar-2`, and the velocity that bodies and walls took away, in the world frame."""

    name, base = "lidar-2-contact", "lidar-2"


class SocialContact(_Contact):
    """`social-1`, and the velocity that bodies and walls took away, in the own frame."""

    name, base = "social-1-contact", "social-1"


EXTENDED: dict[str, Observation] = {kind.name: kind() for kind in (LidarContact, SocialContact)}
"""Built-in observations that add numbers to one of `OBSERVATIONS`."""
BUILT_IN = (*OBSERVATIONS, *EXTENDED)
"""Names of all built-in observations."""


def known_observations() -> tuple[str, ...]:
    """Names of the built-in and the registered observations."""
    return (*BUILT_IN, *names("observations", BUILT_IN))


def observation_of(name: str) -> Observation | None:
    """What adds numbers to one of `OBSERVATIONS` under this name; None for one of those itself.

    Raises:
        SettingError: the name is unknown, or its object is not a valid `Observation`.
    """
    if name in OBSERVATIONS:
        return None
    if name in EXTENDED:
        return EXTENDED[name]
    found = instance_of(part("observations", name))
    if not isinstance(found, Observation) or found.base not in OBSERVATIONS or found.extra < 1:
        raise SettingError(
            "observation",
            got=repr(name) if found is None else f"{name!r}, which is {found!r}",
            expected=f"one of {', '.join(known_observations())}",
            hint=did_you_mean(name, known_observations())
            if found is None
            else "Derive it from crowdbench.simulation.observations.Observation and set base to "
            f"one of {', '.join(OBSERVATIONS)} and extra to 1 or more.",
        )
    return found


def version_of(name: str) -> Version:
    """The version of this name, or the one that the observation of this name begins with."""
    found = observation_of(name)
    return OBSERVATIONS[name if found is None else found.base]


def head_of(name: str) -> int:
    """Number of values before the rays, or of all built-in values if there are no rays."""
    return version_of(name).head


def size_of(name: str, rays: int) -> int:
    """Number of values in an observation."""
    found, version = observation_of(name), version_of(name)
    return version.head + rays * version.rays + (0 if found is None else found.extra)


@Kernel
def observe(
    slots, target, beyond, head, cells, walls, constants, radius, reach, remaining, nearest, out
):
    """Write the observations of everyone present or ended in this step to `out` (W, N, head + R).

    `target` (W, N, 2) is the next point on the path to the person's target, and `beyond` (W, N) the
    remaining length of the path from there. Also writes the length of the whole path to `remaining`
    (W, N), and the distance to the nearest visible person, less by how much it is `wider`, to
    `nearest` (W, N), infinite if there is none. All lengths are in metres.
    """
    # Arrays are unpacked once, because each access through a bundle costs as much as a ray.
    alive, ended, spawned = slots.alive, slots.ended, slots.spawned
    position, wider = slots.position, slots.wider
    start, sorted_xy, sorted_slot, person = cells.start, cells.xy, cells.slot, cells.person
    grid = (cells.origin[0], cells.origin[1], cells.size, cells.columns, cells.rows)
    cos32, sin32 = walls.cos.astype(np.float32), walls.sin.astype(np.float32)
    widest = np.empty(alive.shape[0])
    for w in prange(alive.shape[0]):
        widest[w] = sort_into_cells(w, alive, ended, position, wider, grid, start, sorted_xy,
                                    sorted_slot)  # fmt: skip
    total = list_persons(cells)
    for chunk in prange((total + CHUNK - 1) // CHUNK):
        near = np.empty((alive.shape[1] + 1, 2), np.float32)
        who = np.empty(alive.shape[1] + 1, np.int32)
        for at in range(chunk * CHUNK, min(total, (chunk + 1) * CHUNK)):
            w, i = person[at, 0], person[at, 1]
            me = out[w, i]
            remaining[w, i] = see_itself(w, i, slots, target, beyond, head, reach, constants, me)
            x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
            rays = me[head:]
            see_walls(x, y, walls, reach, rays)
            count = neighbours(w, i, x, y, reach + radius + widest[w], ended, spawned, grid, start,
                               sorted_xy, sorted_slot, near, who)  # fmt: skip
            squared = np.float32(np.inf)
            for k in range(count):
                wide = np.float64(wider[w, who[k]])
                gap = see_person(near[k, 0], near[k, 1], wide, radius, cos32, sin32, rays)
                squared = min(squared, gap)
            nearest[w, i] = math.sqrt(squared)
            for k in range(len(rays)):
                rays[k] /= np.float32(reach)


@subroutine
def see_itself(w, i, slots, target, beyond, head, reach, constants, me):
    """Write the parts before the rays to `me` and return the length of the path in metres."""
    position, velocity, max_speed = slots.position, slots.velocity, constants.max_speed
    x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
    gx, gy = np.float64(target[w, i, 0]) - x, np.float64(target[w, i, 1]) - y
    distance = math.sqrt(gx * gx + gy * gy)
    me[0] = min(1.0, max(-1.0, velocity[w, i, 0] / max_speed))
    me[1] = min(1.0, max(-1.0, velocity[w, i, 1] / max_speed))
    remaining = distance + beyond[w, i]
    me[2] = min(remaining, GOAL_RANGE_M) / GOAL_RANGE_M
    me[3] = gx / distance if distance > 0.0 else 1.0
    me[4] = gy / distance if distance > 0.0 else 0.0
    if head > 5:
        me[5] = min(1.0, slots.speed[w, i] / max_speed)
    if head > 6:
        me[6] = _near(x - constants.x_min, reach)
        me[7] = _near(constants.x_max - x, reach)
        me[8] = _near(y - constants.y_min, reach)
        me[9] = _near(constants.y_max - y, reach)
    return remaining


@subroutine
def _near(distance, reach):
    """Scaled distance to a bound: 0 at and beyond the bound, 1 at `reach` or more."""
    return min(max(distance, 0.0), reach) / reach


@subroutine
def see_walls(x, y, walls, reach, rays):
    """Set each ray to the distance of the nearest wall, at most `reach`."""
    cos, sin, lines, meeting = walls.cos, walls.sin, walls.lines, walls.meeting
    cell = cell_of(x, y, (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows))
    for k in range(len(rays)):
        rays[k] = reach
    ray, across, along = -1, 0.0, 0.0
    for m in range(walls.ray_start[cell], walls.ray_start[cell + 1]):
        r, s = meeting[m, 0], meeting[m, 1]
        if r != ray:
            ray, across, along = r, y * cos[r] - x * sin[r], x * cos[r] + y * sin[r]
        if lines[r, s, 2] <= across <= lines[r, s, 3]:
            t = lines[r, s, 0] + lines[r, s, 1] * across - along
            if 0.0 <= t < rays[r]:
                rays[r] = t


@subroutine
def see_person(dx, dy, wide, radius, cos, sin, rays):
    """Shorten the rays that hit somebody at (dx, dy) who is `wide` metres wider than a person.

    Returns the square of the distance, less by how much it is wider.
    """
    gap = dx * dx + dy * dy
    _see_disc(dx, dy, radius + wide, cos, sin, rays)
    if wide > 0.0:
        gap = np.float32(max(0.0, math.sqrt(gap) - wide) ** 2)
    return gap


@subroutine
def _see_disc(dx, dy, radius, cos, sin, rays):
    """Shorten the rays that hit the disc of `radius` at (dx, dy).

    A ray hits the disc if the centre is ahead and its perpendicular distance from the ray is at
    most the radius. All rays are tested without branches and in float32: vector units process
    eight at a time, which is faster than finding the one or two that hit. The perpendicular
    distance is a difference of products rather than of squares, to keep precision for grazing rays.
    """
    zero = np.float32(0.0)
    squared = np.float32(radius * radius)
    for k in range(cos.shape[0]):
        along = dx * cos[k] + dy * sin[k]
        beside = dx * sin[k] - dy * cos[k]
        within = squared - beside * beside
        t = along - np.float32(math.sqrt(within if within > zero else zero))
        t = t if t > zero else zero
        before = rays[k]
        meets = (within >= zero) & (along >= zero) & (t < before)
        rays[k] = t if meets else before
