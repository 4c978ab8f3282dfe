"""Energy scores, their noise floor, and resamples for their uncertainty.

A plain distance rewards a model that varies too little or that has memorised the recording's
marginals. The energy form of the same distance does not (Gneiting & Raftery 2007, Sec. 5.1, with
the negative-type distances of `crowdbench.metrics`). For rollouts X of a model and the recording y

    ES = mean d(X_k, y) − ½ mean d(X_k, X_l)   over pairs of distinct rollouts,
    F  = ½ mean d(y*, y**)                     over resamples y*, as long as y, of the recording,
    S  = 1 − (ES − F) / (ES_anchor − F)

The score S is 0 for the anchor and, on average, 1 for the process that generated the recording.
F is the noise floor. The families motion and interaction are scored under the recorded arrivals, so
a rollout can be right in each of them, and need not vary. There ES is the mean distance alone, F is
0, and S is 1 for the recording itself. With the second term, a policy could gain by drawing lots
between two ways of walking that are both wrong.

Uncertainty is estimated from 1,000 hierarchical resamples: of time blocks (the same for all
entries, so that entries can be compared in pairs), of fits, and of rollouts within fits.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.metrics import Metric, Statistics, total

RESAMPLES = 1000
FLOOR_DRAWS = 200
"""Number of block resamples whose pairs give the noise floor."""
NESTED_DRAWS = 20
"""Number of resamples of each resample, whose pairs give the noise floor of that resample."""
_NUMBERS = 250_000  # processed at a time: 2 MB, which fit into a core's cache


@dataclass(frozen=True, eq=False)
class Energy:
    """An energy score, or a noise floor, with its `R` resamples."""

    centre: float
    resampled: Float[np.ndarray, " R"]

    def deviations(self) -> Float[np.ndarray, " R"]:
        """Deviations of the resamples from their own mean.

        Their mean differs from `centre`, because a resample has fewer distinct blocks than the
        recording.
        """
        return self.resampled - self.resampled.mean()


def mean_of(energies: Sequence[Energy]) -> Energy:
    """The mean of several energy scores, one per fold, resample by resample."""
    return Energy(
        float(np.mean([e.centre for e in energies])),
        np.mean([e.resampled for e in energies], axis=0),
    )


@dataclass(frozen=True, eq=False)
class Draws:
    """The `R` resamples of one part of a recording, which has `B` blocks."""

    blocks: Int[np.ndarray, "R B"]
    """How often each block occurs in each resample."""
    runs: Int[np.ndarray, " U"]
    """Lengths of the runs of blocks that are resampled together."""
    seed: tuple[int, ...]

    @classmethod
    def of(
        cls, blocks: TimeBlocks, *, resample_s: float, block_s: float, seed: tuple[int, ...]
    ) -> "Draws":
        """Draw runs of `resample_s` (consecutive scored blocks) with replacement."""
        step = max(1, round(resample_s / block_s))
        runs = np.diff([*range(0, len(blocks), step), len(blocks)])
        rng = np.random.default_rng([*seed, 0])
        return cls(_draw(rng, np.ones(len(runs)), len(runs), RESAMPLES, runs), runs, seed)

    def fits(self, fits: int) -> Int[np.ndarray, "R fits"]:
        """Indices of the fits in each resample, drawn with replacement."""
        return np.random.default_rng([*self.seed, 2]).integers(fits, size=(RESAMPLES, fits))

    def rollouts(self, fits: int, rollouts: int) -> Int[np.ndarray, "R fits rollouts"]:
        """Indices of the rollouts of each fit in each resample, drawn with replacement."""
        rng = np.random.default_rng([*self.seed, 3])
        return rng.integers(rollouts, size=(RESAMPLES, fits, rollouts))


def _draw(
    rng: np.random.Generator,
    weight: Float[np.ndarray, " U"],
    times: int,
    count: int,
    runs: Int[np.ndarray, " U"],
) -> Int[np.ndarray, "count B"]:
    """Draw `times` runs with replacement, `count` times; returns how often each block occurs."""
    return np.repeat(rng.multinomial(times, weight / weight.sum(), size=count), runs, axis=1)


@dataclass(frozen=True, eq=False)
class FloorDraws:
    """Resamples for the noise floor F of a part: of the whole recording, but as long as the part.

    If only the few blocks of a fold were used, F would be too small by a fifth or more, because
    resamples of six blocks vary less than recordings of six blocks do. F is a property of the
    recording, not of a model, so no model gains information about held-out blocks.
    """

    order: Int[np.ndarray, " B"]
    """Indices of the recording's blocks, fold by fold."""
    runs: Int[np.ndarray, " U"]
    """Lengths of the runs of these blocks that are resampled together."""
    blocks: Int[np.ndarray, "R B"]
    """How often each block occurs in each resample."""
    times: int
    """Number of runs in the part."""
    seed: tuple[int, ...]

    @classmethod
    def of(
        cls, part: Draws, everyone: Sequence[tuple[Int[np.ndarray, " _"], Draws]]
    ) -> "FloorDraws":
        """Combine the draws of a part with those of all parts.

        `everyone` holds, for each part, the indices of its blocks and its draws.
        """
        return cls(
            np.concatenate([index for index, _ in everyone]),
            np.concatenate([draws.runs for _, draws in everyone]),
            np.concatenate([draws.blocks for _, draws in everyone], axis=1),
            len(part.runs),
            part.seed,
        )

    def centre(self) -> Int[np.ndarray, "count B"]:
        """Resamples of the recording, as counts per block."""
        rng = np.random.default_rng([*self.seed, 4])
        return _draw(rng, np.ones(len(self.runs)), self.times, FLOOR_DRAWS, self.runs)

    def nested(self, resample: int) -> Int[np.ndarray, "count B"]:
        """Resamples of one resample, as counts per block."""
        rng = np.random.default_rng([*self.seed, 1, resample])
        weight = self.blocks[resample, self.runs.cumsum() - self.runs].astype(np.float64)
        return _draw(rng, weight, self.times, NESTED_DRAWS, self.runs)


