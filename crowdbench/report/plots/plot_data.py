"""Data of the pictures: an evaluation's crowds and the recording, in the same time blocks."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from crowdbench.colours import spawn_colours
from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.metrics import Metric, Statistics, Sums, Support, all_metrics, total
from crowdbench.metrics.lattice import correlation
from crowdbench.metrics.metric import in_blocks
from crowdbench.metrics.presence import LAGS_S, lag_key, lagged, usable_lags
from crowdbench.report.display_names import names_of
from crowdbench.scene import Scene
from crowdbench.scoring.energy import Draws
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.score import LEVEL
from crowdbench.scoring.scorecard import BASELINES
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.names import replays

Crowds = Mapping[tuple[str, str, int], Trajectories]
"""Rollouts by spawn model, policy and seed."""

DASHES: tuple[tuple[float, ...], ...] = ((), (5.0, 2.0), (1.5, 1.5), (6.0, 1.5, 1.5, 1.5))
_RESAMPLES = 200
_LAG_STEP_S = 2.0
_LONGEST_LAG_S = 120.0
_TAILS = (100 * LEVEL / 2, 100 * (1 - LEVEL / 2))


@dataclass(frozen=True, eq=False)
class Group:
    """Rollouts of a pair, with its colour (by spawn model) and dashes (by policy)."""

    spawn: str
    policy: str
    colour: str
    dashes: tuple[float, ...]
    crowds: list[Trajectories]
    label: str
    """Display name of the pair."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Distribution functions of one metric on a common support of V values."""

    support: Support
    recorded: Float[np.ndarray, "K V"]
    """The recording's, of one sample (K = 1) or of each of K areas."""
    band: tuple[Float[np.ndarray, "K V"], Float[np.ndarray, "K V"]]
    """Lower and upper limit of 95 % of the resamples of the recording's time blocks."""
    groups: Float[np.ndarray, "G K V"]
    """Those of each of G groups, with all rollouts of a group pooled."""

    def longest(self, k: int = 0, *, beyond: float = 0.004) -> int:
        """Smallest value that at most a share `beyond` of each sample exceeds."""
        each = [self.recorded[k], *self.groups[:, k]]
        at = max(int(np.searchsorted(f, 1 - beyond)) for f in each)
        return int(self.support[min(at, len(self.support) - 1)])


@dataclass(frozen=True, eq=False)
class Correlations:
    """The recording's autocorrelation of N(t) at L lags, with 95 % limits from resampled blocks."""

    lag_s: Float[np.ndarray, " L"]
    value: Float[np.ndarray, " L"]
    low: Float[np.ndarray, " L"]
    high: Float[np.ndarray, " L"]


