"""The noise of recorded positions, estimated from the recording itself.

Second differences x(t + L) − 2 x(t) + x(t − L) of a person's positions contain white noise with
variance 6 σ², whatever the lag L, and accelerations, whose part grows with the lag. The variance is
fitted as 6 σ² + a Lᵇ.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.data.table import Indices, Points, Trajectories

WALKING_MPS = 0.5
"""Only people who are faster have a direction."""
LONGEST_S = 4.0
FEWEST_LAGS = 5
CLIPPED = 99.0
"""Percentile at which squared differences are clipped, because a few tracks jump."""


@dataclass(frozen=True)
class Noise:
    """Noise along one axis: along the path of people, or across it."""

    sigma_m: float
    """Standard deviation of the positions, metres."""
    lag_ticks: int
    """Shortest lag at which second differences contain more motion than noise, in ticks."""


def noise_of(crowd: Trajectories, tick_frames: int) -> tuple[Noise, Noise]:
    """The noise of a recording along and across the path of its people."""
    frame = crowd.row_frame()
    rows = np.flatnonzero(frame % tick_frames == 0)
    xy, person = crowd.xy[rows].astype(np.float64), crowd.row_person()[rows]
    tick_s = tick_frames * crowd.dt_s
    lags = np.arange(1, max(FEWEST_LAGS, round(LONGEST_S / tick_s)) + 1)
    variance = np.array([_variances(xy, person, int(lag), tick_s) for lag in lags])
    return _fitted(lags, variance[:, 0]), _fitted(lags, variance[:, 1])


def _variances(xy: Points, person: Indices, lag: int, tick_s: float) -> tuple[float, float]:
    """Variance of second differences along and across the path, m²; NaN without any."""
    t = np.arange(lag, max(lag, len(xy) - lag))
    t = t[person[t - lag] == person[t + lag]]
    way = xy[t + lag] - xy[t - lag]
    length = np.hypot(way[:, 0], way[:, 1])
    walks = length > WALKING_MPS * 2 * lag * tick_s
    second = (xy[t + lag] - 2 * xy[t] + xy[t - lag])[walks]
    u = way[walks] / length[walks, None]
    if len(u) == 0:
        return np.nan, np.nan
    along = np.square((second * u).sum(axis=1))
    across = np.square(second[:, 1] * u[:, 0] - second[:, 0] * u[:, 1])
    clipped = [np.minimum(each, np.percentile(each, CLIPPED)).mean() for each in (along, across)]
    return float(clipped[0]), float(clipped[1])


def _fitted(lags: Int[np.ndarray, " L"], variance: Float[np.ndarray, " L"]) -> Noise:
    from scipy.optimize import least_squares

    known = np.isfinite(variance) & (variance > 0)
    if known.sum() < 3:
        return Noise(0.0, 2)
    lag, seen = lags[known].astype(np.float64), variance[known]

    def residuals(of: Float[np.ndarray, " 3"]) -> Float[np.ndarray, " n"]:
        return np.asarray(np.log((np.exp(of[0]) + np.exp(of[1]) * lag ** of[2]) / seen))

    start = [np.log(seen[0] / 2), np.log(seen[0] / 2), 3.0]
    bounds = ([-40.0, -40.0, 1.0], [10.0, 10.0, 4.0])
    noise, signal, power = least_squares(residuals, start, bounds=bounds).x
    more = np.flatnonzero(signal + power * np.log(lags) >= noise)
    first = int(lags[more[0]]) if len(more) else int(lags[-1])
    return Noise(float(np.sqrt(np.exp(noise) / 6)), first)


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