def energy(
    metric: Metric,
    recorded: Statistics,
    rollouts: Sequence[Sequence[Statistics]],
    blocks: TimeBlocks,
    draws: Draws,
    *,
    spread: bool = True,
) -> Energy | None:
    """Energy score of the rollouts of each fit, averaged over the fits.

    `rollouts[i][k]` holds the statistics of rollout k of fit i; all fits have the same number of
    rollouts. A single rollout per fit means that the model is deterministic. Without `spread`, the
    score is the mean distance, without its second term. Returns None if the metric is undefined
    because the recording's mean is 0.
    """
    fits, each = len(rollouts), len(rollouts[0])
    embedded = Embedded.of(metric, [recorded, *chain(*rollouts)], recorded, blocks)
    if embedded is None:
        return None
    to_y, between = embedded.distances(embedded.once, fits)
    centre = float(to_y.mean() - spread * pair_mean(between).mean() / 2)
    chosen, inside = draws.fits(fits), draws.rollouts(fits, each)
    resampled = np.empty(RESAMPLES)
    for part in embedded.chunks(RESAMPLES):
        to_y, between = embedded.distances(draws.blocks[part], fits)
        r = np.arange(len(to_y))[:, None, None]
        fit, k = chosen[part][:, :, None], inside[part]
        near = to_y[r, fit, k].mean(axis=(1, 2))
        if not spread:
            resampled[part] = near
            continue
        one, other = k[:, :, :, None], k[:, :, None, :]
        pairs = between[r[..., None], fit[..., None], one, other]
        # A rollout that is drawn twice is not a pair: its distance of 0 would bias the mean.
        distinct = (one != other).sum(axis=(-2, -1))
        whole = pair_mean(between)[r[..., 0], fit[..., 0]]
        mean = np.where(distinct > 0, pairs.sum(axis=(-2, -1)) / np.maximum(distinct, 1), whole)
        resampled[part] = near - mean.mean(axis=1) / 2
    return Energy(centre, resampled)


@dataclass(frozen=True, eq=False)
class FitEnergies:
    """The two terms of the energy score of each fit."""

    to_recorded: Float[np.ndarray, " fits"]
    """Mean d(X_k, y): distance of the rollouts to the recording."""
    spread: Float[np.ndarray, " fits"]
    """½ mean d(X_k, X_l): variation between rollouts; for the true process it equals F."""


def energies_of_fits(
    metric: Metric,
    recorded: Statistics,
    rollouts: Sequence[Sequence[Statistics]],
    blocks: TimeBlocks,
    *,
    spread: bool = True,
) -> FitEnergies | None:
    """The two terms of the energy score of each fit; None if the metric is undefined.

    Without `spread`, the second term is 0.
    """
    embedded = Embedded.of(metric, [recorded, *chain(*rollouts)], recorded, blocks)
    if embedded is None:
        return None
    to_y, between = embedded.distances(embedded.once, len(rollouts))
    return FitEnergies(to_y[0].mean(axis=1), spread * pair_mean(between[0]) / 2)


