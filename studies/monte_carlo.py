"""How many rollouts a scene's scores deserve: the error of few rollouts beside that of few blocks.

A score has two sources of error: the recording has few time blocks, and a model has few rollouts.
The second one costs computing time only. If it is at most a third of the first one, the interval of
a score is at most 5 % wider than with infinitely many rollouts.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
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
from crowdbench.spawn.names import PERTURBED, replays
from studies.ceilings import perturbed_of
from studies.markdown import flowed, table

PROTOCOL = "heldout"
SHARE = 1 / 3
"""The largest ratio of the error of rollouts to that of blocks."""
SCENES = ("eth-v0", "hotel-v0", "zara1-v0", "gc-v0", "forum-v0")
PAIRS = (("cox-plans", "straight"), ("cox-plans", "anticipate"), (PERTURBED, "anticipate"))
"""The best models of each track; a better model has smaller errors of blocks."""
TITLE = """# How many rollouts

A score has two sources of error: the recording has few time blocks, and a model has few rollouts.
More rollouts cost only computing time. If their error is a third of that of blocks, an interval is
5 % wider than with infinitely many rollouts. The protocol of a scene has about as many rollouts as
that takes for *crowd* and *walk*, the scores by which entries are ranked. Single families may have
larger errors. All intervals contain both errors, so with fewer rollouts they are wider, but right.

The table has the standard deviations of held-out scores. The error of rollouts follows from how
much each rollout changes a score, the error of blocks from the resamples of the recording's time
blocks. *rollouts* is the number of each fit, `rollouts_per_fit` of the protocol; under perturbed
arrivals, where nothing is fitted, it is `walk_rollouts`. The rollouts are those of the entries of
the leaderboard. *needed* is the number at which
their error is a third of that of blocks. This page is the output of

