"""What the network of `joint-gmm` sees: time constants and means of traces."""

import numpy as np
from jaxtyping import Float

from crowdbench.spawn.times.cox import FOLLOWING_S
from crowdbench.spawn.times.waves import STEP_S

TAU_S = np.array([2.0, 6.0, 20.0, 60.0, 180.0])
"""Time constants of the traces."""
TRACES = len(TAU_S)
FEATURES = 4 * TRACES
HALF = 0.5
"""Added to numbers of people before the logarithm is taken."""
RATE_BOUND, SIZE_BOUND = 3.0, 2.0
"""The rate of groups, and the odds of one more member, stay within these powers of e of the base
values."""
BINS = len(FOLLOWING_S) - 1
"""Number of bins of delays in which people follow others."""


def width_of(grid_s: float) -> int:
    """Number of grid points for which an output of the network holds."""
    return max(1, round(STEP_S / grid_s))


def mean_traces(rate_per_s: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K 5"]:
    """Means of the traces."""
    return rate_per_s[:, None] * TAU_S
