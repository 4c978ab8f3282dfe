"""How much of a crowd is a copy of the recording: its arrivals, and its lives.

All recordings are public: who plays pieces of one gets good scores without a model.

Arrivals are counted per spawn area on the scene's frames (Grand Central's on its annotation grid of
0.8 s) and blurred by (1, 2, 1)/4, so that a copy stays one if each arrival is moved by a frame. A
window of them is held against every stretch of the recording; its best correlation tells whether it
was seen before. Medians over windows of six rollouts, the highest of models that do not copy and
the lowest of block-replay, as it is and with each arrival moved by up to a frame:

    scene      window   poisson-gmm  renewal-gmm  ntpp-gmm   block-replay  ± a frame
    eth-v0       60 s   0.33         0.39         0.40       0.68          0.60
    hotel-v0     60 s   0.30         0.35         0.34       0.67          0.56
    zara1-v0     60 s   0.28         0.33         0.36       0.50          0.42
    gc-v0        60 s   0.33         0.33         0.34       0.93          0.86
    forum-v0    310 s   0.30         0.32         0.32       0.84          0.68
    plaza-v0     60 s   0.32         0.47         0.48       0.63          0.57

Means over rollouts lie further apart (ETH: 0.38 at most, 0.64 at least). Windows straddle the
blocks that are played, hence no 1. In 60 s of the Forum two people come, who come so somewhere in
ten hours (0.63 for models that do not copy): windows there are as long as ten people take to come.
"""

import numpy as np
from jaxtyping import Float, Int

from crowdbench.registry import spawn_model
from crowdbench.scene import Scene
from crowdbench.trajectories.table import Trajectories

WINDOW_S = 60.0
"""Shortest window. Where few people come it is longer, so that it holds `ARRIVALS` on average."""
ARRIVALS = 10
FEWEST = 5
"""Arrivals that a window must have to be looked at."""
BLUR = np.array([0.25, 0.5, 0.25])
INDEPENDENT = ("poisson-gmm", "renewal-gmm")
"""Models that cannot copy: they know rates and gaps, not when anyone came."""
DRAWS = 50
"""Crowds of each of them."""
NEAR_M = 0.1
SHORTEST_S = 4.0
"""Lives that are compared: shorter ones are alike by chance."""


class ArrivalCopies:
    """Finds pieces of a recording among arrivals."""

    def __init__(self, recorded: Trajectories, scene: Scene) -> None:
        """Prepare the recording's rates."""
        persons = np.flatnonzero(recorded.entered)
        self._bin_s = max(scene.dt_s, scene.grid_s)
        self._bins = int(np.ceil(scene.horizon_s / self._bin_s - 1e-6))
        self._areas = int(recorded.spawn_area.max()) + 2  # the last one for those of none
        window_s = max(WINDOW_S, ARRIVALS * scene.horizon_s / max(1, len(persons)))
        self._length = min(self._bins, round(window_s / self._bin_s))
        at, area = self._placed(recorded.spawn_s[persons], recorded.spawn_area[persons])
        rates = _blurred(self._counts(at, area))
        self._twice = _blurred(rates)
        self._sums = _running(rates, self._length)
        squares = _running(rates**2, self._length).sum(axis=0)
        self._norm = np.sqrt(np.maximum(squares - (self._sums**2).sum(axis=0) / self._length, 0))

    def index(
        self, spawn_s: Float[np.ndarray, " n"], spawn_area: Int[np.ndarray, " n"]
    ) -> float | None:
        """Median over windows of the best correlation of their arrivals with the recording's.

        The windows stand side by side, a minute long where people are many. None where none of
        them has enough arrivals.
        """
        at, area = self._placed(spawn_s, spawn_area)
        rates = _blurred(self._counts(at, area))
        best = []
        for start in range(0, self._bins - self._length + 1, self._length):
            inside = (at >= start) & (at < start + self._length)
            if inside.sum() >= FEWEST:
                window = rates[:, start : start + self._length]
                best.append(self._best(window, at[inside] - start, area[inside]))
        return float(np.median(best)) if best else None

    def _best(
        self,
        window: Float[np.ndarray, "K L"],
        at: Int[np.ndarray, " n"],
        area: Int[np.ndarray, " n"],
    ) -> float:
        """The largest of the window's correlations with all stretches of the recording."""
        mean = window.mean(axis=1, keepdims=True)
        norm = float(np.linalg.norm(window - mean))
        # Σ blurred · blurred = Σ over arrivals of the twice blurred: few terms, where a
        # convolution would have many.
        shifts = np.arange(len(self._norm))
        products = self._twice[area[:, None], at[:, None] + shifts].sum(axis=0)
        products -= (mean * self._sums).sum(axis=0)
        # A stretch of next to nobody correlates with anything.
        enough = self._norm > norm / 2
        correlations = products[enough] / (self._norm[enough] * norm)
        return min(1.0, float(correlations.max(initial=0.0)))

    def _placed(
        self, spawn_s: Float[np.ndarray, " n"], spawn_area: Int[np.ndarray, " n"]
    ) -> tuple[Int[np.ndarray, " n"], Int[np.ndarray, " n"]]:
        at = np.clip((spawn_s / self._bin_s + 1e-6).astype(np.int64), 0, self._bins - 1)
        known = (spawn_area >= 0) & (spawn_area < self._areas - 1)
        return at, np.where(known, spawn_area, self._areas - 1).astype(np.int64)

    def _counts(
        self, at: Int[np.ndarray, " n"], area: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "K T"]:
        flat = np.bincount(area * self._bins + at, minlength=self._areas * self._bins)
        return flat.reshape(self._areas, self._bins).astype(np.float64)


