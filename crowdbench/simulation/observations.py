"""The observation kernel: what each person sees of itself, the walls and the others.

Three versions, float32, every value in [−1, 1], a head and then R rays. `lidar-1`:

- 0, 1: velocity / max_speed
- 2: min(distance to goal, GOAL_RANGE_M) / GOAL_RANGE_M
- 3, 4: cosine and sine of the direction to the goal (1, 0 at the goal itself)
- 5 …: distance along ray k / ray_range, 1 where nothing is nearer. Rays stand at the angles
  2πk/R of the world frame, k = 0 … R − 1.

`lidar-2` is for places whose walls hide goals, and for people who differ. The goal's distance is
that of the shortest way around the walls and its direction that of the next corner of that way,
the goal itself where it is in sight; and

- 5: preferred speed / max_speed
- 6 …: the rays.

`lidar-3` sees the bounds too: a life ends beyond them, nothing stands there, and who walks along
them to a goal leaves by mistake. Between the speed and the rays it has

- 6 … 9: min(distance to the western, eastern, southern, northern bound, ray_range) / ray_range
- 10 …: the rays.

Rays meet walls and the discs of other persons. Who stands inside another's disc sees distance 0
in the half plane towards that person's centre.
"""

import math
from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float32
from numba import njit, prange

from crowdbench.errors import SettingError
from crowdbench.plugins import made, names, part
from crowdbench.simulation.compilation import kernel
from crowdbench.simulation.walls import CELL_M, cell_of

if TYPE_CHECKING:
    from crowdbench.simulation.simulation import Simulation

OBSERVATIONS = {"lidar-1": 5, "lidar-2": 6, "lidar-3": 10}
"""Versions of the observation, and how many values stand before the rays."""
OBSERVATION = "lidar-2"
"""The version that everything shows and takes where none is named."""
GOAL_RANGE_M = 30.0
GOAL_DISTANCE, GOAL_DIRECTION, PREFERRED_SPEED = slice(2, 3), slice(3, 5), slice(5, 6)
"""Where these stand in an observation; the last from `lidar-2` on."""
CHUNK = 10  # persons a thread takes at a time


class Observation(ABC):
    """An observation that another package adds: one of ours, `base`, followed by more numbers."""

    name: ClassVar[str]
    base: ClassVar[str] = OBSERVATION
    """Which of `OBSERVATIONS` comes first."""
    extra: ClassVar[int]
    """How many numbers are added."""

    @abstractmethod
    def observe(self, simulation: "Simulation", out: Float32[np.ndarray, "W N extra"]) -> None:
        """Write the added numbers, in [−1, 1], for everyone alive or just ended.

        `simulation.slots` holds everybody's state, `simulation.observation` what `base` shows.
        """


def known_observations() -> tuple[str, ...]:
    """Names of ours, and of those that others have registered."""
    return (*OBSERVATIONS, *names("observations", OBSERVATIONS))


def observation_of(name: str) -> Observation | None:
    """What others have registered under a name; None for one of ours.

    Raises:
        SettingError: nobody has, or it is no `Observation`.
    """
    if name in OBSERVATIONS:
        return None
    found = made(part("observations", name))
    if not isinstance(found, Observation) or found.base not in OBSERVATIONS or found.extra < 1:
        raise SettingError(
            "observation",
            got=repr(name) if found is None else f"{name!r}, which is {found!r}",
            expected=f"one of {', '.join(known_observations())}",
            hint=""
            if found is None
            else "Others derive from crowdbench.simulation."
            "observations.Observation, with a base among ours and extra numbers.",
        )
    return found


def head_of(name: str) -> int:
    """Numbers before the rays."""
    found = observation_of(name)
    return OBSERVATIONS[name if found is None else found.base]


def size_of(name: str, rays: int) -> int:
    """Numbers in an observation."""
    found = observation_of(name)
    return head_of(name) + rays + (0 if found is None else found.extra)


