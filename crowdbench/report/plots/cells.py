"""Numbers of positions in the cells of a grid, and maps of them."""

from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Float32

from crowdbench.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CELL_M = 0.5


def in_cells(xy: Float32[np.ndarray, "n 2"], scene: Scene) -> Float[np.ndarray, "Y X"]:
    """Number of positions in each cell of `CELL_M`; the first cell is at the lowest x and y."""
    b = scene.bounds
    edges = [
        low + CELL_M * np.arange(int(np.ceil((high - low) / CELL_M)) + 1)
        for low, high in ((b.y_min_m, b.y_max_m), (b.x_min_m, b.x_max_m))
    ]
    x, y = xy.T
    return np.histogram2d(y, x, bins=edges)[0]


def draw_cells(axis: "Axes", values: Float[np.ndarray, "Y X"], scene: Scene, **style: Any) -> Any:
    """Draw a value per cell and return the image, for a colour bar."""
    b, (rows, columns) = scene.bounds, values.shape
    x, y = b.x_min_m, b.y_min_m
    extent = (x, x + CELL_M * columns, y, y + CELL_M * rows)
    return axis.imshow(values, origin="lower", interpolation="nearest", extent=extent, **style)
