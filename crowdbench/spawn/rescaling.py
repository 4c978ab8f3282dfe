"""Time rescaling: how well a model's gaps and group sizes fit arrivals, whatever the model.

Measured in a model's own cumulative hazard, the gaps between groups are exponential of mean 1 if
the model is true. Arrivals lie on a grid, so each group is put at a random place within its last
step; where observation ends before a gap does, the hazard spent on it counts towards the next
gap, because what is left of an exponential is exponential again. Sources: Brown et al. (2002),
The time-rescaling theorem, Neural Computation 14; Brockwell (2007), Universal residuals.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.spawn.events import Arrivals
from crowdbench.spawn.groups import HasHazards, spells_of


@dataclass(frozen=True)
class KolmogorovSmirnov:
    """A test of residuals against the uniform distribution."""

    statistic: float
    """Greatest distance between the distribution functions."""
    p: float
    n: int


def rescaled(
    model: HasHazards,
    arrivals: Arrivals,
    rng: Generator,
    what: Literal["gap", "size"] = "gap",
) -> Float[np.ndarray, " n"]:
    """Residuals, one per group: independent and uniform on [0, 1] if the model is true."""
    spells = spells_of(arrivals)
    hazards = model.hazards(arrivals)
    before, until = getattr(hazards, what).T
    spent = before - np.log1p(rng.random(len(before)) * np.expm1(before - until))
    if what == "gap":
        unfinished = np.concatenate([[0.0], np.cumsum(hazards.rest)])[spells.of_group]
        spent = spent + np.diff(unfinished, prepend=0.0)
    return -np.expm1(-spent)


def kolmogorov_smirnov(residuals: Float[np.ndarray, " n"]) -> KolmogorovSmirnov:
    """Compare residuals with the uniform distribution on [0, 1]."""
    from scipy.stats import kstest

    found = kstest(residuals, "uniform")
    return KolmogorovSmirnov(float(found.statistic), float(found.pvalue), len(residuals))
