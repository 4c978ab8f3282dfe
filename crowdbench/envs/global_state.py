"""The state of a whole crowd, for centralised critics."""

import numpy as np
from jaxtyping import Float32

from crowdbench.simulation import Simulation
from crowdbench.simulation.state import WAITING

PRESENT = slice(0, 1)
"""1 for a person, 0 in empty slots, where all other values are 0 too."""
POSITION = slice(1, 3)
"""Position, with the bounds of the scene at −1 and 1."""
VELOCITY = slice(3, 5)
"""Velocity in the world frame / max_speed."""
TARGET = slice(5, 7)
"""The via point or goal, in the units of the position."""
PREFERRED_SPEED = slice(7, 8)
"""Preferred speed / max_speed."""
WAITS = slice(8, 9)
"""1 for people who wait at their via points."""
SIZE = 9


def global_state(simulation: Simulation) -> Float32[np.ndarray, "W N 9"]:
    """State of everyone who is present, by slot, with values clipped to [−1, 1]."""
    slots, scene = simulation.slots, simulation.scene
    b, most = scene.bounds, scene.motion.max_speed_mps
    low = np.array([b.x_min_m, b.y_min_m])
    size = np.array([b.x_max_m, b.y_max_m]) - low
    state = np.zeros((*slots.alive.shape, SIZE), np.float32)
    state[..., PRESENT] = 1.0
    state[..., POSITION] = 2 * (slots.position - low) / size - 1
    state[..., VELOCITY] = slots.velocity / most
    state[..., TARGET] = 2 * (slots.target - low) / size - 1
    state[..., PREFERRED_SPEED] = slots.speed[..., None] / most
    state[..., WAITS] = (slots.stage == WAITING)[..., None]
    state[~slots.alive] = 0.0
    return state.clip(-1, 1)
