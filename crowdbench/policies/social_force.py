"""`social-force`: the social force model of Helbing & Molnár (1995), Physical Review E 51, 4282.

Forces are integrated in steps of 0.05 s for the whole crowd; the action is the mean velocity over
the frame.

Whoever is wider than a person, such as a robot, repels people as if it were nearer by as much.

The direction e of another person's next step in eq. 4 is its direction of motion. If it were the
direction to its goal, people who push each other aside would circle each other forever.
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

COS_OF_VIEW = math.cos(math.radians(100.0))  # φ, half of 200°
FASTEST = 1.3  # maximum speed as a multiple of the preferred speed, eq. 11
REACH_M = 5.0  # repulsions beyond this distance, which are below V⁰/σ·e⁻⁷, are omitted
SUBSTEP_S = 0.05
LEAST_M = 0.01  # of a distance to a wide body, which keeps its direction
GATHERING = 3.0  # β₂ of Moussaïd et al. (2010), m/s²
SEPARATION = 1.0  # β₃, m/s²
SEPARATE_M = 0.6  # two radii: companions who are nearer overlap


class Forces(NamedTuple):
    """Parameters of social forces."""

    relaxation_s: float
    """τ of eq. 2: time in which a person takes up its preferred velocity."""
    repulsion: float
    """V⁰ of eq. 13, in m²/s²: strength of the repulsion by people."""
    repulsion_range_m: float
    """σ."""
    step_s: float
    """Δt of eq. 4: time for which others' next steps are anticipated."""
    wall: float
    """U⁰ of eq. 13, in m²/s²: strength of the repulsion by walls."""
    wall_range_m: float
    """R."""
    behind: float
    """c of eq. 8: weight of people out of view."""


PUBLISHED = Forces(0.5, 2.1, 0.3, 2.0, 10.0, 0.2, 0.5)
"""The parameters of the paper (Sec. III)."""


