"""How many rollouts a scene's scores deserve: the error of few rollouts beside that of few blocks.

A score has two sources of error: the recording has few time blocks, and a model has few rollouts.
The second one costs computing time only. It needs to be no larger than a third of the first one:
then the interval of a score is at most 5 % wider than with infinitely many rollouts.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from crowdbench.metrics import WALK, Metric
from crowdbench.run.jobs import Pair, plan
from crowdbench.run.judge import MetricSlice, draws_of, seen_in
from crowdbench.run.references import reference_of
from crowdbench.run.rollout_jobs import Progress, roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.energy import RESAMPLES, Embedded, Energy, pair_mean
from crowdbench.scoring.l1_kernel import l1_distances
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.scorecard import ANCHOR, WALK_ANCHOR, Scale, read_anchors
from studies.markdown import table

PROTOCOL = "heldout"
SHARE = 1 / 3
"""The largest ratio of the error of rollouts to that of blocks."""


@dataclass
class Errors:
    """Score of a family, and its two standard deviations."""

    value: float
    of_rollouts: float
    of_blocks: float
    per_fit: int
    """Number of rollouts per fit, or of all rollouts if nothing is fitted."""

    @property
    def needed(self) -> int:
        """The smallest number of rollouts per fit whose error is small enough, at least 2."""
        ratio = self.of_rollouts / (SHARE * self.of_blocks) if self.of_blocks else 0.0
        return max(2, int(np.ceil(self.per_fit * ratio**2)))


@dataclass
class _Sums:
    """Per metric of a family: scores, their change with each rollout, and by resampled blocks."""

    values: list[float] = field(default_factory=list)
    influences: list[list[np.ndarray]] = field(default_factory=list)
    blocks: list[np.ndarray] = field(default_factory=list)


def errors_of(
    scene: Scene, pair: Pair, seeds: int, out: Path, workers: int | None, progress: Progress
) -> dict[str, Errors]:
    """The errors of a pair's held-out scores, by family."""
    reference = reference_of(scene)
    scale = read_anchors(scene).protocols[PROTOCOL]
    jobs = plan(scene.asked, scene, [pair], PROTOCOL, seeds, out / "rollouts")
    rolled = roll_out(jobs, reference, workers, progress)
    sums: dict[str, _Sums] = {}
    for metric in reference.metrics:
        walks = metric.family in WALK
        if metric.name not in scene.protocol.scored or walks != (pair[0] == "replay"):
            continue
        slices = list(seen_in(reference, metric, rolled, PROTOCOL))
        _add(sums.setdefault(metric.family, _Sums()), scene, reference, metric, slices, scale)
    return {family: _errors(of) for family, of in sums.items()}


def _add(
    sums: _Sums,
    scene: Scene,
    reference: Reference,
    metric: Metric,
    slices: Sequence[MetricSlice],
    scale: Scale,
) -> None:
    walks = metric.family in WALK
    floor, anchor = _scale_of(scale, metric.name, walks=walks)
    span = anchor.centre - floor.centre
    centres, influences, by_blocks = [], [], []
    for seen in slices:
        fits = [seen.crowds] if walks else seen.fits
        crowds = [crowd for fit in fits for crowd in fit]
        embedded = Embedded.of(metric, [seen.recorded, *crowds], seen.recorded, seen.blocks)
        if embedded is None or not span > 0:
            return
        of_all = np.ones((1, len(seen.blocks)), dtype=np.int64)
        to_recorded, between = (each[0] for each in _distances(embedded, of_all, len(fits)))
        each = between.shape[-1]
        centres.append(_energy(to_recorded, between, walks=walks))
        mutual = between.sum(axis=-1) / max(1, each - 1)
        influences.append((to_recorded - (not walks) * mutual) / -span)
        draws = draws_of(scene, reference, seen.split)
        parts = [
            _energy(*_distances(embedded, draws.blocks[part], len(fits)), walks=walks)
            for part in embedded.chunks(RESAMPLES)
        ]
        by_blocks.append(np.concatenate(parts))
    ratio = (float(np.mean(centres)) - floor.centre) / span
    resampled = Energy(0.0, np.mean(by_blocks, axis=0)).deviations()
    of_span = anchor.deviations() - floor.deviations()
    sums.values.append(max(-1.0, 1 - ratio))
    sums.influences.append(influences)
    sums.blocks.append((ratio * of_span - (resampled - floor.deviations())) / span)


def _scale_of(scale: Scale, metric: str, *, walks: bool) -> tuple[Energy, Energy]:
    """Noise floor and energy score of the anchor; the floor of walking is 0."""
    pair = WALK_ANCHOR if walks else ANCHOR
    card = next(a for a in scale.anchors if (a.spawn, a.policy) == pair).metrics[metric]
    assert card.energy is not None
    floor = Energy(0.0, np.zeros(RESAMPLES)) if walks else scale.floor[metric].energy()
    return floor, card.energy.energy()


def _distances(embedded: Embedded, weights: np.ndarray, fits: int) -> tuple[np.ndarray, np.ndarray]:
    x = embedded(weights)
    crowds = x[:, 1:].reshape(len(x), fits, -1, x.shape[-1])
    found: tuple[np.ndarray, np.ndarray] = l1_distances(
        np.ascontiguousarray(x[:, 0]), np.ascontiguousarray(crowds)
    )
    return found


def _energy(to_recorded: np.ndarray, between: np.ndarray, *, walks: bool) -> np.ndarray:
    """Energy scores, averaged over the fits; see `crowdbench.scoring.energy`."""
    spread = 0.0 if walks else pair_mean(between).mean(axis=-1) / 2
    return np.asarray(to_recorded.mean(axis=(-2, -1)) - spread)


def _errors(sums: _Sums) -> Errors:
    splits = [np.mean(each, axis=0) for each in zip(*sums.influences, strict=True)]
    fits, each = splits[0].shape
    of_splits = [split.var(axis=1, ddof=1).sum() / each / fits**2 for split in splits]
    return Errors(
        value=float(np.mean(sums.values)),
        of_rollouts=float(np.sqrt(sum(of_splits))) / len(splits),
        of_blocks=float(np.mean(sums.blocks, axis=0).std()),
        per_fit=each,
    )


def page(
    scenes: Sequence[str],
    pairs: Sequence[Pair],
    *,
    out: Path,
    workers: int | None,
    progress: Progress = lambda done, total: None,
) -> str:
    """Table of the errors of all pairs on these scenes, in Markdown."""
    lines = []
    for name in scenes:
        scene = load_scene(name)
        seeds = scene.protocol.fits * scene.protocol.rollouts_per_fit
        for pair in pairs:
            found = errors_of(scene, pair, seeds, out / scene.id, workers, progress)
            for family, errors in found.items():
                lines.append([
                    scene.id, " × ".join(pair), family, f"{errors.value:.3f}",
                    f"{errors.per_fit}", f"{errors.of_rollouts:.4f}", f"{errors.of_blocks:.4f}",
                    f"{errors.needed}",
                ])  # fmt: skip
    head = ["scene", "crowd", "family", "score", "rollouts per fit", "their error",
            "error of blocks", "rollouts needed"]  # fmt: skip
    return table(head, lines, text=3)
