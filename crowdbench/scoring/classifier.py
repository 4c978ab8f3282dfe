"""A classifier that tries to tell simulated from recorded walking; it ranks nothing.

A classifier two-sample test (Lopez-Paz and Oquab, Revisiting Classifier Two-Sample Tests, ICLR
2017): windows of 5 s of walking people are described by kinematic features, and gradient boosting
learns which of them are recorded. The area under the ROC curve (AUC) on time blocks that it has not
seen is 0.5 if they cannot be told apart, and 1 if they always can.

Recorded positions have noise, which alone would tell them apart. So the recording gets noise of
twice its own standard deviation, and a simulated crowd, which has none, gets √5 times as much: then
both have the same. As a control, the recording is treated like a simulated crowd. If the classifier
tells it from itself, it sees the noise, and says nothing about people.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.recordings.noise import Noise, with_noise
from crowdbench.data.table import Trajectories

WINDOW_S = 5.0
SMOOTHING_S = 0.8
"""Standard deviation of the Gaussian by which paths are smoothed; on a grid of more than half of
this, one and a half steps of the grid."""
FEWEST_MPS = 0.5
"""Windows of people who come less far per second are left out: they stand."""
LEAST_NOISE_M = 0.01
RECORDED, SIMULATED = 2.0, 5.0**0.5
"""The noise that is added, in standard deviations of the recording's own."""
FOLDS = 4
MOST = 6000
"""Largest number of windows of each side, drawn at random."""
FEWEST = 200
"""Smallest number of windows of each side."""
LARGEST_CONTROL = 0.55
"""AUC of the control above which nothing is said."""
FEATURES = (
    "net speed", "path speed", "path per way", "sd of speed", "lowest speed", "highest speed",
    "trend of speed", "bend of speed", "bend sideways", "S sideways", "turning", "turn", "standing",
    "furthest sideways", "residual along", "acceleration along", "acceleration across",
)  # fmt: skip


@dataclass(frozen=True)
class Auc:
    """The area under the ROC curve, averaged over the folds."""

    value: float
    error: float
    """Standard error over the folds."""
    control: float
    """The same for the recording treated like a simulated crowd."""


@dataclass(frozen=True, eq=False)
class _Windows:
    features: Float[np.ndarray, "n features"]
    block: Int[np.ndarray, " n"]


