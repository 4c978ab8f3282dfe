"""`speed-model`: the collision-free speed model of Tordeux, Chraibi & Seyfried (2016).

Traffic and Granular Flow '15, 225; arXiv 1512.05597. Repulsion by walls is that of JuPedSim's
`CollisionFreeSpeedModel`. A person chooses a direction, away from near people and walls, and walks
at its preferred speed or slower, so that the gap ahead would close in the time T:

    direction ∝ e₀ + a Σ exp((ℓ − d) / D) e + a_w Σ exp((ℓ/2 − d_w) / D_w) e_w
    speed = min(v₀, max(0, (d_ahead − ℓ) / T))

e₀ is the direction of the way around walls, e points away from somebody at the distance d, and
d_ahead is the distance to the nearest person ahead, whose body would be touched on the way.
For somebody who is wider than a person, such as a robot, ℓ is larger by as much.

Positions are integrated in steps of 0.05 s for the whole crowd; the action is the mean velocity
over the frame.
"""

import math
from typing import ClassVar, Literal, NamedTuple

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.compilation import compiled
from crowdbench.policies.near import from_wall, people_near, walls_near
from crowdbench.policies.policy import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes

REACH_M = 3.0
"""Distance beyond which nobody is considered, as in JuPedSim, in metres."""
SUBSTEP_S = 0.05


class Gaps(NamedTuple):
    """Parameters of the collision-free speed model."""

    time_gap_s: float
    """T: time in which the gap ahead would close."""
    length_m: float
    """ℓ: diameter of a person."""
    repulsion: float
    """a: strength of the repulsion by people, relative to the pull of the way."""
    repulsion_range_m: float
    """D."""
    wall: float
    """a_w: strength of the repulsion by walls."""
    wall_range_m: float
    """D_w."""


PUBLISHED = Gaps(1.0, 0.4, 8.0, 0.1, 5.0, 0.02)
"""The defaults of JuPedSim 1.4."""
FOUND = Gaps(0.708, 0.263, 0.909, 0.779, 2.44, 0.0902)
"""Those that the search `crowdbench.baselines.social_force` finds, see `docs/baselines.md`.

With bodies of 0.15 m radius, crowds pass the door, the corner and the counterflow of the exam. With
the published ones, two crowds in a corridor block each other."""


class SpeedModel:
    """Walkers whose speed follows from the gap ahead."""

    name = "speed-model"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True
    many_worlds: ClassVar[bool] = True

    def __init__(self, gaps: Gaps = FOUND) -> None:
        self.gaps = gaps

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`; there are no random draws."""
        self._scene = scene
        self._walls = np.array(scene.wall_of_segment, dtype=np.int32)
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocities (A, 2) over the frame, in units of the maximum speed."""
        dt_s = self._scene.dt_s
        speed = seen.wanted_mps(dt_s)
        wider = seen.wider.astype(np.float64)
        displacement = _walk(
            seen.world,
            seen.position.astype(np.float64),
            seen.towards(self._routes),
            speed,
            self._scene.wall_segments,
            self._walls,
            max(1, round(dt_s / SUBSTEP_S)),
            dt_s,
            np.full(len(seen.slot), -1, np.int32),
            np.lexsort((seen.position[:, 0], seen.world)),
            REACH_M + dt_s * (speed + speed.max(initial=0.0)) + wider + wider.max(initial=0.0),
            REACH_M + dt_s * speed,
            wider,
            self.gaps,
        )
        return (displacement / (dt_s * self._scene.motion.max_speed_mps)).astype(np.float32)


@compiled
def _walk(
    world, position, goal, speed, segments, walls, substeps, dt, nobody, by_x, reach, wall_reach,
    wider, gaps,
):  # fmt: skip
    """Displacements (A, 2) in `dt` seconds, in metres; arguments as those of social forces."""
    h = dt / substeps
    start = position.copy()
    size = len(world)
    moved = np.zeros((size, 2))
    near, count = walls_near(position, wall_reach, segments)
    others, begins = people_near(world, position, reach, nobody, by_x)
    for _ in range(substeps):
        for a in range(size):
            x, y = position[a, 0], position[a, 1]
            gx, gy = goal[a, 0] - x, goal[a, 1] - y
            distance = math.sqrt(gx * gx + gy * gy)
            most = min(speed[a], distance / h)  # nobody walks beyond its goal or a corner
            if distance > 0.0:
                gx, gy = gx / distance, gy / distance
            around = others[begins[a] : begins[a + 1]]
            px, py = _push_by_people(a, position, around, wider, gaps)
            wx, wy = _push_by_walls(x, y, segments, walls, near[a, : count[a]], gaps)
            dx, dy = gx + px + wx, gy + py + wy
            length = math.sqrt(dx * dx + dy * dy)
            if length > 0.0:
                dx, dy = dx / length, dy / length
            gap = _gap(a, dx, dy, position, around, wider, gaps)
            v = min(most, max(0.0, gap) / gaps.time_gap_s)
            moved[a, 0], moved[a, 1] = v * dx, v * dy
        for a in range(size):
            position[a, 0] += h * moved[a, 0]
            position[a, 1] += h * moved[a, 1]
    return position - start


@compiled
def _push_by_people(a, position, others, wider, gaps):
    """Sum of the repulsions of person a by others."""
    px, py = 0.0, 0.0
    for b in others:
        rx, ry = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
        r = math.sqrt(rx * rx + ry * ry)
        excess = wider[a] + wider[b]
        if 0.0 < r < REACH_M + excess:
            touch = gaps.length_m + excess
            push = gaps.repulsion * math.exp((touch - r) / gaps.repulsion_range_m) / r
            px += push * rx
            py += push * ry
    return px, py


@compiled
def _push_by_walls(x, y, segments, walls, near, gaps):
    """Sum of the repulsions by the nearest points of walls."""
    px, py = 0.0, 0.0
    k = 0
    while k < len(near):
        nx, ny, r, k = from_wall(x, y, segments, walls, near, k)
        if 0.0 < r < REACH_M:
            push = gaps.wall * math.exp((0.5 * gaps.length_m - r) / gaps.wall_range_m) / r
            px += push * nx
            py += push * ny
    return px, py


@compiled
def _gap(a, dx, dy, position, others, wider, gaps):
    """Free way of person a in the direction d up to the nearest person ahead; infinite if none.

    A person is ahead if its centre is not behind and at most the sum of both radii aside.
    """
    gap = np.inf
    for b in others:
        rx, ry = position[b, 0] - position[a, 0], position[b, 1] - position[a, 1]
        touch = gaps.length_m + wider[a] + wider[b]
        if dx * rx + dy * ry >= 0.0 and abs(dx * ry - dy * rx) <= touch:
            gap = min(gap, math.sqrt(rx * rx + ry * ry) - touch)
    return gap
