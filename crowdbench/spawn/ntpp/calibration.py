"""Calibration of `ntpp-gmm`: samples have the recorded number of persons.

The samples of a self-exciting process can have another rate than its training data, even though its
compensator has the same rate.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Bool
from scipy.optimize import brentq

from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.ntpp.kernels import draw
from crowdbench.spawn.ntpp.model import NtppGMM

_FURTHEST = 1.0
"""Maximum shift of a log scale."""


def calibrated(
    model: NtppGMM, arrivals: Arrivals, chosen: Bool[np.ndarray, " K"], *, seed: int, points: int
) -> NtppGMM:
    """The model with log scales of the chosen areas shifted; `points` grid points are sampled.

    Areas in which nobody enters stay as they are: no shift makes a rate 0.
    """
    persons = np.bincount(arrivals.area, minlength=arrivals.areas)
    recorded = persons / np.diff(arrivals.windows, axis=1).sum()
    base = model.weights["base"].copy()
    for k in np.flatnonzero(chosen & (persons > 0)).tolist():
        of_area = model.of_area(k)
        base[k, 1] += _shift(of_area, model.memory, float(recorded[k]), seed, points)
    return replace(model, weights={**model.weights, "base": base})


def _shift(
    weights: tuple[np.ndarray, ...], memory: int, recorded: float, seed: int, points: int
) -> float:
    """The shift of an area's log scale for which samples have `recorded` persons per grid point.

    It is found between −1 and 1 by root finding. In a self-exciting process the log rate can change
    by four times the shift, so a fixed-point iteration would not converge.
    """
    length = 2_000  # about that of ETH's recording, so that the start has a similar weight
    samples = max(1, points // length)

    def excess(shift: float) -> float:
        base = weights[-2].copy()
        base[1] += shift
        rng = np.random.default_rng([seed, 2])
        now = (*weights[:-2], base, weights[-1])
        sampled = sum(int(draw(length, memory, now, rng)[1].sum()) for _ in range(samples))
        return float(np.log(max(1, sampled) / (samples * length * recorded)))

    low, high = -_FURTHEST, _FURTHEST
    if excess(low) <= 0.0:
        return low
    if excess(high) >= 0.0:
        return high
    return float(brentq(excess, low, high, xtol=0.002, rtol=1e-9))