@dataclass(frozen=True, eq=False)
class ClassifierTest:
    """Tells crowds from the recording of a scene."""

    recorded: Trajectories
    noise: tuple[Noise, Noise]
    """Of the raw recording, along and across the path (`noise_of`)."""
    blocks: TimeBlocks
    tick_frames: int
    """Frames from one position that is looked at to the next."""

    def auc(self, crowd: Trajectories, seed: int = 0) -> Auc | None:
        """How well `crowd` is told from the recording; None with too few windows, or if the control
        exceeds `LARGEST_CONTROL`.
        """
        windows = self._windows(crowd, SIMULATED, seed + 2)
        if self._control is None or self._control > LARGEST_CONTROL:
            return None
        found = self._told(windows)
        return None if found is None else Auc(*found, self._control)

    @cached_property
    def _recorded(self) -> _Windows:
        return self._windows(self.recorded, RECORDED, 0)

    @cached_property
    def _control(self) -> float | None:
        found = self._told(self._windows(self.recorded, SIMULATED, 1))
        return None if found is None else found[0]

    def _told(self, simulated: _Windows) -> tuple[float, float] | None:
        """Mean and standard error of the AUC over folds of time blocks."""
        from sklearn.ensemble import HistGradientBoostingClassifier
        from sklearn.metrics import roc_auc_score

        sides = (self._recorded, simulated)
        if min(len(side.block) for side in sides) < FEWEST:
            return None
        x = np.concatenate([side.features for side in sides])
        y = np.repeat([0, 1], [len(side.block) for side in sides])
        block = np.concatenate([side.block for side in sides])
        fold = block * FOLDS // len(self.blocks)
        found = []
        for k in range(FOLDS):
            train, test = fold != k, fold == k
            if len(np.unique(y[test])) < 2:
                continue
            model = HistGradientBoostingClassifier(
                max_iter=80, learning_rate=0.08, max_leaf_nodes=12, min_samples_leaf=25,
                l2_regularization=1.0, early_stopping=False, random_state=0,
            )  # fmt: skip
            model.fit(x[train], y[train])
            found.append(roc_auc_score(y[test], model.decision_function(x[test])))
        return float(np.mean(found)), float(np.std(found) / np.sqrt(len(found)))

    def _windows(self, crowd: Trajectories, factor: float, seed: int) -> _Windows:
        rng = np.random.default_rng([17, seed])
        sigma_m = tuple(factor * max(LEAST_NOISE_M, of.sigma_m) for of in self.noise)
        noisy = with_noise(crowd, (sigma_m[0], sigma_m[1]), self.tick_frames, rng)
        tick_s = self.tick_frames * self.blocks.dt_s
        length = round(WINDOW_S / tick_s) + 1
        block_of = np.full(max(crowd.frames, int(self.blocks.frames.max())) + 1, -1)
        for k, (start, stop) in enumerate(self.blocks.frames.tolist()):
            block_of[start:stop] = k
        smoothing = max(SMOOTHING_S, 1.5 * self.blocks.grid_s) / tick_s
        pieces = [np.empty((0, length, 2))]
        middles = [np.empty(0, dtype=np.int64)]
        for ticks, way in _ways(noisy, self.tick_frames, smoothing):
            starts = np.arange(1, len(way) - length, max(1, length // 2))
            if len(starts):
                pieces.append(way[starts[:, None] + np.arange(length)])
                middles.append(ticks[starts + length // 2] * self.tick_frames)
        xy, block = np.concatenate(pieces), block_of[np.concatenate(middles)]
        net = np.linalg.norm(xy[:, -1] - xy[:, 0], axis=1)
        walks = (block >= 0) & (net >= FEWEST_MPS * (length - 1) * tick_s)
        xy, block = xy[walks], block[walks]
        if len(xy) > MOST:
            drawn = np.sort(rng.choice(len(xy), MOST, replace=False))
            xy, block = xy[drawn], block[drawn]
        return _Windows(_features(xy, tick_s), block)


def _ways(
    crowd: Trajectories, tick_frames: int, smoothing: float
) -> Iterator[tuple[Int[np.ndarray, " n"], Float[np.ndarray, "n 2"]]]:
    """Ticks and smoothed positions of each person."""
    from scipy.ndimage import gaussian_filter1d

    frame = crowd.row_frame()
    for first, last in zip(crowd.offsets[:-1], crowd.offsets[1:], strict=True):
        at = np.flatnonzero(frame[first:last] % tick_frames == 0) + first
        if len(at) > 2:
            xy = crowd.xy[at].astype(np.float64)
            smooth = gaussian_filter1d(xy, smoothing, axis=0, mode="nearest", truncate=2.5)
            yield frame[at] // tick_frames, smooth


def _features(xy: Float[np.ndarray, "n L 2"], tick_s: float) -> Float[np.ndarray, "n features"]:
    """The `FEATURES` of windows of L positions, in the frame of the way from first to last."""
    n, length = xy.shape[:2]
    net = xy[:, -1] - xy[:, 0]
    way = np.linalg.norm(net, axis=1)
    u = net / way[:, None]
    centred = xy - xy.mean(axis=1, keepdims=True)
    across = np.stack([-u[:, 1], u[:, 0]], axis=1)
    z = np.stack([np.einsum("nld,nd->nl", centred, of) for of in (u, across)], axis=2)
    v = np.diff(z, axis=1) / tick_s
    speed = np.linalg.norm(v, axis=2)
    acceleration = np.diff(v, axis=1) / tick_s
    curve, line, pace = (
        _polynomials(length, 3),
        _polynomials(length, 1),
        _polynomials(length - 1, 2),
    )
    shape = np.einsum("kl,nld->nkd", np.linalg.pinv(curve), z)
    changes = speed @ np.linalg.pinv(pace).T
    straight = np.einsum("kl,nl->nk", np.linalg.pinv(line), z[:, :, 0]) @ line.T
    moves = speed > 0.3
    heading = np.unwrap(np.arctan2(v[..., 1], v[..., 0]), axis=1)
    turned = np.diff(heading, axis=1) * (moves[:, 1:] & moves[:, :-1])
    duration_s = (length - 1) * tick_s
    found = np.column_stack([
        way / duration_s, speed.mean(axis=1), speed.mean(axis=1) * duration_s / way,
        speed.std(axis=1), speed.min(axis=1), speed.max(axis=1), changes[:, 1], changes[:, 2],
        np.abs(shape[:, 2, 1]), np.abs(shape[:, 3, 1]), np.abs(turned).sum(axis=1),
        np.abs(turned.sum(axis=1)), 1 - moves.mean(axis=1), np.abs(z[:, :, 1]).max(axis=1),
        (z[:, :, 0] - straight).std(axis=1), *np.sqrt(np.square(acceleration).mean(axis=1)).T,
    ])  # fmt: skip
    return found.reshape(n, len(FEATURES))


def _polynomials(length: int, degree: int) -> Float[np.ndarray, "L k"]:
    """Legendre polynomials, which differ in shape, at `length` points."""
    return np.polynomial.legendre.legvander(np.linspace(-1, 1, length), degree)
