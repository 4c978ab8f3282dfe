"""The copy index: how much of a crowd's arrivals is copied from the recording.

All recordings are public, so a crowd that replays parts of one gets good scores without a model.
Copied paths are found in `path_copies`.

Arrivals are counted per spawn area and frame (in Grand Central, per 0.8 s of its annotation grid)
and blurred with (1, 2, 1)/4, so that a copy is still found if each arrival is moved by a frame.
Each time window is compared with every window of the recording; the highest correlation shows
whether it was copied. The table shows medians over the windows of six rollouts: the highest of
models that do not copy, and the lowest of block-replay, unchanged and with each arrival moved by
up to a frame.

    scene      window   poisson-gmm  renewal-gmm  ntpp-gmm   block-replay  ± a frame
    eth-v0       60 s   0.33         0.39         0.40       0.68          0.60
    hotel-v0     60 s   0.30         0.35         0.34       0.67          0.56
    zara1-v0     60 s   0.28         0.33         0.36       0.50          0.42
    gc-v0        60 s   0.33         0.33         0.34       0.93          0.86
    forum-v0    310 s   0.30         0.32         0.32       0.84          0.68
    plaza-v0     60 s   0.34         0.47         0.46       0.66          0.55

Means over rollouts differ more clearly (ETH: at most 0.38 without, at least 0.64 with copying).
Block-replay is below 1 because windows overlap the ends of replayed blocks. In the Forum only two
people arrive in 60 s, and similar pairs of arrivals occur somewhere in ten hours (0.63 for models
that do not copy). So windows there are as long as ten people take to arrive on average.

Whoever moves each arrival by more than a frame escapes from these windows, but the crowd is still a
copy, with other noise. So the same is done with counts in bins of 4, 10 and 20 s, in windows of 24
bins: there, a copy with each group moved by up to as many seconds as a bin has comes near to 1.
Each window looks for the shift that fits best, so a slow warp of the whole recording does not
hide it.
`python -m studies copies` measures models and copies (docs/trust.md).
"""

from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.table import Trajectories
from crowdbench.leaderboard.verification.path_copies import PathCopies
from crowdbench.registry import recording_of, spawn_model
from crowdbench.run.jobs import Job
from crowdbench.run.judge import TRAJECTORIES
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.names import replays

WINDOW_S = 60.0
"""Shortest window. Where few people arrive it is longer, for `ARRIVALS` arrivals on average."""
ARRIVALS = 10
COARSE_S = (4.0, 10.0, 20.0)
"""Coarser bins, in which copies are found whose arrivals were moved by some seconds."""
BINS = (None, *COARSE_S)
"""The bins in which arrivals are counted, in seconds; the first ones are those of a frame."""
WINDOW_BINS = 24
"""Shortest window in bins, if that is longer."""
FEWEST = 5
"""Windows with fewer arrivals are skipped."""
BLUR = np.array([0.25, 0.5, 0.25])
INDEPENDENT = ("poisson-gmm", "renewal-gmm")
"""Models that cannot copy: they know rates and gaps, but not when anyone arrived."""
DRAWS = 50
"""Number of crowds drawn from each of them."""


class ArrivalCopies:
    """Finds parts of a recording among the arrivals of a crowd."""

    def __init__(self, recorded: Trajectories, scene: Scene, bin_s: float | None = None) -> None:
        """Compute the recording's blurred arrival counts; by default in bins of a frame."""
        persons = np.flatnonzero(recorded.entered)
        self._bin_s = max(scene.dt_s, scene.grid_s) if bin_s is None else bin_s
        self._bins = int(np.ceil(scene.horizon_s / self._bin_s - 1e-6))
        self._areas = int(recorded.spawn_area.max()) + 2  # the last: no area
        typical_s = ARRIVALS * scene.horizon_s / max(1, len(persons))
        window_s = max(WINDOW_S, typical_s, WINDOW_BINS * self._bin_s)
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
        """Median over windows of the highest correlation of their arrivals with the recording's.

        Windows follow each other without overlap. With bins of a frame, they are 60 s long where
        many people arrive. None if no window has enough arrivals.
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
        """The highest correlation of a window with any window of the recording."""
        mean = window.mean(axis=1, keepdims=True)
        norm = float(np.linalg.norm(window - mean))
        # Σ blurred · blurred equals the sum of twice-blurred counts at the arrivals, which has far
        # fewer terms than a convolution.
        shifts = len(self._norm)
        products = np.zeros(shifts)
        for k, first in zip(area.tolist(), at.tolist(), strict=True):
            products += self._twice[k, first : first + shifts]
        products -= (mean * self._sums).sum(axis=0)
        # A window with almost no arrivals correlates with anything.
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
    sums = np.pad(values.cumsum(axis=1), ((0, 0), (1, 0)))
    return sums[:, length:] - sums[:, :-length]


def independent_limits(scene: Scene) -> list[float | None]:
    """99th percentiles of the index, for each of `BINS`, for crowds of models that cannot copy.

    None where it is undefined. `python -m studies copy-limits` measures those of shipped scenes.
    """
    found: list[list[float]] = [[] for _ in BINS]
    for model in INDEPENDENT:
        fitted = spawn_model(model, scene)
        for draw in range(DRAWS):
            events = fitted.sample(scene.horizon_s, scene, np.random.default_rng([99, draw]))
            area = events.spawn_area.astype(np.int64)
            for of_bin, copies in zip(found, arrival_copies(scene.asked).values(), strict=True):
                index = copies.index(events.time_s, area)
                of_bin += [] if index is None else [index]
    return [float(np.percentile(of_bin, 99)) if of_bin else None for of_bin in found]


def copies_in(job: Job, crowd: Trajectories) -> dict[str, float]:
    """The copy indices of a rollout's `arrivals`, by `index_name`, and the share of copied `trips`.

    NaN where they are undefined: `arrivals` if recorded people enter, `trips` if others do.
    """
    found: dict[str, float | None] = dict.fromkeys((*map(index_name, BINS), "trips"))
    if not replays(job.spawn):
        persons = np.flatnonzero(crowd.entered)
        area = crowd.spawn_area[persons].astype(np.int64)
        for bin_s, copies in arrival_copies(job.scene).items():
            found[index_name(bin_s)] = copies.index(crowd.spawn_s[persons], area)
    if job.spawn in ("replay", TRAJECTORIES):
        found["trips"] = _path_copies(job.scene).share(crowd)
    return {name: np.nan if value is None else value for name, value in found.items()}


def index_name(bin_s: float | None) -> str:
    """The name of the copy index with these bins in a summary."""
    return "arrivals" if bin_s is None else f"arrivals in {bin_s:g} s"


@lru_cache(maxsize=1)
def arrival_copies(scene: str) -> dict[float | None, ArrivalCopies]:
    """What finds the recorded arrivals of a scene, by its name or folder, for each of `BINS`."""
    place = load_scene(scene)
    return {bin_s: ArrivalCopies(recording_of(place), place, bin_s) for bin_s in BINS}


@lru_cache(maxsize=1)
def _path_copies(scene: str) -> PathCopies:
    place = load_scene(scene)
    return PathCopies(recording_of(place), place)