class SocialForce:
    """Walkers attracted by their goals and repelled by each other and by walls."""

    name = "social-force"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True
    many_worlds: ClassVar[bool] = True
    groups: ClassVar[bool] = False
    """Whether companions stay together; otherwise everyone is repelled by everyone."""

    def __init__(self, forces: Forces = PUBLISHED) -> None:
        self.forces = forces

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`."""
        self._scene = scene
        self._walls = np.array(scene.wall_of_segment, dtype=np.int32)
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocities (A, 2) over the frame, in units of the maximum speed."""
        dt_s = self._scene.dt_s
        towards = seen.towards(self._routes)
        speed = seen.wanted_mps(dt_s)
        nobody = np.full(len(seen.slot), -1, np.int32)
        fastest = FASTEST * dt_s
        wider = seen.wider.astype(np.float64)
        displacement = _walk(
            seen.world,
            seen.position.astype(np.float64),
            seen.velocity.astype(np.float64),
            towards,
            speed,
            self._scene.wall_segments,
            self._walls,
            max(1, round(dt_s / SUBSTEP_S)),
            dt_s,
            seen.group if self.groups else nobody,
            np.lexsort((seen.position[:, 0], seen.world)),
            REACH_M + fastest * (speed + speed.max(initial=0.0)) + wider + wider.max(initial=0.0),
            REACH_M + fastest * speed,
            wider,
            self.forces,
        )
        return (displacement / (dt_s * self._scene.motion.max_speed_mps)).astype(np.float32)


class GroupForce(SocialForce):
    """Social forces for people who walk in groups.

    Companions do not repel each other. Instead they are drawn to the middle of their group if they
    are further than (members − 1) / 2 metres from it, and move apart if they overlap: the forces of
    Moussaïd et al. (2010), PLoS ONE 5, e10047, without that of gazing. By default, the other
    forces have the published parameters, with which the recording of the plaza was made.
    """

    name = "group-force"
    groups = True

    def __init__(self, forces: Forces = PUBLISHED) -> None:
        super().__init__(forces)


@compiled
def _walk(
    world, position, velocity, goal, speed, segments, walls, substeps, dt, group, by_x, reach,
    wall_reach, wider, forces,
):  # fmt: skip
    """Displacements (A, 2) in `dt` seconds, in metres; `world` must be in ascending order.

    `by_x` (A,) are the persons in the order of x, world by world. `reach` and `wall_reach` (A,) are
    the distances up to which others and walls can act on each person in the frame. `wider` (A,) is
    by how much radii exceed that of a person, in metres.
    """
    h = dt / substeps
    start = position.copy()
    size = len(world)
    heading = np.zeros((size, 2))
    force = np.zeros((size, 2))
    near, count = walls_near(position, wall_reach, segments)
    others, begins = people_near(world, position, reach, group, by_x)
    for _ in range(substeps):
        for a in range(size):
            gx, gy = goal[a, 0] - position[a, 0], goal[a, 1] - position[a, 1]
            distance = math.sqrt(gx * gx + gy * gy)
            if distance > 0.0:
                heading[a, 0], heading[a, 1] = gx / distance, gy / distance
        for a in range(size):
            fx = (speed[a] * heading[a, 0] - velocity[a, 0]) / forces.relaxation_s
            fy = (speed[a] * heading[a, 1] - velocity[a, 1]) / forces.relaxation_s
            mx, my, members = 0.0, 0.0, 1  # sum of the vectors to the companions
            for b in others[begins[a] : begins[a + 1]]:
                rx, ry = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
                if group[a] >= 0 and group[a] == group[b]:
                    mx, my, members = mx - rx, my - ry, members + 1
                    r = math.sqrt(rx * rx + ry * ry)
                    if 0.0 < r < SEPARATE_M:
                        fx, fy = fx + SEPARATION * rx / r, fy + SEPARATION * ry / r
                    continue
                excess = wider[a] + wider[b]
                if excess > 0.0:
                    rx, ry = nearer(rx, ry, excess)
                if rx * rx + ry * ry < REACH_M * REACH_M:
                    sx, sy = velocity[b, 0] * forces.step_s, velocity[b, 1] * forces.step_s
                    px, py = repulsion(rx, ry, sx, sy, forces)
                    toward = -(heading[a, 0] * px + heading[a, 1] * py)
                    seen = toward >= math.sqrt(px * px + py * py) * COS_OF_VIEW
                    weight = 1.0 if seen else forces.behind
                    fx += weight * px
                    fy += weight * py
            away = math.sqrt(mx * mx + my * my) / members
            if away > 0.5 * (members - 1):
                fx += GATHERING * mx / (members * away)
                fy += GATHERING * my / (members * away)
            wx, wy = wall_force(
                position[a, 0], position[a, 1], segments, walls, near[a, : count[a]], forces
            )
            force[a, 0], force[a, 1] = fx + wx, fy + wy
        for a in range(size):
            vx, vy = velocity[a, 0] + h * force[a, 0], velocity[a, 1] + h * force[a, 1]
            v = math.sqrt(vx * vx + vy * vy)
            scale = min(1.0, FASTEST * speed[a] / v) if v > 0.0 else 1.0
            velocity[a, 0], velocity[a, 1] = vx * scale, vy * scale
            position[a, 0] += h * velocity[a, 0]
            position[a, 1] += h * velocity[a, 1]
    return position - start


@compiled
def nearer(rx, ry, by):
    """The vector r shortened by a length, but not to less than 1 cm, to keep its direction."""
    length = math.sqrt(rx * rx + ry * ry)
    scale = max(LEAST_M, length - by) / length if length > 0.0 else 0.0
    return scale * rx, scale * ry


@compiled
def repulsion(rx, ry, sx, sy, forces):
    """Force −∇V(b) on a person at r from another at 0 whose next step is s, eqs. 3 and 4.

    2b = √((|r| + |r − s|)² − |s|²) is the minor axis of the ellipse whose foci are the other
    person's present and next positions; ∇b = (|r| + |r − s|) (r/|r| + (r − s)/|r − s|) / 4b.
    """
    tx, ty = rx - sx, ry - sy
    r, t = math.sqrt(rx * rx + ry * ry), math.sqrt(tx * tx + ty * ty)
    both = r + t
    b = 0.5 * math.sqrt(max(0.0, both * both - sx * sx - sy * sy))
    if r < 1e-6 or t < 1e-6 or b < 1e-6:
        return 0.0, 0.0  # same position, or on the line of the step: the direction is undefined
    strength = forces.repulsion / forces.repulsion_range_m * math.exp(-b / forces.repulsion_range_m)
    strength = strength * both / (4.0 * b)
    return strength * (rx / r + tx / t), strength * (ry / r + ty / t)


@compiled
def wall_force(x, y, segments, walls, near, forces):
    """Sum over walls of the repulsion −∇U from each wall's nearest point, eq. 5."""
    fx, fy = 0.0, 0.0
    k = 0
    while k < len(near):
        nx, ny, distance, k = from_wall(x, y, segments, walls, near, k)
        if 0.0 < distance < REACH_M:
            push = forces.wall / forces.wall_range_m * math.exp(-distance / forces.wall_range_m)
            push /= distance
            fx += push * nx
            fy += push * ny
    return fx, fy
