"""`social-force`: the social force model of Helbing & Molnár (1995), Physical Review E 51, 4282.

The parameters are those of the paper (Sec. III). Forces are integrated in steps of 0.05 s for the
whole crowd; the action is the mean velocity over the frame.

The direction e of another person's next step in eq. 4 is its direction of motion. If it were the
direction to its goal, people who push each other aside would circle each other forever.
"""

import math
from typing import ClassVar, Literal

import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.compilation import compiled
from crowdbench.policies.policy import StateView
from crowdbench.scene import Scene
from crowdbench.simulation.routes import Routes

RELAXATION_S = 0.5  # τ, eq. 2
REPULSION = 2.1  # V⁰, m²/s², eq. 13
REPULSION_RANGE_M = 0.3  # σ
STEP_S = 2.0  # Δt, the time for which others' next steps are anticipated, eq. 4
WALL = 10.0  # U⁰, m²/s², eq. 13
WALL_RANGE_M = 0.2  # R
COS_OF_VIEW = math.cos(math.radians(100.0))  # φ, half of 200°
BEHIND = 0.5  # c, the weight of people out of view, eq. 8
FASTEST = 1.3  # maximum speed as a multiple of the preferred speed, eq. 11
REACH_M = 5.0  # repulsions beyond this distance, which are below V⁰/σ·e⁻⁷, are omitted
SUBSTEP_S = 0.05
GATHERING = 3.0  # β₂ of Moussaïd et al. (2010), m/s²
SEPARATION = 1.0  # β₃, m/s²
SEPARATE_M = 0.6  # two radii: companions who are nearer overlap


