"""What a policy can get that walks as recorded people do, but draws random numbers of its own.

    python -m studies cheats-twins eth-v0 gc-v0 forum-v0 --policy anticipate

prints a table for each scene. A policy is compared with the recording as in the protocol `heldout`,
and with its own rollouts: if the recording were one of them, this would be its score. Two rollouts
differ by chance, the more so the less there is to count. So even a perfect model with random
numbers scores less than 1, and the second number is an estimate of how much it scores.
"""

from collections.abc import Sequence
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np

from crowdbench import registry
from crowdbench.data.blocks import SPLITS
from crowdbench.data.table import Trajectories
from crowdbench.errors import SettingError
from crowdbench.metrics import WALK
from crowdbench.metrics.metric import Statistics, in_blocks, total
from crowdbench.policies import Straight
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout, rollouts
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import summarise
from crowdbench.spawn.areas import read_areas
from studies.markdown import table

ROLLOUTS = 6
"""Number of rollouts in each fold."""


class Twins(NamedTuple):
    """Scores in a metric, means over the folds."""

    family: str
    metric: str
    number: int
    """Size of the recording's sample, all folds together."""
    recorded: float
    """Score of the policy."""
    own: float
    """Score that it would get if the recording were one of its rollouts."""


def twins(scene: Scene, policy: str, count: int = ROLLOUTS) -> list[Twins]:
    """Compare a policy with the recording and with itself in each scored metric of walking.

    Raises:
        RecordingError: the recording is not imported.
        SettingError: fewer than two rollouts are asked for, or the policy does not exist.
    """
    if count < 2:
        raise SettingError("rollouts", got=str(count), expected="2 or more")
    reference, areas = reference_of(scene), read_areas(scene)
    arrivals = registry.spawn_model("replay", scene)
    metrics = [m for m in reference.metrics if m.family in WALK and m.name in scene.protocol.scored]

    def summarised(crowds: Sequence[Trajectories]) -> list[dict[str, Statistics]]:
        return [
            summarise(areas.assign(crowd), reference.blocks, reference.place, metrics)
            for crowd in crowds
        ]

    (anchor,) = summarised([rollout(scene, arrivals, Straight(), seed=0)])
    found: dict[str, list[tuple[int, float, float]]] = {m.name: [] for m in metrics}
    for fold in SPLITS[1:]:
        held_out = reference.blocks.in_split(fold)
        blocks = reference.blocks.take(held_out)
        walker = registry.policy(policy, scene, fold)
        own = summarised(rollouts(scene, [arrivals] * count, walker, seeds=range(count)))
        for m in metrics:
            y, straight, *each = (
                in_blocks(statistics[m.name], held_out)
                for statistics in (reference.statistics, anchor, *own)
            )
            scale = m.compare(y, straight, blocks).distance
            to_recording = [m.compare(y, x, blocks).distance for x in each]
            to_own = [m.compare(x, z, blocks).distance for x, z in combinations(each, 2)]
            score, of_own = (float(1 - np.mean(d) / scale) for d in (to_recording, to_own))
            found[m.name].append((m.size(total(y)), score, of_own))
    return [
        Twins(
            family=m.family,
            metric=m.name,
            number=sum(number for number, _, _ in found[m.name]),
            recorded=float(np.mean([score for _, score, _ in found[m.name]])),
            own=float(np.mean([of_own for _, _, of_own in found[m.name]])),
        )
        for m in metrics
    ]


def tables(scene: str | Path, policy: str, count: int = ROLLOUTS) -> str:
    """The scores of a scene as a Markdown table, with those of the families."""
    found = twins(load_scene(scene), policy, count)
    lines = [
        [t.family, t.metric.replace("_", " "), f"{t.number:,}", f"{t.recorded:.2f}", f"{t.own:.2f}"]
        for t in found
    ]
    for family in WALK:
        some = [t for t in found if t.family == family]
        means = (np.mean([t.recorded for t in some]), np.mean([t.own for t in some]))
        lines.append([f"**{family}**", "mean", "", *(f"{mean:.2f}" for mean in means)])
    head = ["family", "metric", "recorded values", policy, "the same, if it were right"]
    return table(head, lines)