def _blurred(counts: Float[np.ndarray, "K T"]) -> Float[np.ndarray, "K T"]:
    padded = np.pad(counts, ((0, 0), (1, 1)))
    return BLUR[0] * padded[:, :-2] + BLUR[1] * padded[:, 1:-1] + BLUR[2] * padded[:, 2:]


def _running(values: Float[np.ndarray, "K T"], length: int) -> Float[np.ndarray, "K S"]:
    """Sums over every stretch of so many columns."""
    sums = np.pad(values.cumsum(axis=1), ((0, 0), (1, 0)))
    return sums[:, length:] - sums[:, :-length]


def independent_limit(copies: ArrivalCopies, scene: Scene) -> float | None:
    """99th percentile of the index of crowds that cannot copy."""
    found = []
    for model in INDEPENDENT:
        fitted = spawn_model(model, scene)
        for draw in range(DRAWS):
            events = fitted.sample(scene.horizon_s, scene, np.random.default_rng([99, draw]))
            index = copies.index(events.time_s, events.spawn_area.astype(np.int64))
            found += [] if index is None else [index]
    return float(np.percentile(found, 99)) if found else None


class LifeCopies:
    """Finds lives of a recording among those of a crowd."""

    def __init__(self, recorded: Trajectories, scene: Scene) -> None:
        """Index the recording's lives by where they begin and where they are 4 s later."""
        from scipy.spatial import KDTree

        self._recorded = recorded
        self._frames = max(1, round(SHORTEST_S / scene.dt_s))
        self._known = _long(recorded, self._frames)
        self._tree = KDTree(self._ends(recorded, self._known))

    def share(self, crowd: Trajectories) -> float | None:
        """Share of lives of 4 s and more that stay within 0.1 m of a recorded one.

        Both begin in their first frames, whenever those are; the recorded one may be longer, or
        shorter by a tenth. None where there is no such life.
        """
        lives = _long(crowd, self._frames)
        if len(lives) == 0 or len(self._known) == 0:
            return None
        near = self._tree.query_ball_point(self._ends(crowd, lives), NEAR_M, p=np.inf)
        copied = [self._copied(crowd, int(p), near[k]) for k, p in enumerate(lives)]
        return float(np.mean(copied))

    def _copied(self, crowd: Trajectories, person: int, candidates: list[int]) -> bool:
        path = crowd.path(person)
        for candidate in self._known[candidates].tolist():
            other = self._recorded.path(candidate)
            both = min(len(path), len(other))
            gap = np.linalg.norm(path[:both] - other[:both], axis=1)
            if both >= 0.9 * len(path) and gap.max() <= NEAR_M:
                return True
        return False

    def _ends(
        self, crowd: Trajectories, persons: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, "n 4"]:
        first = crowd.offsets[:-1][persons]
        ends = np.concatenate([crowd.xy[first], crowd.xy[first + self._frames]], axis=1)
        return ends.astype(np.float64)


def _long(crowd: Trajectories, frames: int) -> Int[np.ndarray, " n"]:
    """Those who enter and are there for more than so many frames."""
    return np.flatnonzero(crowd.entered & (crowd.last - crowd.first >= frames))
