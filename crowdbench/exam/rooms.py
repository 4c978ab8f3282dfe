"""Rooms of verification tests: small scenes made by code, with the people who walk in them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, TypeAlias

import msgspec
import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.data.table import Trajectories
from crowdbench.policies import Policy
from crowdbench.run.rollout import rollout
from crowdbench.scene import Bounds, Scene, Wall
from crowdbench.simulation import Settings
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.model import Start

SPEED_MPS = 1.33
"""Preferred speed of the guidelines' examples, in m/s."""
THICK_M = 0.5
"""Thickness of the walls around a room, in metres."""
PATIENT_S = 1e5
"""Longest recorded dwell time, in seconds: nobody is removed because a trip takes too long."""

Number: TypeAlias = float | int
Box: TypeAlias = tuple[Number, Number, Number, Number]
"""x0, y0, x1, y1 of a rectangle, in metres."""
Line: TypeAlias = tuple[Number, Number, Number, Number]
"""x0, y0, x1, y1 of a line through which people pass, in metres."""


@dataclass(frozen=True)
class Room:
    """A room and its people, ready to be walked."""

    scene: Scene
    people: SpawnEvents
    horizon_s: float
    line: Line | None = None
    """Where the flow of people is counted."""

    def walk(self, policy: Policy, seed: int) -> Trajectories:
        """The trajectories of the people with a policy.

        Raises:
            ActionError: the policy does not return one finite action per person.
        """
        sizes = Settings(max_alive=len(self.people))
        return rollout(
            self.scene, _Given(self.people), policy,
            seed=seed, horizon_s=self.horizon_s, settings=sizes,
        )  # fmt: skip


@dataclass(frozen=True)
class _Given:
    """The spawn model of a room: always the same people."""

    people: SpawnEvents
    name: ClassVar[str] = "room"
    start: ClassVar[Start] = "empty"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        del horizon_s, scene, rng
        return self.people


def scene_of(
    place: Scene, name: str, inside: Box, *, blocks: Sequence[Box] = (), open_: Box | None = None
) -> Scene:
    """A scene with the frames and limits of motion of `place`.

    `inside` is where people may be, walled on all sides except where `open_` reaches beyond it.
    `blocks` are solid. The bounds of the scene enclose everything.
    """
    x0, y0, x1, y1 = inside
    reach = inside if open_ is None else open_
    low = (min(x0, reach[0]) - THICK_M, min(y0, reach[1]) - THICK_M)
    high = (max(x1, reach[2]) + THICK_M, max(y1, reach[3]) + THICK_M)
    around = [
        (x0 - THICK_M, y0 - THICK_M, x0, y1 + THICK_M) if reach[0] >= x0 else None,
        (x1, y0 - THICK_M, x1 + THICK_M, y1 + THICK_M) if reach[2] <= x1 else None,
        (x0 - THICK_M, y0 - THICK_M, x1 + THICK_M, y0) if reach[1] >= y0 else None,
        (x0 - THICK_M, y1, x1 + THICK_M, y1 + THICK_M) if reach[3] <= y1 else None,
    ]
    solid = [*(box for box in around if box is not None), *blocks]
    walls = tuple(Wall(f"wall {k}", corners(box)) for k, box in enumerate(solid))
    return replace(
        place,
        id=f"{name}-v0",
        title=name,
        bounds=Bounds(low[0], high[0], low[1], high[1]),
        walls=walls,
        recording=msgspec.structs.replace(place.recording, dwell_p99_s=PATIENT_S),
        spawning=msgspec.structs.replace(place.spawning, patience_s=0.0),
    )


def corners(box: Box) -> tuple[tuple[float, float], ...]:
    """Corners of a rectangle in order."""
    x0, y0, x1, y1 = map(float, box)
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def wall_with_doors(x: Number, y: tuple[Number, Number], doors: Sequence[tuple[Number, Number]],
                    thick_m: float = 0.4) -> list[Box]:  # fmt: skip
    """The parts of a wall along y at x that doors, given as intervals of y, leave standing."""
    edges = [y[0], *(edge for door in sorted(doors) for edge in door), y[1]]
    parts = zip(edges[::2], edges[1::2], strict=True)
    return [(x, low, x + thick_m, high) for low, high in parts if high > low]


def crowd(
    start: Float[np.ndarray, "n 2"],
    goal: Float[np.ndarray, "n 2"],
    *,
    speed: Float[np.ndarray, " n"] | float = SPEED_MPS,
    wait_s: Float[np.ndarray, " n"] | None = None,
) -> SpawnEvents:
    """People who enter at once; with `wait_s` they stay at their starts for these times first."""
    none = np.zeros(len(start), np.int32)
    return entering(
        time_s=np.zeros(len(start)),
        start=start,
        goal=goal,
        spawn_area=none,
        goal_area=none,
        speed=np.broadcast_to(np.asarray(speed, np.float64), (len(start),)),
        via=None if wait_s is None else start,
        wait_s=wait_s,
    )


def filled(box: Box, count: int, rng: Generator, *, margin_m: float = 0.3) -> np.ndarray:
    """`count` places spread evenly over a rectangle, (count, 2), at random by a fifth of a step.

    The step is the distance of neighbours; places keep `margin_m` from the rectangle's sides.
    """
    x0, y0, x1, y1 = (box[0] + margin_m, box[1] + margin_m, box[2] - margin_m, box[3] - margin_m)
    columns = max(1, round(np.sqrt(count * (x1 - x0) / max(y1 - y0, 1e-9))))
    rows = int(np.ceil(count / columns))
    x = np.linspace(x0, x1, columns) if columns > 1 else np.array([(x0 + x1) / 2])
    y = np.linspace(y0, y1, rows) if rows > 1 else np.array([(y0 + y1) / 2])
    grid = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    # Who is left out is spread over the grid, so that the density is even.
    grid = grid[np.linspace(0, len(grid) - 1, count).round().astype(int)]
    step = min((x1 - x0) / max(1, columns - 1), (y1 - y0) / max(1, rows - 1))
    return grid + rng.uniform(-0.2, 0.2, grid.shape) * min(step, 0.5)


def beside(x: Number, y: tuple[Number, Number], count: int, rng: Generator) -> np.ndarray:
    """Goals at random places of a line along y at x, (count, 2)."""
    return np.stack([np.full(count, x), rng.uniform(*y, count)], axis=1)


def door_room(place: Scene, rng: Generator, *, count: int = 100, speed: float = SPEED_MPS) -> Room:
    """A room of 8 × 5 m with a door of 1 m, and people who leave it."""
    blocks = [(8.0, 0.0, 8.4, 2.0), (8.0, 3.0, 8.4, 5.0)]
    scene = scene_of(place, "door", (0, 0, 14, 5), blocks=blocks)
    people = crowd(
        filled((0, 0, 7.8, 5), count, rng), beside(13.0, (1, 4), count, rng), speed=speed
    )
    return Room(scene, people, 300.0, line=(8.2, 2.0, 8.2, 3.0))
