"""What the samples of each configuration are like: numbers of people, and scores."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crowdbench.evaluation.judge import draws_of
from crowdbench.metrics import METRICS, WALK, metrics_for
from crowdbench.scene import Scene
from crowdbench.scoring.energy import energy
from crowdbench.scoring.reference import Reference
from crowdbench.scoring.score import Score, family_scores, overall, score_of
from crowdbench.scoring.scorecard import ANCHOR, Scale
from crowdbench.studies.ablation.presence import Presence
from crowdbench.studies.ablation.study import Configuration, Sample


@dataclass(frozen=True)
class Numbers:
    """The number of people present in each sample of a configuration, by one scheme."""

    mean: list[float]
    """Persons."""
    sd: list[float]
    """Over time, persons."""
    correlation: list[float | None]
    """At 60 s; None where no stretch is so long."""
    distance: list[float]
    """Wasserstein-1 to the recording, over its mean."""

    @classmethod
    def of(cls, samples: Sequence[Presence], recorded: Presence) -> "Numbers":
        """Of each sample."""
        return cls(
            [s.mean for s in samples],
            [s.sd for s in samples],
            [s.correlation for s in samples],
            [s.distance(recorded) for s in samples],
        )


@dataclass(frozen=True, eq=False)
class Scores:
    """The scores of a configuration, its samples taken for rollouts of one model."""

    metrics: dict[str, Score]
    families: dict[str, Score]
    crowd: Score | None


def scores_of(
    scene: Scene,
    reference: Reference,
    scale: Scale,
    samples: Mapping[Configuration, Sequence[Sample]],
) -> dict[Configuration, Scores]:
    """Scores of each configuration in protocol `full`; with one sample each there are none."""
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
        found[configuration] = Scores(metrics, families, overall(families, walk=False))
    return found


def spread(values: Sequence[float]) -> float:
    """Standard deviation over samples; 0 of a single one."""
    return float(np.std(values, ddof=1)) if len(values) > 1 else 0.0
