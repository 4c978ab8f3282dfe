"""The simulation core: `W` worlds of `N` slots each, compiled by numba.

All environments and rollouts use `Simulation`.
"""

import numba

# numba's own thread pool is not thread-safe; that of OpenMP is. Without OpenMP, any will do.
# This is set before kernels are imported.
numba.config.THREADING_LAYER_PRIORITY = ["omp", "tbb", "workqueue"]  # type: ignore[attr-defined]

from crowdbench.simulation.simulation import Settings, Shown, Simulation  # noqa: E402

__all__ = ["Settings", "Shown", "Simulation"]