```sh
python -m studies monte-carlo
```"""


@dataclass(frozen=True, eq=False)
class Influences:
    """A score, and how it changes: with each rollout, and with the resampled blocks."""

    value: float
    splits: tuple[np.ndarray, ...]
    """For each split, the change (fits, rollouts of a fit) with each rollout."""
    blocks: np.ndarray
    """Deviations by resample."""

    @classmethod
    def mean(cls, parts: Sequence["Influences"]) -> "Influences":
        """The mean of several scores."""
        of_splits = zip(*(part.splits for part in parts), strict=True)
        return cls(
            float(np.mean([part.value for part in parts])),
            tuple(np.mean(each, axis=0) for each in of_splits),
            np.mean([part.blocks for part in parts], axis=0),
        )

    @property
    def per_fit(self) -> int:
        """Number of rollouts per fit, or of all rollouts if nothing is fitted."""
        return int(self.splits[0].shape[1])

    @property
    def of_rollouts(self) -> float:
        """Standard deviation of the score over sets of as many rollouts."""
        fits, each = self.splits[0].shape
        variances = [s.var(axis=1, ddof=1).sum() / each / fits**2 for s in self.splits]
        return float(np.sqrt(sum(variances))) / len(self.splits)

    @property
    def of_blocks(self) -> float:
        """Standard deviation of the score over the resamples of blocks."""
        return float(self.blocks.std())

    @property
    def needed(self) -> int:
        """The smallest number of rollouts per fit whose error is small enough, at least 2."""
        ratio = self.of_rollouts / (SHARE * self.of_blocks) if self.of_blocks else 0.0
        return max(2, int(np.ceil(self.per_fit * ratio**2)))


def errors_of(
    scene: Scene, pair: Pair, out: Path, workers: int | None, progress: Progress
) -> dict[str, Influences]:
    """The held-out scores of a pair by family, and last the one that ranks: `crowd` or `walk`."""
    reference = reference_of(scene)
    scale = read_anchors(scene).protocols[PROTOCOL]
    seeds = scene.protocol.fits * scene.protocol.rollouts_per_fit
    jobs = plan(scene.asked, scene, [pair], PROTOCOL, seeds, out / "rollouts")
    rolled = roll_out([replace(job, shown=False) for job in jobs], reference, workers, progress)
    walks = replays(pair[0])
    of_family: dict[str, list[Influences]] = {}
    for metric in reference.metrics:
        if metric.name in scene.protocol.scored and (metric.family in WALK) == walks:
            slices = list(seen_in(reference, metric, rolled, PROTOCOL))
            of_metric = _of_metric(scene, reference, metric, slices, scale)
            if of_metric is not None:
                of_family.setdefault(metric.family, []).append(of_metric)
    found = {family: Influences.mean(each) for family, each in of_family.items()}
    return found | _total(found, walks=walks)


def _total(families: Mapping[str, Influences], *, walks: bool) -> dict[str, Influences]:
    if walks:
        return {"walk": min(families.values(), key=lambda of: of.value)}
    return {"crowd": Influences.mean([*families.values()])}


def _of_metric(
    scene: Scene,
    reference: Reference,
    metric: Metric,
    slices: Sequence[MetricSlice],
    scale: Scale,
) -> Influences | None:
    """The score of a metric; None if it has none."""
    walks = metric.family in WALK
    floor, anchor = _scale_of(scale, metric.name, walks=walks)
    span = anchor.centre - floor.centre
    if not span > 0:
        return None
    centres, changes, by_blocks = [], [], []
    for seen in slices:
        crowds = [crowd for fit in seen.fits for crowd in fit]
        embedded = Embedded.of(metric, [seen.recorded, *crowds], seen.recorded, seen.blocks)
        if embedded is None:
            return None
        to_recorded, between = (of[0] for of in _distances(embedded, embedded.once, seen))
        centres.append(_energy(to_recorded, between, walks=walks))
        mutual = between.sum(axis=-1) / max(1, between.shape[-1] - 1)
        changes.append((to_recorded - (not walks) * mutual) / -span)
        draws = draws_of(scene, reference, seen.split)
        parts = [
            _energy(*_distances(embedded, draws.blocks[part], seen), walks=walks)
            for part in embedded.chunks(RESAMPLES)
        ]
        by_blocks.append(np.concatenate(parts))
    ratio = (float(np.mean(centres)) - floor.centre) / span
    resampled = Energy(0.0, np.mean(by_blocks, axis=0)).deviations()
    of_span = anchor.deviations() - floor.deviations()
    blocks = (ratio * of_span - (resampled - floor.deviations())) / span
    return Influences(max(-1.0, 1 - ratio), tuple(changes), blocks)


def _scale_of(scale: Scale, metric: str, *, walks: bool) -> tuple[Energy, Energy]:
    """Noise floor and energy score of the anchor; the floor of walking is 0."""
    pair = WALK_ANCHOR if walks else ANCHOR
    card = next(a for a in scale.anchors if (a.spawn, a.policy) == pair).metrics[metric]
    assert card.energy is not None
    floor = Energy(0.0, np.zeros(RESAMPLES)) if walks else scale.floor[metric].energy()
    return floor, card.energy.energy()


def _distances(
    embedded: Embedded, weights: np.ndarray, seen: MetricSlice
) -> tuple[np.ndarray, np.ndarray]:
    x = embedded(weights)
    crowds = x[:, 1:].reshape(len(x), len(seen.fits), -1, x.shape[-1])
    found: tuple[np.ndarray, np.ndarray] = l1_distances(
        np.ascontiguousarray(x[:, 0]), np.ascontiguousarray(crowds)
    )
    return found


def _energy(to_recorded: np.ndarray, between: np.ndarray, *, walks: bool) -> np.ndarray:
    """Energy scores, averaged over the fits; see `crowdbench.scoring.energy`."""
    spread = 0.0 if walks else pair_mean(between).mean(axis=-1) / 2
    return np.asarray(to_recorded.mean(axis=(-2, -1)) - spread)


def _as_judged(pair: Pair) -> Pair:
    """The pair with the key of the policy's entry, whose rollouts are then taken."""
    spawn, policy = pair
    return (perturbed_of(policy) if spawn == PERTURBED else spawn), policy


def page(
    scenes: Sequence[str],
    pairs: Sequence[Pair] = PAIRS,
    *,
    out: Path,
    workers: int | None,
    progress: Progress = lambda done, total: None,
) -> str:
    """The page: the errors of all pairs on these scenes, in Markdown."""
    lines = []
    for name in scenes:
        scene = load_scene(name)
        for pair in pairs:
            found = errors_of(scene, _as_judged(pair), out / scene.id, workers, progress)
            for family, of in found.items():
                score = f"{of.value:.2f}".replace("-", "−")
                lines.append([
                    scene.id, " × ".join(pair), family, score, f"{of.per_fit}",
                    f"{of.of_rollouts:.3f}", f"{of.of_blocks:.3f}", f"{of.needed}",
                ])  # fmt: skip
    head = ["scene", "crowd", "family", "score", "rollouts", "their error", "error of blocks",
            "needed"]  # fmt: skip
    return flowed(f"{TITLE}\n\n{table(head, lines, text=3)}")