@dataclass(frozen=True, eq=False)
class PlotData:
    """A recording and the crowds that pictures compare with it."""

    scene: Scene
    reference: Reference
    """Reference statistics in the time blocks on which `split` is scored."""
    split: str
    groups: list[Group]
    _known: dict[str, list[list[Statistics]]] = field(default_factory=dict, kw_only=True)
    """Statistics of each crowd of each group, by metric; filled on demand."""

    @classmethod
    def of(cls, scene: Scene, reference: Reference, crowds: Crowds, protocol: str) -> "PlotData":
        """Collect the plot data of a protocol's first split.

        Crowds under the recorded arrivals are left out, unless there are no others.
        """
        split = SPLITS[0] if protocol == "full" else SPLITS[1]
        inside = reference.blocks.in_split(split)
        seen = Reference(
            reference.blocks.scored(split),
            reference.place,
            {name: in_blocks(of, inside) for name, of in reference.statistics.items()},
        )
        pairs = list(dict.fromkeys((spawn, policy) for spawn, policy, _ in crowds))
        names = names_of([*pairs, *BASELINES], scene)  # the tables show the baselines too
        pairs = [pair for pair in pairs if not replays(pair[0])] or pairs
        colours = spawn_colours([spawn for spawn, _ in pairs])
        policies = list(dict.fromkeys(policy for _, policy in pairs))
        groups = [
            Group(
                spawn,
                policy,
                colours[spawn],
                DASHES[policies.index(policy) % len(DASHES)],
                [crowd for key, crowd in crowds.items() if key[:2] == (spawn, policy)],
                names.pair(spawn, policy),
            )
            for spawn, policy in pairs
        ]
        return cls(scene, seen, split, groups)

    @cached_property
    def areas(self) -> Areas:
        """The scene's spawn and goal areas."""
        return read_areas(self.scene)

    @cached_property
    def _draws(self) -> Draws:
        return Draws.of(
            self.reference.blocks,
            resample_s=self.scene.protocol.resample_s,
            block_s=self.scene.protocol.block_s,
            seed=(SPLITS.index(self.split),),
        )

    def pooled(self, name: str) -> tuple[list[Sums], Support]:
        """A metric's sums over all blocks (the recording's, then each group's), and its support."""
        recorded, groups, support = self._aligned(name)
        return [total(recorded), *groups], support

    def cells(self, name: str) -> list[np.ndarray]:
        """Shares in the cells of a metric that has cells: the recording's, then each group's."""
        each = [
            self.reference.statistics[name]["counts"].sum(axis=0),
            *(sum(s["counts"].sum(axis=0) for s in group) for group in self._statistics(name)),
        ]
        return [counts / max(1, counts.sum()) for counts in each]

    def curves(self, name: str, samples: int = 1) -> Curves:
        """Distribution functions of a metric that compares distributions, for `samples` areas."""
        metric = _metric(name)
        recorded, groups, support = self._aligned(name)
        times = self._draws.blocks[:_RESAMPLES]
        resampled = {n: times @ values for n, values in recorded.items()}

        def embedded(sums: Sums) -> np.ndarray:
            values = metric.embed(sums, support, self.reference.blocks)
            return values.reshape(*values.shape[:-1], samples, len(support))

        low, high = np.percentile(embedded(resampled), _TAILS, axis=0)
        return Curves(
            support,
            embedded(total(recorded)),
            (low, high),
            np.stack([embedded(sums) for sums in groups]),
        )

    @property
    def lags_s(self) -> Float[np.ndarray, " L"]:
        """Lags of the autocorrelation in pictures, s: those for which blocks are long enough."""
        steps = np.arange(0.0, _LONGEST_LAG_S + _LAG_STEP_S / 2, _LAG_STEP_S)
        return np.array(usable_lags(steps.tolist(), self.reference.blocks))

    def autocorrelations(self, lags_s: Sequence[float]) -> Float[np.ndarray, "G L"]:
        """Mean autocorrelation of N(t) over the rollouts of each group, at the given lags."""
        blocks = self.reference.blocks
        means = [
            np.mean([correlation(lagged(c, blocks, lags_s).sum(axis=1)) for c in g.crowds], axis=0)
            for g in self.groups
        ]
        return np.array(means).reshape(len(self.groups), len(lags_s))

    def compared_autocorrelation(self) -> Correlations:
        """The recording's autocorrelation at the lags that the metric compares."""
        lags_s = usable_lags(LAGS_S, self.reference.blocks)
        known = self.reference.statistics["autocorrelation"] if lags_s else {}
        sums = np.array([known[lag_key(lag_s)] for lag_s in lags_s])
        return self.correlations(lags_s, sums.reshape(len(lags_s), len(self.reference.blocks), 6))

    def correlations(self, lags_s: list[float], sums: Int[np.ndarray, "L B 6"]) -> Correlations:
        """Autocorrelation from sums that `lagged` computes from the recording."""
        times = self._draws.blocks[:_RESAMPLES]
        resampled = correlation(np.einsum("rb,lbk->rlk", times, sums))
        low, high = np.percentile(resampled, _TAILS, axis=0)
        return Correlations(np.array(lags_s), np.asarray(correlation(sums.sum(axis=1))), low, high)

    def _aligned(self, name: str) -> tuple[Statistics, list[Sums], Support]:
        """The recording's statistics, each group's sums, and their common support."""
        statistics = self._statistics(name)
        everyone = [self.reference.statistics[name], *(s for group in statistics for s in group)]
        (recorded, *crowds), support = _metric(name).aligned(everyone, self.reference.blocks)
        sums = iter([total(s) for s in crowds])
        groups = []
        for group in self.groups:
            each = [next(sums) for _ in group.crowds]
            groups.append({n: np.sum([s[n] for s in each], axis=0) for n in recorded})
        return recorded, groups, support

    def _statistics(self, name: str) -> list[list[Statistics]]:
        if name not in self._known:
            summarise = _metric(name).summarise
            blocks, place = self.reference.blocks, self.reference.place
            self._known[name] = [
                [summarise(crowd, blocks, place) for crowd in group.crowds] for group in self.groups
            ]
        return self._known[name]


def _metric(name: str) -> Metric:
    return next(m for m in all_metrics() if m.name == name)
