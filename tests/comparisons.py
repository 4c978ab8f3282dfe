"""Crowds to compare, and the blocks and the place in which metrics look at them."""

from dataclasses import replace

import numpy as np
from hypothesis import strategies as st
from strategies import crowd_of, crowds

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.data.table import OUTCOMES, PERSON_COLUMNS, Trajectories
from crowdbench.metrics import Metric, MetricResult, Place, distance

DT_S = 4.0
OBSERVED = [(0, 30), (36, 126)]
BLOCKS = cut(np.array(OBSERVED), block_s=120.0, dt_s=DT_S, grid_s=2.0)
"""Four blocks of 30 frames, long enough for each metric, with a gap."""
PLACE = Place(
    spawn_areas=5,
    goal_areas=5,
    bounds_m=(-4.0, 3.0, -3.0, 4.0),
    walls=(
        ((-2.0, -2.0), (0.0, -2.0), (0.0, -1.0), (-2.0, -1.0)),
        ((1.0, 1.0), (3.0, 1.0), (3.0, 3.0)),
    ),
)


def mingling(seed: int) -> Trajectories:
    """Up to 60 people who jump about on a square of 10 m, and some who walk in curves together.

    Those are two, or three with every fourth seed.

    All are on sixteenths of a metre. So their coordinates are exact, and stay so when turned and
    moved by whole metres.
    """
    rng = np.random.default_rng(seed)
    number, frames = int(rng.integers(1, 60)), 130
    first = rng.integers(0, frames, number)
    last = np.minimum(first + rng.integers(0, 25, number), frames - 1)
    rows = int((last - first + 1).sum())
    jumping = rng.integers(-40, 40, (rows, 2)) / 8 + 1 / 16
    t = np.arange(4, frames)
    angle = 0.15 * t + 0.35 * np.sin(0.5 * t + rng.uniform(0, 6))
    curve = np.round(8 * 20 * np.stack([np.cos(angle), np.sin(angle)], axis=1)) / 8 + 1 / 16
    beside_m = (4 + seed % 9) / 8
    members = 3 if seed % 4 == 2 else 2
    walking = [curve + np.array([k * beside_m, 0.0]) for k in range(members)]
    first, last = np.append(first, [4] * members), np.append(last, [frames - 1] * members)
    number += members
    return crowd_of(
        list(zip(first, last, strict=True)),
        frames=frames,
        observed=OBSERVED,
        dt_s=DT_S,
        grid_s=2.0,
        xy=np.concatenate([jumping, *walking]),
        persons={
            "spawn_area": rng.integers(-1, 5, number),
            "goal_area": rng.integers(-1, 5, number),
            "entered": rng.random(number) < 0.9,
            "left": rng.random(number) < 0.9,
            "spawn_s": (first - rng.choice([0.0, 0.25, 0.75], number)) * DT_S,
            "outcome": rng.integers(0, len(OUTCOMES), number),
        },
    )


BUSY, BUSY_TOO = mingling(0), mingling(2)
mingling_crowds = st.integers(0, 2**32 - 1).map(mingling)
any_crowds = crowds(dt_s=DT_S) | mingling_crowds


def nobody() -> Trajectories:
    """A crowd of no one."""
    return replace(
        BUSY,
        person_id=np.empty(0, np.int64),
        first=np.empty(0, np.int64),
        offsets=np.zeros(1, np.int64),
        xy=np.empty((0, 2), np.float32),
        **{name: getattr(BUSY, name)[:0] for name in PERSON_COLUMNS},
    )


def whole(
    frames: int, *, block_s: float | None = None, dt_s: float = 1.0, grid_s: float | None = None
) -> TimeBlocks:
    """Blocks of `block_s` (one by default) of a crowd that is observed from first to last."""
    return cut(
        np.array([[0, frames]]),
        block_s=frames * dt_s if block_s is None else block_s,
        dt_s=dt_s,
        grid_s=dt_s if grid_s is None else grid_s,
    )


def score(
    metric: Metric,
    recorded: Trajectories,
    simulated: Trajectories,
    blocks: TimeBlocks = BLOCKS,
    place: Place = PLACE,
) -> MetricResult:
    return distance(metric, recorded, simulated, blocks, place)


def sample(
    metric: Metric,
    crowd: Trajectories,
    blocks: TimeBlocks,
    place: Place = PLACE,
    name: str = "counts",
) -> list[list[int]]:
    """The values that a histogram holds, ascending, block by block."""
    counts = metric.summarise(crowd, blocks, place)[name]
    return [np.repeat(np.arange(counts.shape[1]), row).tolist() for row in counts]
