"""What a right model would score: a policy against the recording that one of its rollouts is.

The rollouts are those of the policy's entry on the leaderboard, held out, so none is made for this.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from crowdbench.errors import SettingError
from crowdbench.files import write_json
from crowdbench.leaderboard.verification.entry import entry_path, read_entry, shipped_leaderboard
from crowdbench.metrics import WALK
from crowdbench.run.jobs import Job, Pair, plan
from crowdbench.run.judge import seen_in
from crowdbench.run.references import reference_of
from crowdbench.run.rollout_jobs import Progress, roll_out
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene
from crowdbench.scoring.ceilings import FILE, Ceiling, Ceilings
from crowdbench.scoring.scorecard import WALK_ANCHOR
from crowdbench.spawn.names import PERTURBED

POLICY = "anticipate"
PROTOCOL = "heldout"
RECORDED = 6
"""Number of rollouts that stand for the recording."""


def perturbed_of(policy: str) -> str:
    """The perturbed arrivals under which a policy's entry was ranked; without one, any."""
    path = entry_path(shipped_leaderboard() / "entries", policy)
    key = read_entry(path).key if path.is_file() else ""
    return f"{PERTURBED}:{key}" if key else PERTURBED


def measure(
    scene: Scene, policy: str, out: Path, workers: int | None, progress: Progress
) -> Ceilings:
    """The ceilings of a scene by a policy's rollouts.

    Raises:
        RecordingError: the recording is not imported.
        SettingError: the policy does not exist.
    """
    reference = reference_of(scene)
    seeds = scene.protocol.fits * scene.protocol.rollouts_per_fit

    def rolled(pair: Pair, number: int) -> dict[Job, RolloutSummary]:
        jobs = plan(scene.asked, scene, [pair], PROTOCOL, number, out)
        return roll_out([replace(job, shown=False) for job in jobs], reference, workers, progress)

    twins = rolled(("replay", policy), RECORDED)
    if len(twins) < 2:
        got = f"{policy}, which draws no random numbers"
        raise SettingError("policy", got=got, expected="one whose rollouts differ")
    others = rolled((perturbed_of(policy), policy), seeds)
    anchor = rolled(WALK_ANCHOR, 1)

    def ceiling(crowds: dict[Job, RolloutSummary]) -> Ceiling:
        metrics: dict[str, float] = {}
        families: dict[str, list[float]] = {}
        for metric in reference.metrics:
            if metric.family not in WALK or metric.name not in scene.protocol.scored:
                continue
            parts = zip(
                *(seen_in(reference, metric, of, PROTOCOL) for of in (twins, crowds, anchor)),
                strict=True,
            )
            spans, distances = [], []  # of the folds: a score is the ratio of their means
            for twin, crowd, straight in parts:
                blocks, scale = twin.blocks, straight.crowds[0]
                spans.append(metric.compare(twin.recorded, scale, blocks).distance)
                apart = [
                    metric.compare(y, x, blocks).distance
                    for k, y in enumerate(twin.crowds)
                    for j, x in enumerate(crowd.crowds)
                    if crowds is not twins or j != k
                ]
                distances.append(float(np.mean(apart)))
            score = 1 - float(np.mean(distances)) / float(np.mean(spans))
            metrics[metric.name] = round(score, 4)
            families.setdefault(metric.family, []).append(score)
        means = {family: round(float(np.mean(each)), 4) for family, each in families.items()}
        return Ceiling(metrics=metrics, families=means, walk=min(means.values()))

    return Ceilings(
        command=f"python -m studies ceilings {scene.id}",
        policy=policy,
        recorded=ceiling(twins),
        perturbed=ceiling(others),
    )


def write(scene: Scene, found: Ceilings) -> Path:
    """Write them beside the scene's other files; returns the path."""
    path = scene.folder / FILE
    write_json(path, found)
    return path
