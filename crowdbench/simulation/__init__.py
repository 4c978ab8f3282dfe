"""The simulation core: `W` worlds of `N` slots each, compiled by numba.

All environments and rollouts use `Simulation`.
"""

import numba

# numba's own thread pool is not thread-safe; that of OpenMP is. Without OpenMP, any will do.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

from crowdbench.simulation.simulation import (  # noqa: E402  (the threading layer comes first)
    Settings,
    Shown,
    Simulation,
)

__all__ = ["Settings", "Shown", "Simulation"]