class Cells(NamedTuple):
    """Cell lists: persons sorted by place, so that the near ones are found without the others."""

    origin: np.ndarray
    """(2,) lower left corner, metres."""
    size: float
    """Edge of a cell, metres."""
    columns: int
    rows: int
    start: np.ndarray
    """(W, C + 2): the persons of cell c are `slot[w, start[c]:start[c + 1]]`."""
    xy: np.ndarray
    """(W, N, 2) float64 positions, sorted."""
    slot: np.ndarray
    """(W, N) their slots."""
    person: np.ndarray
    """(W·N, 2) world and slot of everyone to observe, in one list."""

    @classmethod
    def between(
        cls, worlds: int, slots: int, lower: np.ndarray, upper: np.ndarray, size_m: float
    ) -> "Cells":
        """Empty lists for positions between `lower` and `upper`."""
        columns, rows = (max(1, int(np.ceil(extent / size_m))) for extent in upper - lower)
        return cls(
            origin=lower.astype(np.float64),
            size=size_m,
            columns=columns,
            rows=rows,
            start=np.zeros((worlds, columns * rows + 2), np.int32),
            xy=np.zeros((worlds, slots, 2), np.float64),
            slot=np.zeros((worlds, slots), np.int32),
            person=np.zeros((worlds * slots, 2), np.int32),
        )


