"""Recordings that were altered, and rollouts whose positions were disturbed."""

from dataclasses import replace

import numpy as np
from numpy.random import Generator

from crowdbench.data.table import PERSON_COLUMNS, Trajectories, from_rows

SMOOTHED_TICKS = 3
"""Length of the moving mean of a smoothed recording."""
SHIFT_S = 5.0


def with_noise(
    crowd: Trajectories, sigma_m: tuple[float, float], tick_frames: int, rng: Generator
) -> Trajectories:
    """White noise on the positions at ticks, along and across the paths; linear in between."""
    noise = rng.standard_normal((len(crowd.xy), 2)) * sigma_m
    way = _directions(crowd)
    across = np.stack([-way[:, 1], way[:, 0]], axis=1)
    offset = noise[:, :1] * way + noise[:, 1:] * across
    return replace(crowd, xy=(crowd.xy + _at_ticks(crowd, offset, tick_frames)).astype(np.float32))


def _directions(crowd: Trajectories) -> np.ndarray:
    """Unit vector along the path at each row; along x for people who do not move."""
    person, row = crowd.row_person(), np.arange(len(crowd.xy))
    before = np.maximum(row - 2, crowd.offsets[:-1][person])
    after = np.minimum(row + 2, crowd.offsets[1:][person] - 1)
    way = crowd.xy[after].astype(np.float64) - crowd.xy[before]
    length = np.linalg.norm(way, axis=1, keepdims=True)
    return np.divide(way, length, out=np.tile([1.0, 0.0], (len(way), 1)), where=length > 0)


def _at_ticks(crowd: Trajectories, values: np.ndarray, tick_frames: int) -> np.ndarray:
    """Values of each row at ticks, linearly interpolated between the ticks of each person."""
    if tick_frames == 1:
        return values
    frame, person = crowd.row_frame(), crowd.row_person()
    # Persons follow each other on one axis, far enough apart not to be mixed.
    time = frame + person * 2.0 * crowd.frames
    at = np.flatnonzero(frame % tick_frames == 0)
    return np.stack([np.interp(time, time[at], values[at, k]) for k in (0, 1)], axis=1)


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