class SocialForce:
    """Walkers attracted by their goals and repelled by each other and by walls."""

    name = "social-force"
    sees: ClassVar[Literal["state"]] = "state"
    deterministic: ClassVar[bool] = True
    many_worlds: ClassVar[bool] = True
    groups: ClassVar[bool] = False
    """Whether companions stay together; otherwise everyone is repelled by everyone."""

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the walls of `scene`."""
        self._scene = scene
        self._walls = np.array(scene.wall_of_segment, dtype=np.int32)
        self._routes = Routes.on(scene)

    def act(self, seen: StateView) -> Float32[np.ndarray, "A 2"]:
        """Mean velocities (A, 2) over the frame, in units of the maximum speed."""
        dt_s = self._scene.dt_s
        towards = seen.towards(self._routes)
        # People stay at a via point until their wait is over.
        speed = seen.speed.astype(np.float64)
        visits = (seen.target != seen.goal).any(axis=1)
        rest = np.linalg.norm(seen.target - seen.position, axis=1) / dt_s
        speed[visits] = np.minimum(speed, rest)[visits]
        nobody = np.full(len(seen.slot), -1, np.int32)
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
        )
        return (displacement / (dt_s * self._scene.motion.max_speed_mps)).astype(np.float32)


class GroupForce(SocialForce):
    """Social forces for people who walk in groups.

    Companions do not repel each other. Instead they are drawn to the middle of their group if they
    are further than (members − 1) / 2 metres from it, and move apart if they overlap: the forces of
    Moussaïd et al. (2010), PLoS ONE 5, e10047, without that of gazing.
    """

    name = "group-force"
    groups = True


@compiled
def _walk(world, position, velocity, goal, speed, segments, walls, substeps, dt, group, by_x):
    """Displacements (A, 2) in `dt` seconds, in metres; `world` must be in ascending order.

    `by_x` (A,) are the persons in the order of x, world by world.
    """
    h = dt / substeps
    start = position.copy()
    size = len(world)
    heading = np.zeros((size, 2))
    force = np.zeros((size, 2))
    near, count = _walls_near(position, speed, segments, dt)
    others, begins = _people_near(world, position, speed, group, dt, by_x)
    for _ in range(substeps):
        for a in range(size):
            gx, gy = goal[a, 0] - position[a, 0], goal[a, 1] - position[a, 1]
            distance = math.sqrt(gx * gx + gy * gy)
            if distance > 0.0:
                heading[a, 0], heading[a, 1] = gx / distance, gy / distance
        for a in range(size):
            fx = (speed[a] * heading[a, 0] - velocity[a, 0]) / RELAXATION_S
            fy = (speed[a] * heading[a, 1] - velocity[a, 1]) / RELAXATION_S
            mx, my, members = 0.0, 0.0, 1  # sum of the vectors to the companions
            for b in others[begins[a] : begins[a + 1]]:
                rx, ry = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
                if group[a] >= 0 and group[a] == group[b]:
                    mx, my, members = mx - rx, my - ry, members + 1
                    r = math.sqrt(rx * rx + ry * ry)
                    if 0.0 < r < SEPARATE_M:
                        fx, fy = fx + SEPARATION * rx / r, fy + SEPARATION * ry / r
                elif rx * rx + ry * ry < REACH_M * REACH_M:
                    px, py = _repulsion(rx, ry, velocity[b, 0] * STEP_S, velocity[b, 1] * STEP_S)
                    toward = -(heading[a, 0] * px + heading[a, 1] * py)
                    seen = toward >= math.sqrt(px * px + py * py) * COS_OF_VIEW
                    weight = 1.0 if seen else BEHIND
                    fx += weight * px
                    fy += weight * py
            away = math.sqrt(mx * mx + my * my) / members
            if away > 0.5 * (members - 1):
                fx += GATHERING * mx / (members * away)
                fy += GATHERING * my / (members * away)
            wx, wy = _wall_force(
                position[a, 0], position[a, 1], segments, walls, near[a, : count[a]]
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
def _repulsion(rx, ry, sx, sy):
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
    strength = REPULSION / REPULSION_RANGE_M * math.exp(-b / REPULSION_RANGE_M) * both / (4.0 * b)
    return strength * (rx / r + tx / t), strength * (ry / r + ty / t)


@compiled
def _people_near(world, position, speed, group, dt, by_x):
    """The others in the same world who can act on each person in the frame, in ascending order.

    Those of person a are `others[begins[a] : begins[a + 1]]`: companions, and whoever can come
    within reach. They are found among those who are near along the x-axis.
    """
    size = len(world)
    fastest = 0.0
    for a in range(size):
        fastest = max(fastest, speed[a])
    rank = np.empty(size, np.int64)
    for k in range(size):
        rank[by_x[k]] = k
    others = np.empty(16 * size, np.int64)
    begins = np.zeros(size + 1, np.int64)
    found = np.empty(size, np.int64)
    for a in range(size):
        reach = REACH_M + FASTEST * (speed[a] + fastest) * dt
        count = 0
        for step in (-1, 1):
            k = rank[a] + step
            while 0 <= k < size and world[by_x[k]] == world[a]:
                b = by_x[k]
                dx, dy = position[a, 0] - position[b, 0], position[a, 1] - position[b, 1]
                if abs(dx) > reach:
                    break
                if dx * dx + dy * dy <= reach * reach and not (
                    group[a] >= 0 and group[a] == group[b]
                ):
                    found[count] = b
                    count += 1
                k += step
        if group[a] >= 0:
            for b in range(size):
                if b != a and world[b] == world[a] and group[b] == group[a]:
                    found[count] = b
                    count += 1
        end = begins[a] + count
        if end > len(others):
            longer = np.empty(2 * end, np.int64)
            for k in range(begins[a]):
                longer[k] = others[k]
            others = longer
        for k in range(count):  # sorted by insertion: numpy's sort would take a second to compile
            at = begins[a] + k
            while at > begins[a] and others[at - 1] > found[k]:
                others[at] = others[at - 1]
                at -= 1
            others[at] = found[k]
        begins[a + 1] = end
    return others, begins


@compiled
def _walls_near(position, speed, segments, dt):
    """Wall segments that can act on each person in the frame, and their number per person."""
    near = np.empty((len(position), len(segments)), dtype=np.int32)
    count = np.zeros(len(position), dtype=np.int32)
    for a in range(len(position)):
        reach = REACH_M + FASTEST * speed[a] * dt
        for s in range(len(segments)):
            x, y = _nearest(position[a, 0], position[a, 1], segments[s])
            if x * x + y * y <= reach * reach:
                near[a, count[a]] = s
                count[a] += 1
    return near, count


@compiled
def _nearest(x, y, segment):
    """Vector from the nearest point of a segment to (x, y)."""
    ax, ay = segment[0], segment[1]
    ex, ey = segment[2] - ax, segment[3] - ay
    along = ((x - ax) * ex + (y - ay) * ey) / (ex * ex + ey * ey)
    along = min(1.0, max(0.0, along))
    return x - ax - along * ex, y - ay - along * ey


@compiled
def _wall_force(x, y, segments, walls, near):
    """Sum over walls of the repulsion −∇U from each wall's nearest point, eq. 5."""
    fx, fy = 0.0, 0.0
    k = 0
    while k < len(near):
        wall = walls[near[k]]
        nearest, nx, ny = np.inf, 0.0, 0.0
        while k < len(near) and walls[near[k]] == wall:
            dx, dy = _nearest(x, y, segments[near[k]])
            distance = math.sqrt(dx * dx + dy * dy)
            if distance < nearest:
                nearest, nx, ny = distance, dx, dy
            k += 1
        if 0.0 < nearest < REACH_M:
            push = WALL / WALL_RANGE_M * math.exp(-nearest / WALL_RANGE_M) / nearest
            fx += push * nx
            fy += push * ny
    return fx, fy
