"""`guided-walker`: a discrete choice model of velocities, without a network.

As in Antonini, Bierlaire & Weber (2006), Transportation Research B 40, 667, a person chooses among
velocities, with probabilities exp(−E) / Σ exp(−E); here E is a cost. In each frame, 12 candidates
are drawn around the present velocity by a step of an Ornstein–Uhlenbeck process. Its mean is the
wanted velocity: the preferred speed along the way to the target, turned by a small angle that each
person keeps for its whole trip. The 13th candidate has the preferred speed and is not turned. There
are costs of strangers who pass nearby and soon, of walls, of companions who are too far, too near
or not at the side, of delay, and of missing the target.

It sees the observation `social-1`. The policy `anticipate` has similar costs, and draws its
candidates from a network. `crowdbench.baselines.guided` finds the parameters.
"""

import math
from typing import ClassVar, Literal, NamedTuple

import msgspec
import numpy as np
from jaxtyping import Float32
from numpy.random import Generator

from crowdbench.compilation import compiled
from crowdbench.errors import WeightsError
from crowdbench.files import read_struct
from crowdbench.policies.memory import Memory
from crowdbench.scene import Scene
from crowdbench.simulation import social
from crowdbench.spawn.recorded_plans import VISIT_M

CANDIDATES = 12
"""Velocities that are drawn, besides the wanted one."""
HORIZON_S = 8.0
"""Strangers are anticipated this time."""
LOOK_S = 1.5
"""Companions count where they and the person are after this time."""
LOOKS = 3
"""Walls count where the person is after 0.5, 1 and 1.5 s."""
NEAR_M = 3.0
"""At targets nearer than this, walls count less, and missing the target counts. Companions who are
farther away than this need not be at the side."""
STRAIGHTEN_M = 4.0
"""At targets nearer than this, the way is turned less."""
KEEP_M = 1.2
"""Companions who are farther away are too far."""
ROOM_M = 0.7
"""Companions who are nearer are too near."""
ROUND_M = 0.2
"""Below this distance, the costs of a companion's place grow with the square, not linearly."""
AT_STOP = 0.1
"""Standard deviations of people who wait, relative to those of people who walk."""
SLOWEST_MPS = 0.1

_PROBES, _NEIGHBOURS = social.PROBES.start, social.NEIGHBOURS.start
_PRESENT, _COMPANION = social.PRESENT.start, social.COMPANION.start
_OFFSET, _APPROACH = social.OFFSET.start, social.APPROACH.start
_WAY, _LENGTH = social.ROUTE_DIRECTION.start, social.ROUTE_LENGTH.start
_SPEED, _STOP = social.PREFERRED_SPEED.start, social.STOP.start
_RINGS_M = np.array((0.0, *social.PROBE_RADII_M))
_SECTORS = 8


class Parameters(NamedTuple):
    """Parameters of the guided walker."""

    speed_s: float
    """Time in which the speed along the way returns to the preferred one, in seconds."""
    side_s: float
    """Time in which the velocity across the way returns to 0."""
    speed_mps: float
    """Standard deviation of the speed along the way, if nothing costs anything, in m/s."""
    side_mps: float
    """The same of the velocity across the way."""
    bow: float
    """Standard deviation of the angles by which persons turn their ways, in radians."""
    avoid: float
    """Cost of a stranger who is touched at once."""
    avoid_m: float
    """Distance of the closest pass at which this cost is e times lower, in metres."""
    avoid_s: float
    """Time until the closest pass at which this cost is e times lower, in seconds."""
    room: float
    """Cost per metre by which companions are nearer than 0.7 m after 1.5 s."""
    keep: float
    """Cost per metre beyond 1.2 m at which companions are after 1.5 s."""
    abreast: float
    """Cost per metre at which companions are then ahead or behind."""
    beside: float
    """Cost per metre by which they are then nearer or farther at the side than `beside_m`."""
    beside_m: float
    """Distance between companions who walk side by side, in metres."""
    delay: float
    """Cost of standing where the preferred speed was possible."""
    miss: float
    """Cost per metre at which a near target is passed."""
    wall: float
    """Cost of being in a wall; at d metres from it, the cost is (1 − d/2)³ times that."""
    plan: float
    """Cost of the wanted velocity, besides all others."""