@kernel
def observe(
    slots, target, beyond, head, bounds, cells, walls, max_speed, radius, reach, remaining, nearest,
    out,
):  # fmt: skip
    """Write the observation of everyone alive, or ended in this step, into `out` (W, N, head + R).

    `target` (W, N, 2) is where they are to walk, `beyond` (W, N) how far it is from there, and
    `bounds` least and greatest x, least and greatest y. The length of the way to the goal goes into
    `remaining` (W, N), the distance to the nearest person that each sees into `nearest` (W, N),
    infinite for none; both in metres.
    """
    # Arrays are unpacked once: reaching into a bundle costs as much as a ray.
    alive, ended, spawned = slots.alive, slots.ended, slots.spawned
    position, velocity, speed = slots.position, slots.velocity, slots.speed
    start, sorted_xy, sorted_slot, person = cells.start, cells.xy, cells.slot, cells.person
    grid = (cells.origin[0], cells.origin[1], cells.size, cells.columns, cells.rows)
    wall_grid = (walls.origin[0], walls.origin[1], CELL_M, walls.columns, walls.rows)
    cos, sin, lines = walls.cos, walls.sin, walls.lines
    cos32, sin32 = cos.astype(np.float32), sin.astype(np.float32)
    x_min, x_max, y_min, y_max = bounds[0], bounds[1], bounds[2], bounds[3]
    ray_start, meeting = walls.ray_start, walls.meeting
    for w in prange(alive.shape[0]):
        _sort_into_cells(w, alive, ended, position, grid, start, sorted_xy, sorted_slot)
    # One flat list of persons, so that threads share them evenly however they lie in the slots.
    total = 0
    for w in range(alive.shape[0]):
        for at in range(start[w, cells.columns * cells.rows]):
            person[total, 0] = w
            person[total, 1] = sorted_slot[w, at]
            total += 1
    for chunk in prange((total + CHUNK - 1) // CHUNK):
        near = np.empty((alive.shape[1] + 1, 2), np.float32)
        for at in range(chunk * CHUNK, min(total, (chunk + 1) * CHUNK)):
            w, i = person[at, 0], person[at, 1]
            remaining[w, i] = _see_itself(w, i, position, velocity, target, beyond, max_speed, out)
            if head > 5:
                out[w, i, 5] = min(1.0, speed[w, i] / max_speed)
            x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
            if head > 6:
                out[w, i, 6] = _near(x - x_min, reach)
                out[w, i, 7] = _near(x_max - x, reach)
                out[w, i, 8] = _near(y - y_min, reach)
                out[w, i, 9] = _near(y_max - y, reach)
            cell = cell_of(x, y, wall_grid)
            rays = out[w, i, head:]
            _see_walls(x, y, cos, sin, lines, ray_start[cell], ray_start[cell + 1], meeting, reach,
                       rays)  # fmt: skip
            count = _neighbours(w, i, x, y, reach + radius, ended, spawned, grid, start,
                                sorted_xy, sorted_slot, near)  # fmt: skip
            squared = np.float32(np.inf)
            for k in range(count):
                gap = near[k, 0] * near[k, 0] + near[k, 1] * near[k, 1]
                squared = min(squared, gap)
                _see_disc(near[k, 0], near[k, 1], radius, cos32, sin32, rays)
            nearest[w, i] = math.sqrt(squared)
            for k in range(len(rays)):
                rays[k] /= np.float32(reach)


@njit(error_model="numpy")
def _sort_into_cells(w, alive, ended, position, grid, start, sorted_xy, sorted_slot):
    """Counting sort of a world's persons by cell, those who just ended included."""
    size = start.shape[1]
    for c in range(size):
        start[w, c] = 0
    for i in range(alive.shape[1]):
        if alive[w, i] or ended[w, i] != 0:
            start[w, cell_of(position[w, i, 0], position[w, i, 1], grid) + 2] += 1
    for c in range(2, size):
        start[w, c] += start[w, c - 1]
    for i in range(alive.shape[1]):
        if alive[w, i] or ended[w, i] != 0:
            c = cell_of(position[w, i, 0], position[w, i, 1], grid) + 1
            at = start[w, c]
            sorted_xy[w, at, 0] = position[w, i, 0]
            sorted_xy[w, at, 1] = position[w, i, 1]
            sorted_slot[w, at] = i
            start[w, c] = at + 1


@njit(error_model="numpy")
def _see_itself(w, i, position, velocity, target, beyond, max_speed, out):
    gx = np.float64(target[w, i, 0]) - np.float64(position[w, i, 0])
    gy = np.float64(target[w, i, 1]) - np.float64(position[w, i, 1])
    distance = math.sqrt(gx * gx + gy * gy)
    out[w, i, 0] = min(1.0, max(-1.0, velocity[w, i, 0] / max_speed))
    out[w, i, 1] = min(1.0, max(-1.0, velocity[w, i, 1] / max_speed))
    remaining = distance + beyond[w, i]
    out[w, i, 2] = min(remaining, GOAL_RANGE_M) / GOAL_RANGE_M
    out[w, i, 3] = gx / distance if distance > 0.0 else 1.0
    out[w, i, 4] = gy / distance if distance > 0.0 else 0.0
    return remaining


@njit(error_model="numpy")
def _near(distance, reach):
    """0 at a bound and beyond it, 1 where it is out of reach."""
    return min(max(distance, 0.0), reach) / reach


@njit(error_model="numpy")
def _see_walls(x, y, cos, sin, lines, first, stop, meeting, reach, rays):
    """Set each ray to the distance of the nearest wall, or to `reach`."""
    rays[:] = reach
    ray, across, along = -1, 0.0, 0.0
    for m in range(first, stop):
        r, s = meeting[m, 0], meeting[m, 1]
        if r != ray:
            ray, across, along = r, y * cos[r] - x * sin[r], x * cos[r] + y * sin[r]
        if lines[r, s, 2] <= across <= lines[r, s, 3]:
            t = lines[r, s, 0] + lines[r, s, 1] * across - along
            if 0.0 <= t < rays[r]:
                rays[r] = t


@njit(error_model="numpy")
def _neighbours(w, i, x, y, far, ended, spawned, grid, start, sorted_xy, sorted_slot, near):
    """Write where those closer than `far` stand, relative to (x, y), and return how many.

    Who ended sees the crowd of before the entries; who is alive does not see who ended.
    """
    gone = ended[w, i] != 0
    columns = grid[3]
    lowest = cell_of(x - far, y - far, grid)
    highest = cell_of(x + far, y + far, grid)
    count = 0
    for row in range(lowest // columns, highest // columns + 1):
        first = start[w, row * columns + lowest % columns]
        stop = start[w, row * columns + highest % columns + 1]
        for at in range(first, stop):
            dx, dy = sorted_xy[w, at, 0] - x, sorted_xy[w, at, 1] - y
            j = sorted_slot[w, at]
            visible = not spawned[w, j] if gone else ended[w, j] == 0
            # Written always, counted if it is one: a branch here would be guessed wrong half
            # of the time, which costs more.
            near[count, 0] = dx
            near[count, 1] = dy
            count += (dx * dx + dy * dy < far * far) & (j != i) & visible
    return count


@njit(error_model="numpy")
def _see_disc(dx, dy, radius, cos, sin, rays):
    """Shorten the rays that meet the disc of `radius` at (dx, dy).

    Ray k meets it where the disc's centre is less than the radius beside the ray and not behind.
    All rays are tried, without a branch and in float32: vector units do eight at once, which is
    faster than finding the one or two that meet. The distance beside the ray is a difference of
    products rather than of squares, so that grazing rays lose no digits.
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
