"""Companions as marks on arrivals: who walks with whom, whatever model the times come from.

Person i joins an earlier arrival j of the same area, not more than 6 s before, with a probability
proportional to w(t_i − t_j) exp(u_a + v(n_j)) / m_i^c, and nobody with a probability proportional
to 1. w has a value for each bin of delays. u_a is the tendency of area a to send groups. v is that
of the group of j to take in one more: n_j = 1, 2, 3, or 4 and more is the number of its people who
have come so far, and v(1) = 0. Without v, there would be too many large groups, and too few of two.
m_i is the number of people whom i may join: without c, too many people would join somebody where
many enter. The likelihood of the marks does not change that of the arrivals. A person who joins
takes the plan of the other one, moved by an offset in the direction of the other's way.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.data.companions import ENTRY_S
from crowdbench.data.table import Flags, Indices, Numbers
from crowdbench.spawn.drawing import draw_normal
from crowdbench.spawn.plans.mixtures import moments, responsibilities

EDGES_S = (0.0, 1e-6, 1.0, 2.0, 3.0, 4.5, ENTRY_S + 1e-6)
"""Limits of the bins of delays; the first contains people who enter at the same grid point."""
SPREAD = 0.7
"""Standard deviation of the normal prior of u_a."""
_FURTHEST = 30.0  # largest tendency
_HALVINGS = 14
_DRAWN = 4_000  # number of people from whom the mean size of groups is estimated
_MOST = 4
"""Largest number of components of the mixture of offsets; more hardly change what is drawn."""
STAGES = 4
"""Number of values of v; the first one, of people who are alone, is 0."""
_PARTS = [6, 5 + STAGES, 6 + STAGES]
"""Where v, c and u begin in the numbers that are fitted; those of w are the first ones."""
FEWEST = 10
"""With fewer pairs of companions, offsets are those of all scenes together."""
OFFSETS = 5
"""Along and across at the start, along and across at the end, and the gain: by how many metres
more the one who joins walks while both are there."""
COMMON_MEAN = np.array([0.0, 0.7, 0.0, 0.7, 0.0])
COMMON_COVARIANCE = np.diag(np.array([0.4, 0.3, 0.6, 0.3, 0.5]) ** 2)
"""Rounded moments of the offsets over the scenes with most companions."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pairs (i, j) of arrivals of one area of which i may join j, sorted by i."""

    later: Indices
    earlier: Indices
    bin: Indices
    """Bin of the delay."""

    def log_number(self) -> Numbers:
        """Log of the number of people whom i may join."""
        return np.log(np.bincount(self.later, minlength=1)[self.later])

    def same(self, group: Int[np.ndarray, " E"]) -> Flags:
        """Whether both persons of each pair belong to the same group."""
        mine = group[self.later]
        return np.asarray((mine >= 0) & (mine == group[self.earlier]))


@dataclass(frozen=True)
class Adjustment:
    """By how much links are changed, so that a model has as many companions as the recording."""

    more: float = 0.0
    """Added to all log weights."""
    larger: float = 0.0
    """Added to the log weights of joining three people or more; half of it to those of two."""
    along: float = 1.0
    """Factor of the offsets along the way, and of the gain."""
    across: float = 1.0
    """Factor of the offsets across the way."""


