"""Small spawn models and arrivals for tests: two areas of ETH, each the other's goal."""

import math
from collections.abc import Sequence

import numpy as np

from crowdbench.spawn import (
    Areas,
    Arrivals,
    NtppGMM,
    NtppPaper,
    PoissonGMM,
    PoissonGroups,
    RenewalGMM,
)
from crowdbench.spawn.areas import Gaussians
from crowdbench.spawn.ntpp import kernels
from crowdbench.spawn.ntpp.model import SHAPES
from crowdbench.spawn.times.groups import spells_of

GRID_S = 0.4
_BOTH = Gaussians(np.array([[3.0, 5.0], [11.0, 6.0]]), np.stack([np.eye(2), np.eye(2)]))
AREAS = Areas(
    scene="eth-v0",
    spawn=_BOTH,
    goal=_BOTH,
    flow=np.array([[0.0, 1.0], [1.0, 0.0]]),
    speed_quantiles=np.linspace(1.0, 1.5, 101),
    left_out=(0.0, 0.0),
)


def arrivals_at(
    tick: Sequence[int], area: Sequence[int], windows: Sequence[tuple[int, int]]
) -> Arrivals:
    """Arrivals at grid points of two areas."""
    return Arrivals(
        tick=np.array(tick, dtype=np.int64),
        area=np.array(area, dtype=np.int64),
        windows=np.array(windows),
        areas=2,
        grid_s=GRID_S,
    )


def poisson(next_member: float = 0.0) -> PoissonGMM:
    """Rates so low that nearly nobody is a group; `next_member` only makes the models alike."""
    return PoissonGMM(AREAS, np.array([0.5, 0.02]))


def groups(next_member: float = 0.3) -> PoissonGroups:
    """Groups at constant rates."""
    rates = np.array([0.5, 0.02])
    return PoissonGroups(AREAS, rates, np.full(2, next_member), GRID_S)


def renewal(next_member: float = 0.3) -> RenewalGMM:
    """Bursty in one area, regular in the other."""
    return RenewalGMM(
        areas=AREAS,
        shape=np.array([0.6, 1.7]),
        scale_s=np.array([1.1, 4.0]),
        next_member=np.full(2, next_member),
        grid_s=GRID_S,
    )


def random_ntpp(next_member: float = 0.3, seed: int = 0, spread: float = 0.6) -> NtppGMM:
    """A network with weights as large as trained ones, that depends on its past."""
    rng = np.random.default_rng(seed)
    weights = {name: spread * rng.standard_normal((2, *shape)) for name, shape in SHAPES.items()}
    weights["out_weight"] *= 0.4
    weights["out_bias"] *= 0
    odds = np.log(next_member / (1 - next_member))
    weights["base"] = np.array([[0.0, np.log(3.0), odds], [-0.3, np.log(5.0), odds]])
    weights["scaling"] = np.array([[1.0, 0.8, 0.2, 0.4], [1.5, 1.1, 0.3, 0.5]])
    return NtppGMM(AREAS, {k: w.astype(np.float32) for k, w in weights.items()}, GRID_S)


def learned(model: NtppGMM | NtppPaper) -> int:
    """Number of learned parameters that samples depend on.

    These are the trained weights of the networks. For each other area, `ntpp-gmm` has a rate and
    P(one more member); in those of `ntpp-paper` nobody enters.
    """
    shapes = model.file.kind.shapes()
    unused = set()
    if isinstance(model, NtppPaper):
        unused = {"initial", *(("hidden_weight", "hidden_bias") if model.published_code else ())}
    each = sum(math.prod(shape) for name, shape in shapes.items() if name not in unused)
    trained = model.trained()
    others = 2 * int((~trained).sum()) if isinstance(model, NtppGMM) else 0
    return int(trained.sum()) * each + others


def parameters(model: NtppGMM, arrivals: Arrivals) -> np.ndarray:
    """Weibull shape, scale and −log P(one more member) before each group, (n, 3)."""
    spells, found = spells_of(arrivals), [np.empty((0, 3))]
    for spell, area in enumerate(spells.area.tolist()):
        weights = model.of_area(area)
        h = weights[4].copy()
        for i in range(spells.offsets[spell], spells.offsets[spell + 1]):
            h, steps, _ = kernels._forget(h, spells.gap[i], model.memory, weights)
            found.append(np.array([kernels._head(h, weights)]))
            h = kernels._update(h, steps, spells.size[i], weights)
    return np.concatenate(found)
