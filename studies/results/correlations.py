"""Autocorrelation of N(t) lag by lag; scorecards contain only its mean over the lags."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.metrics.lattice import correlation
from crowdbench.metrics.presence import LAGS_S, lag_key, lagged, usable_lags
from crowdbench.scoring.reference import Reference


@dataclass(frozen=True)
class Lag:
    """Autocorrelation of N(t) at one lag, averaged over the splits."""

    lag_s: float
    recorded: float
    simulated: float
    """Mean over the rollouts and splits."""


def at_lags(reference: Reference, crowds: Mapping[str, Sequence[Trajectories]]) -> list[Lag]:
    """Autocorrelations at each lag that the metric compares in every split, means over the splits.

    `crowds` are the rollouts by split (see `blocks.SPLITS`); each split is evaluated in its blocks.
    """
    blocks = {split: reference.blocks.scored(split) for split in crowds}
    found = []
    for lag_s in LAGS_S:
        if not all(usable_lags([lag_s], blocks[split]) for split in crowds):
            continue
        of_recording = reference.statistics["autocorrelation"][lag_key(lag_s)]
        recorded, simulated = [], []
        for split, rollouts in crowds.items():
            inside = reference.blocks.in_split(split)
            recorded.append(correlation(of_recording[inside].sum(axis=0)))
            sums = [lagged(crowd, blocks[split], [lag_s])[0].sum(axis=0) for crowd in rollouts]
            simulated.append(np.mean(correlation(np.array(sums))))
        found.append(Lag(lag_s, float(np.mean(recorded)), float(np.mean(simulated))))
    return found