ANYWHERE = Parameters(
    speed_s=1.0,
    side_s=1.0,
    speed_mps=0.172,
    side_mps=0.163,
    bow=0.1,
    avoid=48.3,
    avoid_m=0.363,
    avoid_s=4.13,
    room=15.4,
    keep=3.62,
    abreast=3.15,
    beside=2.56,
    beside_m=0.874,
    delay=0.895,
    miss=6.72,
    wall=16.0,
    plan=3.52,
)
"""For any other place: found by `python -m crowdbench.baselines.guided --scenes` (no names)."""
FILE = "guided-walker.json"
"""In the folder of a scene: the parameters that are fitted to it."""
ELSEWHERE = "elsewhere"
"""Stands for a split where parameters are those of a walker who has never been in the scene."""


class Fits(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The content of a scene's `guided-walker.json`: parameters by their names."""

    command: str
    """The command that writes the file."""
    elsewhere: dict[str, float]
    """Those of a walker who has never been here."""
    splits: dict[str, dict[str, float]]
    """Those for each split of the scene's recording."""


def parameters_of(scene: Scene, split: str) -> Parameters:
    """The parameters for a scene: those of its file, if it has one, else those for any place.

    `split` may also be `ELSEWHERE`.

    Raises:
        WeightsError: the file is broken.
    """
    path = scene.folder / FILE
    if not path.is_file():
        return ANYWHERE
    hint = "Restore the file. Or delete it: then the parameters for any place are used."
    fits = read_struct(path, Fits, WeightsError, hint)
    found = fits.elsewhere if split == ELSEWHERE else fits.splits.get(split, {})
    if found.keys() != {*Parameters._fields}:
        got = f"{', '.join(found) or 'no parameters'} for {split}"
        expected = f"a number for each of {', '.join(Parameters._fields)}"
        raise WeightsError(path, got=got, expected=expected, hint=hint)
    wrong = [f"{name} = {value:g}" for name, value in found.items() if not 0 < value < math.inf]
    if wrong:
        got = f"{', '.join(wrong)} for {split}"
        raise WeightsError(path, got=got, expected="positive numbers", hint=hint)
    return Parameters(**found)


class GuidedWalker:
    """Walkers who draw velocities and choose by costs."""

    name = "guided-walker"
    sees: ClassVar[Literal["observation"]] = "observation"
    observation: ClassVar[str] = "social-1"
    many_worlds: ClassVar[bool] = True
    style: ClassVar[int] = 1
    noise: ClassVar[int] = 2 * CANDIDATES + 1

    def __init__(self, parameters: Parameters = ANYWHERE) -> None:
        self.parameters = parameters

    @classmethod
    def fitted_to(cls, scene: Scene, split: str) -> "GuidedWalker":
        """The walker with the parameters for a scene, see `parameters_of`."""
        return cls(parameters_of(scene, split))

    def reset(self, scene: Scene, rng: Generator) -> None:
        """Load the time step and the unit of actions of `scene`; there are no random draws."""
        self._unit_mps, self._dt_s = scene.motion.max_speed_mps, scene.dt_s

    def act(self, seen: Float32[np.ndarray, "A 102"], memory: Memory) -> Float32[np.ndarray, "A 2"]:
        """Velocities (A, 2) in the own frames of people, in units of the maximum speed."""
        actions = np.empty((len(seen), 2), np.float32)
        _choose(
            seen, memory.style, memory.noise, self._unit_mps, self._dt_s, self.parameters, actions
        )
        return actions


@compiled
def _choose(seen, style, noise, unit, dt, of, actions):
    """Write the action of each person to `actions` (A, 2); all lengths in m, velocities in m/s."""
    velocity = np.empty((CANDIDATES + 1, 2))
    cost = np.empty(CANDIDATES + 1)
    for i in range(len(seen)):
        ax, ay = unit * seen[i, 0], unit * seen[i, 1]
        way_x, way_y = np.float64(seen[i, _WAY]), np.float64(seen[i, _WAY + 1])
        left_m = social.ROUTE_RANGE_M * seen[i, _LENGTH]
        speed = max(unit * seen[i, _SPEED], SLOWEST_MPS)
        waits = seen[i, _STOP] > 0.5 and left_m < VISIT_M
        draw(ax, ay, way_x, way_y, left_m, speed, waits, style[i, 0], noise[i], unit, dt, of,
             velocity)  # fmt: skip
        cost[:] = 0.0
        cost[CANDIDATES] = of.plan
        add_people(seen[i], ax, ay, unit, velocity, of, cost)
        add_walls(seen[i], left_m, velocity, of, cost)
        for k in range(CANDIDATES + 1):
            x, y = velocity[k, 0], velocity[k, 1]
            along = way_x * x + way_y * y
            if not waits:
                cost[k] += of.delay * min(1.0, max(0.0, 1.0 - along / speed))
            if left_m < NEAR_M:
                ahead = max(0.0, left_m * along / max(x * x + y * y, 0.01))
                cost[k] += of.miss * math.hypot(
                    left_m * way_x - ahead * x, left_m * way_y - ahead * y
                )
        k = chosen(cost, noise[i, 2 * CANDIDATES])
        actions[i, 0], actions[i, 1] = velocity[k, 0] / unit, velocity[k, 1] / unit


@compiled
def draw(ax, ay, way_x, way_y, left_m, speed, waits, style, noise, unit, dt, of, velocity):
    """Draw candidates (13, 2) around the present velocity (ax, ay); the last is the wanted one."""
    wanted = 0.0 if waits else speed
    angle = of.bow * style * min(1.0, left_m / STRAIGHTEN_M)
    cos, sin = math.cos(angle), math.sin(angle)
    ex, ey = way_x * cos - way_y * sin, way_x * sin + way_y * cos
    keep_speed, keep_side = math.exp(-dt / of.speed_s), math.exp(-dt / of.side_s)
    along = wanted + keep_speed * (ax * ex + ay * ey - wanted)
    across = keep_side * (ay * ex - ax * ey)
    scale = AT_STOP if waits else 1.0
    sd_speed = scale * of.speed_mps * math.sqrt(1.0 - keep_speed * keep_speed)
    sd_side = scale * of.side_mps * math.sqrt(1.0 - keep_side * keep_side)
    for k in range(CANDIDATES):
        v, w = along + sd_speed * noise[2 * k], across + sd_side * noise[2 * k + 1]
        x, y = v * ex - w * ey, v * ey + w * ex
        shorten = min(1.0, unit / max(math.hypot(x, y), SLOWEST_MPS))
        velocity[k, 0], velocity[k, 1] = shorten * x, shorten * y
    velocity[CANDIDATES, 0], velocity[CANDIDATES, 1] = wanted * way_x, wanted * way_y


@compiled
def add_people(seen, ax, ay, unit, velocity, of, cost):
    """Add the costs of the nearest people, strangers and companions, to those of candidates."""
    companions = 0
    for j in range(social.NEAREST):
        companions += seen[_NEIGHBOURS + social.FEATURES * j + _COMPANION] > 0.5
    for j in range(social.NEAREST):
        one = seen[_NEIGHBOURS + social.FEATURES * j :]
        if one[_PRESENT] < 0.5:
            break
        x, y = social.RANGE_M * one[_OFFSET], social.RANGE_M * one[_OFFSET + 1]
        theirs_x, theirs_y = ax + unit * one[_APPROACH], ay + unit * one[_APPROACH + 1]
        if one[_COMPANION] > 0.5:
            # The direction in which both walk, or the way if they hardly move.
            way_x, way_y = np.float64(seen[_WAY]), np.float64(seen[_WAY + 1])
            to_x, to_y = ax + theirs_x + 0.2 * way_x, ay + theirs_y + 0.2 * way_y
            both = math.hypot(to_x, to_y)
            if both < 0.3:
                to_x, to_y, both = way_x, way_y, 1.0
            for k in range(len(cost)):
                dx, dy = theirs_x - velocity[k, 0], theirs_y - velocity[k, 1]
                cost[k] += of_companion(x + LOOK_S * dx, y + LOOK_S * dy, to_x / both, to_y / both,
                                        of) / companions  # fmt: skip
        else:
            for k in range(len(cost)):
                dx, dy = theirs_x - velocity[k, 0], theirs_y - velocity[k, 1]
                cost[k] += of_stranger(x, y, dx, dy, of)


@compiled
def of_stranger(x, y, dx, dy, of):
    """Cost of a stranger at (x, y) who moves with (dx, dy), as seen by the person."""
    pass_s = -(x * dx + y * dy) / max(dx * dx + dy * dy, 1e-6)
    pass_s = min(HORIZON_S, max(0.0, pass_s))
    distance = math.hypot(x + pass_s * dx, y + pass_s * dy)
    return of.avoid * math.exp(-distance / of.avoid_m - pass_s / of.avoid_s)


@compiled
def of_companion(x, y, to_x, to_y, of):
    """Cost of a companion who will be at (x, y), where both walk to the unit vector `to`."""
    distance = math.hypot(x, y)
    cost = of.keep * max(0.0, distance - KEEP_M) + of.room * max(0.0, ROOM_M - distance)
    if distance < NEAR_M:  # whoever is farther away has to come back first
        ahead, side = x * to_x + y * to_y, abs(y * to_x - x * to_y) - of.beside_m
        cost += of.abreast * (math.hypot(ROUND_M, ahead) - ROUND_M)
        cost += of.beside * (math.hypot(ROUND_M, side) - ROUND_M)
    return cost


@compiled
def add_walls(seen, left_m, velocity, of, cost):
    """Add the costs of walls and bounds to those of candidates; many targets are at walls."""
    free = 1.0
    for j in range(_PROBES, _NEIGHBOURS):
        free = min(free, seen[j])
    if free >= 1.0:
        return
    weight = of.wall * min(1.0, left_m / NEAR_M) / LOOKS
    for k in range(len(cost)):
        for look in range(1, LOOKS + 1):
            near = 1.0 - probed(seen, 0.5 * look * velocity[k, 0], 0.5 * look * velocity[k, 1])
            cost[k] += weight * near**3


@compiled
def probed(seen, x, y):
    """Distance from walls at (x, y) / 2 m, interpolated between the probes around the person."""
    radius = math.hypot(x, y)
    ring = 0
    while ring < 2 and radius > _RINGS_M[ring + 1]:
        ring += 1
    out = min(1.0, (radius - _RINGS_M[ring]) / (_RINGS_M[ring + 1] - _RINGS_M[ring]))
    turn = math.atan2(y, x) * (_SECTORS / (2.0 * math.pi)) % _SECTORS
    sector = int(turn)
    beyond = turn - sector
    outer = (1.0 - beyond) * _probe(seen, sector, ring) + beyond * _probe(seen, sector + 1, ring)
    if ring == 0:
        inner = np.float64(seen[_PROBES])
    else:
        inner = (1.0 - beyond) * _probe(seen, sector, ring - 1)
        inner += beyond * _probe(seen, sector + 1, ring - 1)
    return (1.0 - out) * inner + out * outer


@compiled
def _probe(seen, sector, ring):
    return np.float64(seen[_PROBES + 1 + len(social.PROBE_RADII_M) * (sector % _SECTORS) + ring])


@compiled
def chosen(cost, normal):
    """Index drawn with weights exp(−cost) by a standard normal number."""
    least = cost.min()
    total = 0.0
    for k in range(len(cost)):
        total += math.exp(least - cost[k])
    rest = 0.5 * (1.0 + math.erf(normal / math.sqrt(2.0))) * total
    for k in range(len(cost)):
        rest -= math.exp(least - cost[k])
        if rest < 0.0:
            return k
    return len(cost) - 1
