"""Family motion: how people move, on time scales on which they move more than annotations jitter.

Positions are taken at *ticks*: every `Walking.tick_frames` frames, so that no position is an
interpolated one. Speeds are slopes over a window of ticks. Accelerations are mean products of two
second differences that share no position, so that independent noise of the positions, of any size
and distribution, cancels.
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.stops import STANDING_MPS
from crowdbench.data.table import Trajectories
from crowdbench.metrics.forms import RelativeWasserstein
from crowdbench.metrics.metric import Metric, Place, Statistics, Sums, Support, Vectors, Weights
from crowdbench.metrics.rows import ticks_of
from crowdbench.scene import Walking

FASTEST_MPS = 100.0
LARGEST = 1e6
"""Speeds, and products of accelerations (m²/s⁴), are clipped at these values. Larger ones only
occur in broken tables."""
PRODUCT = 1e-6
"""Unit of stored products of accelerations, m²/s⁴."""
SHORTEST_M = 3.0
FEWEST_STEPS = 4
"""Trips with a shorter distance from start to end, or with fewer steps, have no deviation."""
HARMONICS = 3


@lru_cache(maxsize=1)  # two metrics use the speeds of the same crowd
def _speeds(
    crowd: Trajectories, blocks: TimeBlocks, walking: Walking
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " m"], Int[np.ndarray, " m"]]:
    """Speed (m/s), person and block at the middle of each full window of ticks.

    The velocity is the slope of the least-squares line through the window's positions (Savitzky &
    Golay 1964, first derivative).
    """
    at = ticks_of(crowd, blocks, walking.tick_frames)
    half = (walking.window_ticks - 1) // 2
    index = at.with_room(half, half)
    windows = max(0, len(at.xy) - 2 * half)  # those across two trips too, which are not used
    slope = np.zeros((windows, 2))
    for i in range(1, half + 1):
        slope += i * (at.xy[half + i :][:windows] - at.xy[half - i :][:windows])
    slope = slope[index - half] / (at.dt_s * 2 * sum(i * i for i in range(1, half + 1)))
    speed = np.minimum(np.hypot(slope[:, 0], slope[:, 1]), FASTEST_MPS)
    return speed, at.person[index], at.block[index]


class Speed(RelativeWasserstein):
    """Speed of each person at each tick, clipped at 100 m/s.

    Distance: Wasserstein-1 of speeds rounded to 1 cm/s, divided by the recording's mean.
    """

    name = "speed"
    family = "motion"
    unit = "m/s"
    lattice_step = 0.01

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, v]`: number of positions in block b with a speed of v cm/s."""
        speed, _, block = _speeds(crowd, blocks, place.walking)
        inside = block >= 0
        return self.histogram(speed[inside], block[inside], blocks)

    @staticmethod
    def walking_mps(statistics: Statistics) -> float | None:
        """Mean speed of people who walk, m/s, over all blocks; None if nobody does."""
        counts = statistics["counts"].sum(axis=0)
        cm_per_s = np.arange(len(counts))
        counts = np.where(cm_per_s < 100 * STANDING_MPS, 0, counts)
        number = int(counts.sum())
        return float(counts @ cm_per_s) / number / 100 if number else None


