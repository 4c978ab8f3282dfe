"""The proper score: energy scores, their floor and anchor, intervals, ranks.

A plain distance rewards a model that varies too little or that has memorised the recording's
marginals. The energy form of the same distance does not (Gneiting & Raftery 2007, Sec. 5.1, with
the negative-type distances of `crowdbench.metrics`): for rollouts X of a model and the recording y

    ES = mean d(X_k, y) − ½ mean d(X_k, X_l)   over pairs of distinct rollouts,
    F  = ½ mean d(y*, y**)                     over resamples y*, as long as y, of the recording,
    S  = 1 − (ES − F) / (ES_anchor − F)

so that S is 0 for the anchor and, on average, 1 for the process that made the recording. Where
crowds walk under the recorded arrivals, F is 0 and S is 1 for the recording itself.

Uncertainty comes from 1,000 hierarchical resamples: of time blocks (the same for all entries, so
that entries can be compared on them), of fits, and of rollouts within fits.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int

from crowdbench.metrics import Metric, Statistics, total
from crowdbench.trajectories.blocks import TimeBlocks

RESAMPLES = 1000
FLOOR_DRAWS = 200
"""Block resamples whose pairs give F."""
NESTED_DRAWS = 20
"""Resamples of a resample, whose pairs give F there."""
_NUMBERS = 4_000_000  # at a time: few large steps keep threads from waiting for each other


@dataclass(frozen=True, eq=False)
class Energy:
    """An energy score, or a floor, with its resamples; `R` of them."""

    centre: float
    resampled: Float[np.ndarray, " R"]

    def deviations(self) -> Float[np.ndarray, " R"]:
        """The resamples' deviations from their own centre.

        A resample has fewer distinct blocks than the recording, which moves its mean.
        """
        return self.resampled - self.resampled.mean()


def mean_of(energies: Sequence[Energy]) -> Energy:
    """The mean over folds."""
    return Energy(
        float(np.mean([e.centre for e in energies])),
        np.mean([e.resampled for e in energies], axis=0),
    )


@dataclass(frozen=True, eq=False)
class Draws:
    """What each of `R` resamples consists of, for one part of a recording with `B` blocks."""

    blocks: Int[np.ndarray, "R B"]
    """How often each block counts."""
    units: tuple[tuple[int, int], ...]
    """Runs [start, stop) of blocks that are drawn together."""
    seed: tuple[int, ...]

    @classmethod
    def of(
        cls, blocks: TimeBlocks, *, resample_s: float, block_s: float, seed: tuple[int, ...]
    ) -> "Draws":
        """Draw units of `resample_s` (runs of consecutive scored blocks) with replacement."""
        run = max(1, round(resample_s / block_s))
        edges = [*range(0, len(blocks), run), len(blocks)]
        units = tuple((a, b) for a, b in pairwise(edges))
        rng = np.random.default_rng([*seed, 0])
        return cls(_drawn(rng, np.ones(len(units)), len(units), RESAMPLES, units), units, seed)

    def fits(self, fits: int) -> Int[np.ndarray, "R fits"]:
        """Which fits each resample consists of."""
        return np.random.default_rng([*self.seed, 2]).integers(fits, size=(RESAMPLES, fits))

    def rollouts(self, fits: int, rollouts: int) -> Int[np.ndarray, "R fits rollouts"]:
        """Which rollouts of each of its fits."""
        rng = np.random.default_rng([*self.seed, 3])
        return rng.integers(rollouts, size=(RESAMPLES, fits, rollouts))


def _drawn(
    rng: np.random.Generator,
    weight: Float[np.ndarray, " U"],
    times: int,
    count: int,
    units: tuple[tuple[int, int], ...],
) -> Int[np.ndarray, "count B"]:
    """Draw `times` units with replacement, `count` times; how often each block is among them."""
    drawn = rng.multinomial(times, weight / weight.sum(), size=count)
    return np.repeat(drawn, [stop - start for start, stop in units], axis=1)


@dataclass(frozen=True, eq=False)
class FloorDraws:
    """What F of a part is computed from: resamples of the whole recording, as long as the part.

    The few blocks of a fold alone would make F too small by a fifth and more: resamples of six
    blocks vary less than recordings of six blocks do. F tells of the recording, not of a model, so
    nothing is learned from what is held out.
    """

    order: Int[np.ndarray, " B"]
    """The recording's blocks, fold by fold."""
    units: tuple[tuple[int, int], ...]
    """Runs of them that are drawn together."""
    blocks: Int[np.ndarray, "R B"]
    """How often each counts in each resample."""
    times: int
    """Units of the part."""
    seed: tuple[int, ...]

    @classmethod
    def of(
        cls, part: Draws, everyone: Sequence[tuple[Int[np.ndarray, " b"], Draws]]
    ) -> "FloorDraws":
        """From the draws of the part, and those of all parts with the blocks they are of."""
        units: list[tuple[int, int]] = []
        for _, draws in everyone:
            first = units[-1][1] if units else 0
            units += [(first + a, first + b) for a, b in draws.units]
        return cls(
            np.concatenate([index for index, _ in everyone]),
            tuple(units),
            np.concatenate([draws.blocks for _, draws in everyone], axis=1),
            len(part.units),
            part.seed,
        )

    def centre(self) -> Int[np.ndarray, "count B"]:
        """Resamples of the recording."""
        rng = np.random.default_rng([*self.seed, 4])
        return _drawn(rng, np.ones(len(self.units)), self.times, FLOOR_DRAWS, self.units)

    def nested(self, resample: int) -> Int[np.ndarray, "count B"]:
        """Resamples of one resample."""
        rng = np.random.default_rng([*self.seed, 1, resample])
        weight = np.array([self.blocks[resample, start] for start, _ in self.units], dtype=float)
        return _drawn(rng, weight, self.times, NESTED_DRAWS, self.units)


