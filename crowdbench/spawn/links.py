"""Companions as marks on arrivals: who walks with whom, whatever model the times come from.

Person i joins an earlier arrival j of the same area, not more than 6 s before, with a probability
proportional to w(t_i − t_j) e^{u_a}, and nobody with a probability proportional to 1. w has a value
for each bin of delays, u_a is the tendency of area a to send groups. The likelihood of the marks
does not change that of the arrivals. A person who joins takes the plan of the other one, moved by
an offset in the direction of the other's way.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.trajectories.companions import ENTRY_S

EDGES_S = (0.0, 1e-6, 1.0, 2.0, 3.0, 4.5, ENTRY_S + 1e-6)
"""Limits of the bins of delays; the first contains people who enter at the same grid point."""
SPREAD = 0.7
"""Standard deviation of the normal prior of u_a."""
_FURTHEST = 30.0
"""Largest tendency."""
FEWEST = 10
"""With fewer pairs of companions, offsets are those of all scenes together."""
OFFSETS = 5
"""Along and across at the start, along and across at the end, and log ratio of the speeds."""
COMMON_MEAN = np.array([0.0, 0.7, 0.0, 0.6, 0.0])
COMMON_SD = np.array([0.4, 0.3, 0.6, 0.3, 0.15])
"""Rounded means and standard deviations of the offsets over the scenes with most companions."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """Pairs (i, j) of arrivals of one area of which i may join j, sorted by i."""

    later: Int[np.ndarray, " n"]
    earlier: Int[np.ndarray, " n"]
    bin: Int[np.ndarray, " n"]
    """Bin of the delay."""


@dataclass(frozen=True, eq=False)
class Links:
    """The model of companions for `K` areas."""

    log_weight: Float[np.ndarray, " 6"]
    """log w for each bin of delays."""
    tendency: Float[np.ndarray, " K"]
    """u_a for each area."""
    mean: Float[np.ndarray, " 5"]
    """Mean offset to a person who enters at the same time. The sign across is drawn, the same at
    start and end."""
    slope: Float[np.ndarray, " 5"]
    """Change of the mean offset for each metre that the other one has walked meanwhile."""
    covariance: Float[np.ndarray, "5 5"]
    group_log_speed: float = 0.0
    """Mean log speed of groups less that of people who are alone."""

    def draw(
        self, time_s: Float[np.ndarray, " E"], area: Int[np.ndarray, " E"], rng: Generator
    ) -> Int[np.ndarray, " E"]:
        """The person whom each of these arrivals (in order of time) joins; −1 for nobody."""
        pairs = candidates(time_s, area)
        weight = np.exp(self.log_weight[pairs.bin] + self.tendency[area[pairs.later]])
        upto = np.concatenate([[0.0], np.cumsum(weight)])
        begin, stop = (
            np.searchsorted(pairs.later, np.arange(len(time_s)), side=side)
            for side in ("left", "right")
        )
        total = upto[stop] - upto[begin]
        aim = rng.random(len(time_s)) * (1 + total)
        joins = aim < total
        chosen = np.searchsorted(upto, upto[begin] + aim, side="right") - 1
        found = np.full(len(time_s), -1)
        found[joins] = pairs.earlier[chosen[joins].clip(0, len(pairs.earlier) - 1)]
        return found

    def with_group_size(self, area: int, time_s: Float[np.ndarray, " E"], size: float) -> "Links":
        """Another tendency of an area, for which groups have this mean size, counting one.

        It depends on the times (ascending, seconds) at which people enter the area: those who
        follow nobody within 6 s are alone. The nearest possible mean is taken.
        """
        from scipy.optimize import brentq

        of_area = np.zeros(len(time_s), dtype=np.int64)
        pairs = candidates(time_s, of_area)
        weight = np.bincount(pairs.later, np.exp(self.log_weight[pairs.bin]), len(time_s))

        def excess(tendency: float) -> float:
            factor = np.exp(tendency)
            alone = len(time_s) - float((weight * factor / (1 + weight * factor)).sum())
            return len(time_s) / alone - size

        if len(time_s) == 0:
            return self
        low, high = -_FURTHEST, _FURTHEST
        if excess(high) <= 0:
            found = high
        elif excess(low) >= 0:
            found = low
        else:
            found = float(brentq(excess, low, high))
        tendency = self.tendency.copy()
        tendency[area] = found
        return replace(self, tendency=tendency)

    def offsets(
        self, walked_m: Float[np.ndarray, " n"], rng: Generator
    ) -> Float[np.ndarray, "n 5"]:
        """Offsets of persons who join somebody who has walked this far; see `OFFSETS`."""
        size = len(walked_m)
        drawn = rng.multivariate_normal(self.mean, self.covariance, size)
        drawn += walked_m[:, None] * self.slope
        side = np.where(rng.random(size) < 0.5, -1.0, 1.0)
        drawn[:, (1, 3)] *= side[:, None]
        return drawn

    def log_likelihood(
        self,
        time_s: Float[np.ndarray, " E"],
        area: Int[np.ndarray, " E"],
        group: Int[np.ndarray, " E"],
    ) -> float:
        """Log-probability of who joins which group, in total, nats."""
        pairs = candidates(time_s, area)
        value, _ = _likelihood(
            np.concatenate([self.log_weight, self.tendency]), pairs, area, _same(pairs, group)
        )
        return value


def candidates(time_s: Float[np.ndarray, " E"], area: Int[np.ndarray, " E"]) -> Candidates:
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


def fit_links(
    time_s: Float[np.ndarray, " E"],
    area: Int[np.ndarray, " E"],
    group: Int[np.ndarray, " E"],
    offsets: Float[np.ndarray, "n 5"],
    walked_m: Float[np.ndarray, " n"],
    areas: int,
) -> Links:
    """The most likely weights, with a normal prior of the tendencies.

    `group` is −1 for people who are alone; `offsets` are those of recorded companions to persons
    who have walked `walked_m` before.
    """
    from scipy.optimize import minimize

    order = np.argsort(time_s, kind="stable")
    time_s, area, group = time_s[order], area[order], group[order]
    pairs = candidates(time_s, area)
    same = _same(pairs, group)

    def loss(x: Float[np.ndarray, " n"]) -> tuple[float, Float[np.ndarray, " n"]]:
        value, slope = _likelihood(x, pairs, area, same)
        # A weak prior keeps weights of bins without pairs finite.
        spread = np.concatenate([np.full(6, 5.0), np.full(areas, SPREAD)])
        centre = np.concatenate([np.full(6, -3.0), np.zeros(areas)])
        off = (x - centre) / spread
        return -value + 0.5 * float(off @ off), -slope + off / spread

    start = np.concatenate([np.full(6, -3.0), np.zeros(areas)])
    found = minimize(loss, start, jac=True, method="L-BFGS-B").x
    folded = offsets * np.where(offsets[:, 1:2] < 0, [1, -1, 1, -1, 1], 1)
    mean, slope, covariance = COMMON_MEAN, np.zeros(OFFSETS), np.diag(COMMON_SD**2)
    if len(folded) >= FEWEST:
        middle = np.median(folded, axis=0)
        spread = np.percentile(folded, [16, 84], axis=0)
        near = (np.abs(folded - middle) <= 1.5 * np.maximum(spread[1] - spread[0], 0.1)).all(axis=1)
        if near.sum() >= FEWEST:
            folded, walked = folded[near], walked_m[near] - walked_m[near].mean()
            mean = folded.mean(axis=0)
            if walked.var() > 1e-6:
                slope = walked @ (folded - mean) / (walked @ walked)
            covariance = np.cov((folded - walked[:, None] * slope).T)
            mean = mean - walked_m[near].mean() * slope
    return Links(found[:6], found[6:], mean, slope, covariance + 1e-6 * np.eye(OFFSETS))


def _same(pairs: Candidates, group: Int[np.ndarray, " E"]) -> Bool[np.ndarray, " n"]:
    """Whether both persons of each pair belong to the same group."""
    mine = group[pairs.later]
    return np.asarray((mine >= 0) & (mine == group[pairs.earlier]))


def _likelihood(
    x: Float[np.ndarray, " n"],
    pairs: Candidates,
    area: Int[np.ndarray, " E"],
    same: Bool[np.ndarray, " m"],
) -> tuple[float, Float[np.ndarray, " n"]]:
    """Log-probability that each person joins its group, or nobody; and its gradient."""
    of_area = area[pairs.later]
    weight = np.exp(x[:6][pairs.bin] + x[6:][of_area])
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
            np.bincount(of_area, each, minlength=len(x) - 6),
        ]
    )
    return value, slope
