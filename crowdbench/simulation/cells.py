"""Search for the people near a person, shared by the kernels of all observations."""

from typing import NamedTuple

import numpy as np

from crowdbench.compilation import subroutine
from crowdbench.simulation.walls import cell_of

CHUNK = 10  # persons per unit of work of a thread


class Cells(NamedTuple):
    """Cell lists: persons sorted by grid cell, for fast neighbour search."""

    origin: np.ndarray
    """(2,) lower left corner of the grid, in metres."""
    size: float
    """Edge length of a cell, in metres."""
    columns: int
    rows: int
    start: np.ndarray
    """(W, C + 2): cell c of world w has the persons `slot[w, start[w, c]:start[w, c + 1]]`."""
    xy: np.ndarray
    """(W, N, 2) float64 positions, sorted by cell, in metres."""
    slot: np.ndarray
    """(W, N) slots of the persons, sorted by cell."""
    person: np.ndarray
    """(W·N, 2) list of the world and slot of everyone to observe."""

    @classmethod
    def between(
        cls, worlds: int, slots: int, lower: np.ndarray, upper: np.ndarray, size_m: float
    ) -> "Cells":
        """Empty lists for positions between `lower` and `upper`."""
        columns, rows = (max(1, int(np.ceil(extent / size_m))) for extent in upper - lower)
        return cls(
            origin=lower.astype(np.float64),
            size=size_m,
            columns=columns,
            rows=rows,
            start=np.zeros((worlds, columns * rows + 2), np.int32),
            xy=np.zeros((worlds, slots, 2), np.float64),
            slot=np.zeros((worlds, slots), np.int32),
            person=np.zeros((worlds * slots, 2), np.int32),
        )


@subroutine
def sort_into_cells(w, alive, ended, position, wider, grid, start, sorted_xy, sorted_slot):
    """Counting sort of a world's persons by cell, including those who have just ended.

    Returns the largest of their `wider`, in metres.
    """
    size, widest = start.shape[1], 0.0
    for c in range(size):
        start[w, c] = 0
    for i in range(alive.shape[1]):
        if alive[w, i] or ended[w, i] != 0:
            start[w, cell_of(position[w, i, 0], position[w, i, 1], grid) + 2] += 1
    for c in range(2, size):
        start[w, c] += start[w, c - 1]
    for i in range(alive.shape[1]):
        if alive[w, i] or ended[w, i] != 0:
            c = cell_of(position[w, i, 0], position[w, i, 1], grid) + 1
            at = start[w, c]
            sorted_xy[w, at, 0] = position[w, i, 0]
            sorted_xy[w, at, 1] = position[w, i, 1]
            sorted_slot[w, at] = i
            start[w, c] = at + 1
            widest = max(widest, np.float64(wider[w, i]))
    return widest


@subroutine
def list_persons(cells):
    """Write everyone to observe to `cells.person` and return their number.

    One flat list of all worlds, so that the work is distributed evenly over the threads.
    """
    start, slot, person = cells.start, cells.slot, cells.person
    total = 0
    for w in range(start.shape[0]):
        for at in range(start[w, cells.columns * cells.rows]):
            person[total, 0] = w
            person[total, 1] = slot[w, at]
            total += 1
    return total


@subroutine
def neighbours(w, i, x, y, far, ended, spawned, grid, start, sorted_xy, sorted_slot, near, who):
    """Find the people closer than `far` metres and return their number n.

    Writes their relative positions to `near[:n]`, in metres, and their slots to `who[:n]`.

    A person whose trip has just ended sees the crowd without those who entered in this step. A
    person who is present does not see those whose trips have just ended.
    """
    gone = ended[w, i] != 0
    columns = grid[3]
    lowest = cell_of(x - far, y - far, grid)
    highest = cell_of(x + far, y + far, grid)
    count = 0
    for row in range(lowest // columns, highest // columns + 1):
        first = start[w, row * columns + lowest % columns]
        stop = start[w, row * columns + highest % columns + 1]
        for at in range(first, stop):
            dx, dy = sorted_xy[w, at, 0] - x, sorted_xy[w, at, 1] - y
            j = sorted_slot[w, at]
            visible = not spawned[w, j] if gone else ended[w, j] == 0
            # Always written, but counted only if visible. A branch would be mispredicted half of
            # the time, which is slower.
            near[count, 0] = dx
            near[count, 1] = dy
            who[count] = j
            count += (dx * dx + dy * dy < far * far) & (j != i) & visible
    return count
