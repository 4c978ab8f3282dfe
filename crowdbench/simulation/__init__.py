"""The simulation core: `W` worlds of `N` slots each, compiled by numba.

Every environment view stands on `Simulation`; none has physics of its own.
"""

import numba

# numba's own thread pool is not thread-safe; OpenMP's is. Where there is no OpenMP, take any.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

from crowdbench.simulation.simulation import (  # noqa: E402  (the threading layer comes first)
    Settings,
    Simulation,
)

__all__ = ["Settings", "Simulation"]