def floor(
    metric: Metric,
    recording: Statistics,
    recorded: Statistics,
    blocks: TimeBlocks,
    draws: FloorDraws,
) -> Energy | None:
    """The noise floor F: half the mean distance between two resamples of the recording.

    `recording` holds the statistics of all blocks of the recording. `recorded` holds those of the
    scored part, whose blocks are `blocks`; distances are normalised by it. Returns None if the
    metric is undefined.
    """
    everything = {name: values[draws.order] for name, values in recording.items()}
    embedded = Embedded.of(metric, [everything], recorded, blocks)
    if embedded is None:
        return None

    def half_means(weights: Int[np.ndarray, "n count B"]) -> Float[np.ndarray, " n"]:
        n, count, _ = weights.shape
        x = embedded(weights.reshape(n * count, -1))[:, 0].reshape(n, 1, count, -1)
        return pair_mean(_distances(x[:, 0, 0], x)[1])[:, 0] / 2

    resamples = np.stack([draws.nested(r) for r in range(RESAMPLES)])
    nested = [half_means(resamples[part]) for part in embedded.chunks(RESAMPLES, NESTED_DRAWS)]
    centre = half_means(draws.centre()[None])
    return Energy(float(centre[0]), np.concatenate(nested))


@dataclass(frozen=True, eq=False)
class Embedded:
    """The vectors of several crowds, as a function of how often each block is counted."""

    metric: Metric
    blocks: TimeBlocks
    support: np.ndarray
    stacked: Mapping[str, Float[np.ndarray, "B nV"]]
    crowds: int
    weight: Float[np.ndarray, " #F"]

    @classmethod
    def of(
        cls, metric: Metric, crowds: Sequence[Statistics], recorded: Statistics, blocks: TimeBlocks
    ) -> "Embedded | None":
        """Bring the crowds to a common support; None if the metric is undefined."""
        everyone, support = metric.aligned([*crowds, recorded], blocks)
        weight = metric.weights(total(everyone[-1]), support, blocks)
        if not np.isfinite(weight).all():
            return None
        stacked = {}
        for name in recorded:
            together = np.stack([c[name] for c in everyone[:-1]], axis=1)
            stacked[name] = together.reshape(len(together), -1).astype(np.float64)
        return cls(metric, blocks, support, stacked, len(crowds), weight)

    @property
    def once(self) -> Int[np.ndarray, "1 B"]:
        """Weights that count each block once."""
        return np.ones((1, len(self.blocks)), dtype=np.int64)

    def first(self, crowds: int) -> "Embedded":
        """The same for the first crowds only, on the support of all."""
        stacked = {
            name: values.reshape(len(values), self.crowds, -1)[:, :crowds].reshape(len(values), -1)
            for name, values in self.stacked.items()
        }
        return replace(self, stacked=stacked, crowds=crowds)

    def chunks(self, resamples: int, rows: int = 1) -> Iterator[slice]:
        """Slices of the resamples, of `rows` rows each, that are small enough for memory."""
        numbers = max(values.shape[1] for values in self.stacked.values()) * rows
        step = max(1, _NUMBERS // max(1, numbers))
        return (slice(start, start + step) for start in range(0, resamples, step))

    def __call__(self, weights: Int[np.ndarray, "r B"]) -> Float[np.ndarray, "r n F"]:
        """One weighted vector per resample and crowd."""
        w = weights.astype(np.float64)
        sums = {
            name: (w @ values).reshape(len(w), self.crowds, -1)
            for name, values in self.stacked.items()
        }
        return self.metric.embed(sums, self.support, self.blocks) * self.weight

    def distances(
        self, weights: Int[np.ndarray, "r B"], fits: int
    ) -> tuple[Float[np.ndarray, "r g K"], Float[np.ndarray, "r g K K"]]:
        """L1 distances of the other crowds, of `fits` fits, to the first one, and within fits."""
        x = self(weights)
        return _distances(x[:, 0], x[:, 1:].reshape(len(x), fits, -1, x.shape[-1]))


def pair_mean(distances: Float[np.ndarray, "*batch K K"]) -> Float[np.ndarray, "*batch"]:
    """Mean over ordered pairs k ≠ l; 0 if there is no pair."""
    k = distances.shape[-1]
    return distances.sum(axis=(-2, -1)) / max(1, k * (k - 1))


def _distances(
    y: Float[np.ndarray, "r F"], x: Float[np.ndarray, "r g K F"]
) -> tuple[Float[np.ndarray, "r g K"], Float[np.ndarray, "r g K K"]]:
    from crowdbench.scoring.l1_kernel import l1_distances

    return l1_distances(np.ascontiguousarray(y), np.ascontiguousarray(x))