def energy(
    metric: Metric,
    recorded: Statistics,
    rollouts: Sequence[Sequence[Statistics]],
    blocks: TimeBlocks,
    draws: Draws,
) -> Energy | None:
    """Energy score of the rollouts of each fit, averaged over the fits.

    `rollouts[i][k]` are the statistics of rollout k of fit i, all fits having as many. A single
    rollout per fit stands for a model without chance. None where the metric is undefined, since
    the recording's mean is 0.
    """
    fits, each = len(rollouts), len(rollouts[0])
    crowds = [recorded, *(crowd for fit in rollouts for crowd in fit)]
    embedded = Embedded.of(metric, crowds, recorded, blocks)
    if embedded is None:
        return None

    def split(of: Float[np.ndarray, "r n F"]) -> tuple[np.ndarray, np.ndarray]:
        return _distances(of[:, 0], of[:, 1:].reshape(len(of), fits, each, of.shape[-1]))

    to_y, between = split(embedded(np.ones((1, len(blocks)), dtype=np.int64)))
    centre = float(to_y.mean() - pair_mean(between).mean() / 2)
    chosen, inside = draws.fits(fits), draws.rollouts(fits, each)
    resampled = np.empty(RESAMPLES)
    for part in embedded.chunks(RESAMPLES):
        to_y, between = split(embedded(draws.blocks[part]))
        r = np.arange(len(to_y))[:, None, None]
        fit, k = chosen[part][:, :, None], inside[part]
        near = to_y[r, fit, k].mean(axis=(1, 2))
        one, other = k[:, :, :, None], k[:, :, None, :]
        pairs = between[r[..., None], fit[..., None], one, other]
        # A rollout drawn twice is no pair of rollouts: its distance of 0 would only be noise.
        distinct = (one != other).sum(axis=(-2, -1))
        whole = pair_mean(between)[r[..., 0], fit[..., 0]]
        mean = np.where(distinct > 0, pairs.sum(axis=(-2, -1)) / np.maximum(distinct, 1), whole)
        resampled[part] = near - mean.mean(axis=1) / 2
    return Energy(centre, resampled)


