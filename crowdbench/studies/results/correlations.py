"""The autocorrelation of N(t) lag by lag; scorecards hold its mean over the lags only."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.metrics.lattice import correlation
from crowdbench.metrics.presence import LAGS_S, counted, lag_key, lagged
from crowdbench.scoring.reference import Reference
from crowdbench.trajectories.table import Trajectories


@dataclass(frozen=True)
class Lag:
    """The autocorrelation of N(t) at one lag."""

    lag_s: float
    recorded: float
    simulated: float
    """Mean over the rollouts."""


def at_lags(reference: Reference, crowds: Mapping[str, Sequence[Trajectories]]) -> list[Lag]:
    """At each lag that the metric compares in every part, the mean over the parts.

    `crowds` are the rollouts of each part (of `blocks.PARTS`), seen in its blocks.
    """
    blocks = {part: reference.blocks.scored(part) for part in crowds}
    found = []
    for lag_s in LAGS_S:
        if not all(counted([lag_s], blocks[part]) for part in crowds):
            continue
        of_recording = reference.statistics["autocorrelation"][lag_key(lag_s)]
        recorded, simulated = [], []
        for part, rollouts in crowds.items():
            inside = reference.blocks.in_part(part)
            recorded.append(correlation(of_recording[inside].sum(axis=0)))
            sums = [lagged(crowd, blocks[part], [lag_s])[0].sum(axis=0) for crowd in rollouts]
            simulated.append(np.mean(correlation(np.array(sums))))
        found.append(Lag(lag_s, float(np.mean(recorded)), float(np.mean(simulated))))
    return found
