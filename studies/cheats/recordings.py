"""Recordings that were altered, and rollouts whose positions were disturbed."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from crowdbench.data.table import PERSON_COLUMNS, Trajectories, from_rows

SMOOTHED_TICKS = 3
"""Length of the moving mean of a smoothed recording."""
SHIFT_S = 5.0


def smoothed(crowd: Trajectories, tick_frames: int) -> Trajectories:
    """The moving mean of each path over three ticks; ends keep their positions."""
    half = SMOOTHED_TICKS // 2 * tick_frames
    person, row = crowd.row_person(), np.arange(len(crowd.xy))
    first, last = crowd.offsets[:-1][person], crowd.offsets[1:][person] - 1
    reach = np.minimum(half, np.minimum(row - first, last - row))
    sums = np.concatenate([np.zeros((1, 2)), crowd.xy.astype(np.float64).cumsum(axis=0)])
    mean = (sums[row + reach + 1] - sums[row - reach]) / (2 * reach + 1)[:, None]
    return replace(crowd, xy=mean.astype(np.float32))


def shifted(crowd: Trajectories, rng: Generator) -> Trajectories:
    """Each trip up to 5 s earlier or later at random, if it then is still within the recording."""
    most = round(SHIFT_S / crowd.dt_s)
    by = rng.integers(-most, most + 1, len(crowd))
    inside = (crowd.first + by >= 0) & (crowd.last + by < crowd.frames)
    by = np.where(inside, by, 0)
    person = crowd.row_person()
    columns = {name: getattr(crowd, name)[person] for name in PERSON_COLUMNS}
    for name in ("requested_s", "spawn_s"):
        columns[name] = columns[name] + by[person] * crowd.dt_s
    return from_rows(
        scene=crowd.scene,
        dt_s=crowd.dt_s,
        grid_s=crowd.grid_s,
        frames=crowd.frames,
        observed=crowd.observed,
        person_id=crowd.person_id[person],
        frame=crowd.row_frame() + by[person],
        xy=crowd.xy.astype(np.float64),
        persons=columns,
        provenance=crowd.provenance,
        where=crowd.scene,
    )
