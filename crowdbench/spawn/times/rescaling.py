"""Time rescaling: tests how well a model's gaps and group sizes fit arrivals, for any model.

If the model is true, its cumulative hazards over the gaps between groups are exponential with mean
1. Because arrivals are on a grid, each group is placed at a random time within its last grid step.
If observation ends before a gap does, the hazard of the incomplete gap is added to the next gap;
this is valid because the exponential distribution is memoryless. Sources: Brown et al. (2002), The
time-rescaling theorem, Neural Computation 14; Brockwell (2007), Universal residuals.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.times.groups import HasHazards, spells_of


@dataclass(frozen=True)
class KolmogorovSmirnov:
    """Result of a Kolmogorov–Smirnov test of residuals against the uniform distribution."""

    statistic: float
    """Largest difference between the distribution functions."""
    p: float
    """p-value."""
    n: int
    """Number of residuals."""


def rescaled(
    model: HasHazards,
    arrivals: Arrivals,
    rng: Generator,
    what: Literal["gap", "size"] = "gap",
) -> Float[np.ndarray, " n"]:
    """Residuals of gaps or sizes, one per group: independent and uniform if the model is true."""
    spells = spells_of(arrivals)
    hazards = model.hazards(arrivals)
    before, until = getattr(hazards, what).T
    spent = before - np.log1p(rng.random(len(before)) * np.expm1(before - until))
    if what == "gap":
        unfinished = np.concatenate([[0.0], np.cumsum(hazards.rest)])[spells.of_group]
        spent = spent + np.diff(unfinished, prepend=0.0)
    return -np.expm1(-spent)


def kolmogorov_smirnov(residuals: Float[np.ndarray, " n"]) -> KolmogorovSmirnov:
    """Test residuals against the uniform distribution on [0, 1]."""
    from scipy.stats import kstest

    found = kstest(residuals, "uniform")
    return KolmogorovSmirnov(float(found.statistic), float(found.pvalue), len(residuals))
