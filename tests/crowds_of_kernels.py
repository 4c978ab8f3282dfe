"""Small crowds in which everything happens that kernels distinguish, for tests of them."""

import numpy as np
from worlds import Person, box, events, square

from crowdbench.simulation import Settings, Simulation
from crowdbench.spawn import SpawnEvents

BLOCKS = square(6.0, box(-1, -1, 1, 1), box(-5, 2, -2, 2.5), dwell_p99_s=6.0)
SIZES = Settings(max_alive=8, rays=16, ray_range_m=4.0)


def people(seed: int) -> SpawnEvents:
    """A crowd that waits, hits walls, reaches goals, leaves, times out and finds no slot."""
    rng = np.random.default_rng(seed)
    doors = np.array([(-4.0, -4.0), (4.0, -3.0), (-3.0, 4.5)])
    crowd = []
    for time_s in np.sort(rng.uniform(-2, 20, 40)):
        start, goal = rng.choice(doors, 2, replace=False) + rng.normal(0, 0.1, (2, 2))
        scripted = bool(rng.random() < 0.1)
        leave = int(time_s / 0.4) + 8 if scripted or rng.random() < 0.1 else -1
        crowd.append(
            Person(
                time_s=float(time_s),
                start=tuple(start),
                goal=tuple(goal),
                speed=float(rng.uniform(0.5, 2)),
                leave_frame=leave,
                scripted=scripted,
                group=len(crowd) // 5 % 3 - 1,
                via=(0.0, -3.0) if len(crowd) % 4 == 0 else (np.nan, np.nan),
                wait_s=1.2,
            )
        )
    return events(*crowd)


def actions(simulation: Simulation, seeds: tuple[int, ...], number: int) -> np.ndarray:
    """Towards the goal with noise that depends on the world's seed and the step only."""
    noise = [np.random.default_rng((seed, number)).normal(0, 0.3, (8, 2)) for seed in seeds]
    way = simulation.slots.goal - simulation.slots.position
    return (0.3 * np.sign(way) + np.array(noise)).astype(np.float32)
