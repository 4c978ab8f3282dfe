"""Computes a scene's anchors, and the power study that selects its scored metrics."""

from pathlib import Path

from crowdbench.metrics import WALK, metrics_for
from crowdbench.progress import steps
from crowdbench.run.jobs import plan
from crowdbench.run.judge import draws_of, entries_of, floors
from crowdbench.run.rollout_jobs import roll_out
from crowdbench.scene import load_scene
from crowdbench.scoring import scorecard
from crowdbench.scoring.power import Power, power
from crowdbench.scoring.reference import read_reference


def make_anchors(
    scene: str | Path, folder: Path, *, workers: int | None = None
) -> scorecard.Anchors:
    """Roll out the anchors of a scene in both protocols; the rollouts are stored in `folder`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    reference = read_reference(place)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit
    protocols = {}
    for protocol in ("full", "heldout"):
        jobs = plan(str(scene), place, scorecard.BASELINES, protocol, seeds, folder)
        rolled = roll_out(jobs, reference, workers)
        entries = entries_of(place, reference, rolled, protocol, seeds)
        scale = scorecard.Scale(floor=floors(place, reference, protocol), anchors=entries)
        protocols[protocol] = scale.of(place.protocol.scored)
    return scorecard.Anchors(
        schema=scorecard.SCHEMA,
        scene=place.id,
        made_from=scorecard.files_of(place),
        protocols=protocols,
    )


def power_study(scene: str | Path, folder: Path, *, workers: int | None = None) -> list[Power]:
    """Study how well each metric distinguishes the anchors from the recording.

    See `crowdbench.scoring.power`. The rollouts are stored in `folder`.

    Raises:
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    reference = read_reference(place)
    seeds = place.protocol.fits * place.protocol.rollouts_per_fit
    jobs = plan(str(scene), place, [scorecard.ANCHOR, scorecard.WALK_ANCHOR], "full", seeds, folder)
    rolled = roll_out(jobs, reference, workers)
    draws = draws_of(place, reference, "full")
    found = []
    for metric in steps("power", [m for m in metrics_for(reference.blocks) if m.scored]):
        pair = scorecard.WALK_ANCHOR if metric.family in WALK else scorecard.ANCHOR
        crowds = [
            what.of(metric) for job, what in rolled.items() if (job.spawn, job.policy) == pair
        ]
        recorded = reference.statistics[metric.name]
        study = power(metric, recorded, crowds, reference.blocks, draws)
        if study is not None:
            found.append(study)
    return found
