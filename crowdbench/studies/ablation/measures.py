"""Numbers of people present, and scores, of the samples of each configuration."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.evaluation.judge import draws_of
from crowdbench.metrics import METRICS, WALK, metrics_for
from crowdbench.scene import Scene
from crowdbench.scoring.energy import energy
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.score import Score, crowd_score, family_scores, score_of
from crowdbench.scoring.scorecard import ANCHOR, Scale
from crowdbench.studies.ablation.presence import Presence
from crowdbench.studies.ablation.study import Configuration, Sample


@dataclass(frozen=True)
class Numbers:
    """Statistics of N(t) for each sample of a configuration, for one of `study.SCHEMES`."""

    mean: list[float]
    """Mean number of persons."""
    sd: list[float]
    """Standard deviation over time, persons."""
    correlation: list[float | None]
    """Autocorrelation at 60 s; None if no stretch of observed time is that long."""
    distance: list[float]
    """Wasserstein-1 distance to the recording, divided by the recording's mean."""

    @classmethod
    def of(cls, samples: Sequence[Presence], recorded: Presence) -> "Numbers":
        """Compute the statistics of each sample."""
        return cls(
            [s.mean for s in samples],
            [s.sd for s in samples],
            [s.correlation for s in samples],
            [s.distance(recorded) for s in samples],
        )


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of a configuration, whose samples are treated as rollouts of one model."""

    metrics: dict[str, Score]
    families: dict[str, Score]
    crowd: Score | None


def scores_of(
    scene: Scene,
    reference: Reference,
    scale: Scale,
    samples: Mapping[Configuration, Sequence[Sample]],
) -> dict[Configuration, Scores]:
    """Scores of each configuration in protocol `full`; they need at least two samples."""
    anchor = next(e for e in scale.anchors if (e.spawn, e.policy) == ANCHOR)
    draws = draws_of(scene, reference, "full")
    found = {}
    for configuration, each in samples.items():
        metrics: dict[str, Score] = {}
        for metric in metrics_for(reference.blocks):
            floor, of_anchor = scale.floor.get(metric.name), anchor.metrics[metric.name].energy
            known = metric.name in scene.protocol.scored and metric.family not in WALK
            if not known or floor is None or of_anchor is None or len(each) < 2:
                continue
            recorded = reference.statistics[metric.name]
            rollouts = [[sample.of(metric.name) for sample in each]]
            of_samples = energy(metric, recorded, rollouts, reference.blocks, draws)
            if of_samples is None:
                continue
            score = score_of(of_samples, floor.energy(), of_anchor.energy())
            if score is not None:
                metrics[metric.name] = score
        families = family_scores(METRICS, metrics, scene.protocol.scored)
        found[configuration] = Scores(metrics, families, crowd_score(families))
    return found


def spread(values: Sequence[float]) -> float:
    """Standard deviation over samples; 0 for a single sample."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