class Pace(RelativeWasserstein):
    """Difference of a person's speed at each tick from the mean speed of the person's trip.

    Distance: Wasserstein-1 of absolute differences rounded to 1 cm/s, divided by the recording's
    mean.
    """

    name = "pace"
    family = "motion"
    unit = "m/s"
    lattice_step = 0.01

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, v]`: number of positions in block b whose speed differs by v cm/s."""
        speed, person, block = _speeds(crowd, blocks, place.walking)
        total, count = np.bincount(person, speed), np.bincount(person)
        unsteady = np.abs(speed - (total / np.maximum(count, 1))[person])
        inside = block >= 0
        return self.histogram(unsteady[inside], block[inside], blocks)


@lru_cache(maxsize=4)  # two metrics use the products of the same crowd, at up to four lags
def _products(
    crowd: Trajectories, blocks: TimeBlocks, tick_frames: int, lag: int
) -> Int[np.ndarray, "B 3"]:
    """Per block, sums of products along and across the path, in 1e-6 m²/s⁴, and their number."""
    from crowdbench.metrics.kernels import products

    at = ticks_of(crowd, blocks, tick_frames)
    stands = STANDING_MPS * (2 * lag + 1) * at.dt_s
    return products(
        at.xy, at.person, at.block, len(blocks), lag, lag * at.dt_s, stands, LARGEST, PRODUCT
    )


class _NoiseCancelled(Metric):
    """Root of the mean product of successive accelerations, at each lag of the scene."""

    family = "motion"
    unit = "m/s²"
    _component: int

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`lag k`: per block the sum of products, in 1e-6 m²/s⁴, and their number."""
        sums = {}
        for lag in place.walking.lags_ticks:
            of_lag = _products(crowd, blocks, place.walking.tick_frames, lag)
            sums[f"lag {lag}"] = of_lag[:, [self._component, 2]]
        return sums

    def embed(self, sums: Sums, support: Support, blocks: TimeBlocks) -> Vectors:
        """√max(0, mean product) at each lag, m/s²."""
        by_lag = [s[..., 0] * PRODUCT / np.maximum(s[..., 1], 1) for s in sums.values()]
        return np.sqrt(np.maximum(np.stack(by_lag, axis=-1), 0.0))

    def weights(self, recorded: Sums, support: Support, blocks: TimeBlocks) -> Weights:
        """One over the number of lags times the recorded value; infinite if that is 0."""
        value = self.embed(recorded, support, blocks)
        with np.errstate(divide="ignore"):
            return 1.0 / (len(value) * value)

    def size(self, sums: Sums) -> int:
        """Number of products at the shortest lag."""
        shortest = min(sums, key=lambda name: int(name.split()[-1]))
        return int(sums[shortest][1])


class Acceleration(_NoiseCancelled):
    """Acceleration along the path; white noise of the positions cancels.

    Distance: mean over the lags of |difference| over the recorded value.
    """

    name = "acceleration"
    _component = 0


class Turning(_NoiseCancelled):
    """Acceleration across the path; white noise of the positions cancels.

    Distance: mean over the lags of |difference| over the recorded value.
    """

    name = "turning"
    _component = 1


class Deviation(RelativeWasserstein):
    """How far a trip leaves the straight line from its start to its end.

    It is √(a₁² + a₂² + a₃²), the amplitudes of the first three half sines of the sideways offsets,
    in metres. Trips of people who entered and left, of 3 m from start to end and four steps at
    least, count in the block of their first tick.

    Distance: Wasserstein-1 of deviations rounded to 1 cm, divided by the recording's mean.
    """

    name = "deviation"
    family = "motion"
    unit = "m"
    lattice_step = 0.01

    def summarise(self, crowd: Trajectories, blocks: TimeBlocks, place: Place) -> Statistics:
        """`counts[b, d]`: number of trips that begin in block b with a deviation of d cm."""
        from crowdbench.metrics.kernels import harmonics

        at = ticks_of(crowd, blocks, place.walking.tick_frames)
        begin = np.flatnonzero(np.diff(at.person, prepend=-1) != 0)
        steps = np.diff(np.append(begin, len(at.person))) - 1
        chord = at.xy[begin + steps] - at.xy[begin]
        length = np.hypot(chord[:, 0], chord[:, 1])
        whole = (crowd.entered & crowd.left)[at.person[begin]]
        chosen = whole & (length >= SHORTEST_M) & (steps >= FEWEST_STEPS) & (at.block[begin] >= 0)
        begin, steps = begin[chosen], steps[chosen]
        along = chord[chosen] / length[chosen, None]
        numbers, which = np.unique(steps, return_inverse=True)
        start = np.cumsum(numbers + 1) - (numbers + 1)
        step = np.arange((numbers + 1).sum()) - np.repeat(start, numbers + 1)
        phase = np.pi * step / np.repeat(numbers, numbers + 1)
        sines = np.sin(np.arange(1, HARMONICS + 1) * phase[:, None])
        sums = harmonics(at.xy, begin, steps, along, sines, start[which])
        square = np.zeros(len(begin))
        for of_harmonic in sums.T:
            square += (2 / steps * of_harmonic) ** 2
        return self.histogram(np.sqrt(square), at.block[begin], blocks)