@dataclass(frozen=True, eq=False)
class FitEnergies:
    """What each fit alone gets, of the energy score's two terms."""

    to_recorded: Float[np.ndarray, " fits"]
    """Mean d(X_k, y)."""
    spread: Float[np.ndarray, " fits"]
    """½ mean d(X_k, X_l): how much rollouts differ; that of the true process is F."""


def energies_of_fits(
    metric: Metric,
    recorded: Statistics,
    rollouts: Sequence[Sequence[Statistics]],
    blocks: TimeBlocks,
) -> FitEnergies | None:
    """The energy score's terms fit by fit; None where the metric is undefined."""
    crowds = [recorded, *(crowd for fit in rollouts for crowd in fit)]
    embedded = Embedded.of(metric, crowds, recorded, blocks)
    if embedded is None:
        return None
    x = embedded(np.ones((1, len(blocks)), dtype=np.int64))
    to_y, between = _distances(
        x[:, 0], x[:, 1:].reshape(1, len(rollouts), len(rollouts[0]), x.shape[-1])
    )
    return FitEnergies(to_y[0].mean(axis=1), pair_mean(between[0]) / 2)


def floor(
    metric: Metric,
    recording: Statistics,
    recorded: Statistics,
    blocks: TimeBlocks,
    draws: FloorDraws,
) -> Energy | None:
    """F: half the mean distance of two resamples of the recording.

    `recording` are the statistics of all its blocks, `recorded` those of the part, which `blocks`
    are and distances are divided by.
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
    """The vectors of several crowds, given how often each block counts."""

    metric: Metric
    blocks: TimeBlocks
    support: np.ndarray
    stacked: Mapping[str, Float[np.ndarray, "B nV"]]
    crowds: int
    weight: Float[np.ndarray, " #F"]

    @classmethod
    def of(
        cls,
        metric: Metric,
        crowds: Sequence[Statistics],
        recorded: Statistics,
        blocks: TimeBlocks,
    ) -> "Embedded | None":
        """Bring the crowds to one support; None where the metric is undefined."""
        everyone, support = metric.aligned([*crowds, recorded], blocks)
        weight = metric.weights(total(everyone[-1]), support, blocks)
        if not np.isfinite(weight).all():
            return None
        stacked = {}
        for name in recorded:
            together = np.stack([c[name] for c in everyone[:-1]], axis=1)
            stacked[name] = together.reshape(len(together), -1).astype(np.float64)
        return cls(metric, blocks, support, stacked, len(crowds), weight)

    def chunks(self, resamples: int, rows: int = 1) -> Iterator[slice]:
        """Runs of resamples, of so many rows each, that fit into memory together."""
        numbers = max(values.shape[1] for values in self.stacked.values()) * rows
        step = max(1, _NUMBERS // max(1, numbers))
        return (slice(start, start + step) for start in range(0, resamples, step))

    def __call__(self, weights: Int[np.ndarray, "r B"]) -> Float[np.ndarray, "r n F"]:
        """One vector per resample and crowd, already weighted."""
        w = weights.astype(np.float64)
        sums = {
            name: (w @ values).reshape(len(w), self.crowds, -1)
            for name, values in self.stacked.items()
        }
        return self.metric.embed(sums, self.support, self.blocks) * self.weight


def pair_mean(distances: Float[np.ndarray, "*batch K K"]) -> Float[np.ndarray, "*batch"]:
    """Mean over ordered pairs k ≠ l; 0 where there is no pair."""
    k = distances.shape[-1]
    return distances.sum(axis=(-2, -1)) / max(1, k * (k - 1))


def _distances(
    y: Float[np.ndarray, "r F"], x: Float[np.ndarray, "r g K F"]
) -> tuple[Float[np.ndarray, "r g K"], Float[np.ndarray, "r g K K"]]:
    """L1 distances of each x to y, and of all x of a group to each other."""
    from crowdbench.scoring.l1_kernel import l1_distances

    return l1_distances(np.ascontiguousarray(y), np.ascontiguousarray(x))