@dataclass(frozen=True, eq=False)
class Links:
    """The model of companions for `K` areas."""

    log_weight: Float[np.ndarray, " 6"]
    """log w for each bin of delays."""
    tendency: Float[np.ndarray, " K"]
    """u_a for each area."""
    larger: Float[np.ndarray, " 3"]
    """v for groups of two, of three, and of four and more."""
    share: Float[np.ndarray, " C"] = field(default_factory=lambda: np.ones(1))
    """Shares of the components of the mixture of offsets."""
    mean: Float[np.ndarray, "C 5"] = field(default_factory=lambda: COMMON_MEAN[None])
    """Mean offsets to a person who enters at the same time. The sign across is drawn, the same at
    start and end."""
    covariance: Float[np.ndarray, "C 5 5"] = field(default_factory=lambda: COMMON_COVARIANCE[None])
    slope: Float[np.ndarray, " 5"] = field(default_factory=lambda: np.zeros(OFFSETS))
    """Change of the mean offsets for each metre that the other one has walked meanwhile."""
    same_side: float = 0.5
    """P(the third and later people of a group are on the same side of the one before them as that
    one is of the one before)."""
    group_log_speed: float = 0.0
    """Mean log speed of groups less that of people who are alone."""
    crowded: float = 0.0
    """c, by which weights depend on the number of people whom one may join."""

    @cached_property
    def _roots(self) -> Float[np.ndarray, "C 5 5"]:
        return np.linalg.cholesky(self.covariance)

    def draw(self, time_s: Numbers, area: Indices, rng: Generator) -> Indices:
        """The person whom each of these arrivals (in order of time) joins; −1 for nobody."""
        from crowdbench.spawn.plans.link_kernels import draw_joins

        pairs = candidates(time_s, area)
        log_weight = self.log_weight[pairs.bin] + self.tendency[area[pairs.later]]
        weight = np.exp(log_weight - self.crowded * pairs.log_number())
        begin = np.searchsorted(pairs.later, np.arange(len(time_s) + 1))
        factor = np.exp([0.0, *self.larger])
        return draw_joins(pairs.earlier, begin, weight, factor, rng.random(len(time_s)))

    def with_group_size(self, area: int, time_s: Numbers, size: float) -> "Links":
        """Another tendency of an area, for which groups have this mean size, counting one.

        It depends on the times (ascending, seconds) at which people enter the area: those who
        follow nobody within 6 s are alone. The nearest possible mean is taken.
        """
        if len(time_s) == 0:
            return self
        of_area = np.full(len(time_s), area)
        draws = -(-_DRAWN // len(time_s))

        def steered(tendency: float) -> Links:
            every = self.tendency.copy()
            every[area] = tendency
            return replace(self, tendency=every)

        low, high = -_FURTHEST, _FURTHEST
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            # The same random numbers each time: the mean size grows with the tendency.
            rng = np.random.default_rng(0)
            joins = [steered(middle).draw(time_s, of_area, rng) >= 0 for _ in range(draws)]
            larger = 1 / (1 - np.mean(joins)) < size
            low, high = (middle, high) if larger else (low, middle)
        return steered((low + high) / 2)

    def offsets(
        self, walked_m: Numbers, side_before: Numbers, rng: Generator
    ) -> tuple[Float[np.ndarray, "n 5"], Numbers]:
        """Offsets of persons who join somebody who has walked this far, and their sides, ±1.

        `side_before` is the side of the one whom they join, 0 for the first of a group. See
        `OFFSETS`.
        """
        size = len(walked_m)
        component = np.searchsorted(self.share.cumsum(), rng.random(size) * self.share.sum())
        component = component.clip(0, len(self.share) - 1)
        drawn = draw_normal(self.mean[component], self._roots[component], rng)
        drawn += walked_m[:, None] * self.slope
        usual = np.where(side_before == 0, 0.5, self.same_side)
        side = np.where(rng.random(size) < usual, 1.0, -1.0)
        side *= np.where(side_before == 0, 1.0, side_before)
        drawn[:, (1, 3)] *= side[:, None]
        return drawn, side

    def adjusted(self, by: Adjustment) -> "Links":
        """The same links, adjusted to the times of a model."""
        of_larger = self.larger + np.where(np.arange(len(self.larger)) > 0, 1.0, 0.5) * by.larger
        factor = np.array([by.along, by.across, by.along, by.across, by.along])
        return replace(
            self,
            log_weight=self.log_weight + by.more,
            larger=of_larger,
            mean=self.mean * factor,
            covariance=self.covariance * np.outer(factor, factor),
        )

    def with_offsets(self, offsets: Float[np.ndarray, "n 5"], walked_m: Numbers) -> "Links":
        """The same links with offsets fitted to these, those of recorded companions.

        They are offsets to persons who have walked `walked_m` before. Too few change nothing.
        """
        if len(offsets) < FEWEST:
            return self
        mirrored = np.where(offsets[:, 1:2] < 0, [1, -1, 1, -1, 1], 1)
        folded = offsets * mirrored  # all are to the left at the start
        middle, walked = np.median(folded, axis=0), walked_m - walked_m.mean()
        low, high = np.percentile(folded, [16, 84], axis=0)
        reach = 3 * np.maximum(high - low, 0.1)
        folded = middle + (folded - middle).clip(-reach, reach)  # against single wild values
        slope = np.zeros(OFFSETS)
        if walked.var() > 1e-6:
            slope = walked @ (folded - folded.mean(axis=0)) / (walked @ walked)
        folded = folded - walked_m[:, None] * slope
        shares = responsibilities(folded, 1e-2, _MOST)
        people = shares.sum(axis=0)
        enough = people >= FEWEST
        shares = shares[:, enough] if enough.any() else np.ones((len(folded), 1))
        means, covariances = zip(*(moments(folded, each) for each in shares.T), strict=True)
        people = shares.sum(axis=0)
        return replace(
            self,
            share=people / people.sum(),
            mean=np.stack(means),
            covariance=np.stack(covariances) + 1e-4 * np.eye(OFFSETS),
            slope=slope,
        )


def candidates(time_s: Numbers, area: Indices) -> Candidates:
    """Whom each of these arrivals, in order of time, may join."""
    later, earlier = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for k in np.unique(area).tolist():
        mine = np.flatnonzero(area == k)
        first = np.searchsorted(time_s[mine], time_s[mine] - EDGES_S[-1])
        number = np.arange(len(mine)) - first
        later.append(np.repeat(mine, number))
        begin = np.repeat(first - np.concatenate([[0], np.cumsum(number)[:-1]]), number)
        earlier.append(mine[begin + np.arange(number.sum())])
    i, j = np.concatenate(later), np.concatenate(earlier)
    order = np.lexsort((j, i))
    i, j = i[order], j[order]
    delay = time_s[i] - time_s[j]
    return Candidates(i, j, np.searchsorted(EDGES_S, delay, side="right").clip(1, 6) - 1)


def fit_links(time_s: Numbers, area: Indices, group: Indices, areas: int) -> Links:
    """The most likely weights, with a normal prior of the tendencies.

    `time_s` are ascending, `group` is −1 for people who are alone. Offsets are those of all scenes
    together.
    """
    from scipy.optimize import minimize

    pairs = candidates(time_s, area)
    same, stage = pairs.same(group), stages(pairs, area, group)

    def loss(x: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        value, slope = log_likelihood(x, pairs, area, same, stage)
        # A weak prior keeps weights of bins without pairs finite.
        spread = np.concatenate([np.full(6, 5.0), np.ones(STAGES), np.full(areas, SPREAD)])
        off = (x - centre) / spread
        return -value + 0.5 * float(off @ off), -slope + off / spread

    centre = np.concatenate([np.full(6, -3.0), np.zeros(STAGES + areas)])
    found = minimize(loss, centre, jac=True, method="L-BFGS-B").x
    log_weight, larger, crowded, tendency = np.split(found, _PARTS)
    return Links(log_weight, tendency, larger, crowded=float(crowded[0]))


def stages(pairs: Candidates, area: Int[np.ndarray, " E"], group: Int[np.ndarray, " E"]) -> Indices:
    """Size of the group of j when i enters, less one, at most 3, for each pair (i, j)."""
    alone = group < 0
    number = np.where(alone, np.arange(len(group)), group)
    _, label = np.unique(np.column_stack([alone, area, number]), axis=0, return_inverse=True)
    label = label.ravel().astype(np.int64)
    entered = np.sort(label * len(label) + np.arange(len(label)))
    of_group = label[pairs.earlier] * len(label)
    before = np.searchsorted(entered, of_group + pairs.later) - np.searchsorted(entered, of_group)
    return np.asarray(before.clip(1, STAGES) - 1)


def log_likelihood(
    x: Float[np.ndarray, " X"],
    pairs: Candidates,
    area: Int[np.ndarray, " E"],
    same: Flags,
    stage: Indices,
) -> tuple[float, Float[np.ndarray, " X"]]:
    """Log-probability that each person joins its group, or nobody, in nats; and its gradient.

    `x` are log w, v, c and u, one after the other; `same` and `stage` are those of the pairs.
    """
    of_area = area[pairs.later]
    log_weight, larger, (crowded,), tendency = np.split(x, _PARTS)
    log_number = pairs.log_number()
    weight = np.exp(
        log_weight[pairs.bin]
        + np.append(0.0, larger)[stage]
        - crowded * log_number
        + tendency[of_area]
    )
    size = len(area)
    total = 1.0 + np.bincount(pairs.later, weight, minlength=size)
    to_group = np.bincount(pairs.later, weight * same, minlength=size)
    joins = np.bincount(pairs.later, same, minlength=size) > 0
    value = float(np.log(to_group[joins]).sum() - np.log(total).sum())
    towards = np.divide(same, to_group[pairs.later], out=np.zeros(len(same)), where=same)
    each = weight * (towards - 1.0 / total[pairs.later])
    slope = np.concatenate(
        [
            np.bincount(pairs.bin, each, minlength=6),
            np.bincount(stage, each, minlength=STAGES)[1:],
            [-each @ log_number],
            np.bincount(of_area, each, minlength=len(tendency)),
        ]
    )
    return value, slope
