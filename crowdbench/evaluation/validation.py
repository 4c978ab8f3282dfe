"""How well a policy walks in the time blocks that it was trained on.

Settings of a policy, such as the width of its samples, must not be chosen on the blocks that it is
scored on. `validate` gives the walk score of a policy on the training blocks of a split instead.
"""

import functools
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from crowdbench.errors import SettingError
from crowdbench.evaluation.references import reference_of
from crowdbench.metrics import WALK, Metric, Statistics
from crowdbench.metrics.motion import STANDING_MPS, Speed
from crowdbench.policies import Policy, Straight
from crowdbench.registry import spawn_model
from crowdbench.rollouts.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import Reference, summarise
from crowdbench.scoring.score import LOWEST
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.weights import check_split
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.table import OUTCOMES, Trajectories

_FINISHED = tuple(OUTCOMES.index(name) for name in ("goal", "exit", "timeout"))


@dataclass(frozen=True)
class Validation:
    """Results of a policy under the recorded arrivals, in the training blocks of a split."""

    scores: Mapping[str, float]
    """Score of each metric: 1 − d / d of straight walkers, where d is the mean distance to the
    recording; at least −1."""
    families: Mapping[str, float]
    """Mean score of the metrics of motion and of interaction."""
    speed_mps: float
    """Mean speed of people who walk."""
    recorded_speed_mps: float
    """The same in the recording."""
    at_goal: float
    """Share of those who finished their trips, in all blocks, who reached the goal."""
    passes: bool
    """Whether speed and arrivals are within the limits of the scene's gate. The standard is the
    recording, where all reach their goals."""

    @property
    def walk(self) -> float:
        """The lesser of the two families; at most 0 if the policy does not pass the gate."""
        value = min(self.families.values())
        return value if self.passes else min(0.0, value)


def validate(
    scene: str | Scene, policy: Policy, split: str = "full", *, rollouts: int = 1
) -> Validation:
    """Walk a policy under the recorded arrivals and score it on the training blocks of `split`.

    The whole recording is simulated, because crowds at the beginning of a block are part of it;
    only the training blocks are compared. The random numbers are not those of evaluations.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        policy: the policy, for example `OnnxPolicy(path)`.
        split: `full`, or `fold0`, `fold1`, … for the blocks that the fold is *not* scored on.
        rollouts: number of rollouts whose distances are averaged.

    Raises:
        RecordingError: the recording is not imported.
        SceneError, SettingError: the scene or split does not exist, `rollouts` is not positive, or
            straight walkers cannot be told from the recording in these blocks.
    """
    place = load_scene(scene)
    check_split(split, 0)
    if rollouts < 1:
        raise SettingError("rollouts", got=str(rollouts), expected="1 or more")
    arrivals = spawn_model("replay", place)
    reference = reference_of(place)
    crowds = [rollout(place, arrivals, policy, seed=_SEEDS + k) for k in range(rollouts)]
    distances = _distances(place, reference, split, crowds)
    straight = _straight(place.id if isinstance(scene, Scene) else str(scene), split)
    scores = {
        name: max(LOWEST, 1 - d / straight[name])
        for name, d in distances.items()
        if straight[name] > 0
    }
    family = {m.name: m.family for m in reference.metrics}
    families: dict[str, float] = {
        f: float(np.mean([s for name, s in scores.items() if family[name] == f]))
        for f in WALK
        if any(family[name] == f for name in scores)
    }
    if not families:
        raise SettingError(
            f"scene {place.id}", got="no metric of walking that is scored", expected="at least one"
        )
    ended = np.sum([np.bincount(c.outcome, minlength=len(OUTCOMES)) for c in crowds], axis=0)
    at_goal = float(ended[_FINISHED[0]] / max(1, ended[list(_FINISHED)].sum()))
    speed, recorded = _speeds(place, reference, split, crowds)
    passes = abs(speed / recorded - 1) <= place.gate.speed and at_goal >= place.gate.arrivals
    return Validation(scores, families, speed, recorded, at_goal, passes)


_SEEDS = 1_000_000
"""First seed of these rollouts, far from those of evaluations."""


@functools.lru_cache(maxsize=16)
def _straight(scene: str, split: str) -> dict[str, float]:
    """Distances of straight walkers, the anchor of the walk score."""
    place = load_scene(scene)
    walked = rollout(place, spawn_model("replay", place), Straight(), seed=_SEEDS)
    return _distances(place, reference_of(place), split, [walked])


def _distances(
    scene: Scene, reference: Reference, split: str, crowds: list[Trajectories]
) -> dict[str, float]:
    """Mean distance of the crowds in each scored metric of walking, in the training blocks."""
    inside = _training(reference.blocks, split)
    blocks = reference.blocks.training(split)
    metrics = [
        m
        for m in reference.metrics
        if m.family in WALK and m.name in scene.protocol.scored and m.applies(blocks)
    ]
    each: dict[str, list[float]] = {m.name: [] for m in metrics}
    for crowd in crowds:
        seen = _seen(scene, reference, crowd, metrics)
        for m in metrics:
            recorded = _rows(reference.statistics[m.name], inside)
            each[m.name].append(m.compare(recorded, _rows(seen[m.name], inside), blocks).distance)
    return {name: float(np.mean(values)) for name, values in each.items()}


def _speeds(
    scene: Scene, reference: Reference, split: str, crowds: list[Trajectories]
) -> tuple[float, float]:
    """Mean walking speeds of the crowds and of the recording in the training blocks, m/s."""
    inside, speed = _training(reference.blocks, split), Speed()
    of_crowds = [_seen(scene, reference, crowd, [speed])[speed.name] for crowd in crowds]
    simulated = [_mean_speed(_rows(seen, inside)) for seen in of_crowds]
    return float(np.mean(simulated)), _mean_speed(_rows(reference.statistics[speed.name], inside))


def _mean_speed(statistics: Statistics) -> float:
    counts = statistics["counts"].sum(axis=0)
    cm_per_s = np.arange(len(counts))
    counts = np.where(cm_per_s < 100 * STANDING_MPS, 0, counts)
    return float(counts @ cm_per_s) / max(1, int(counts.sum())) / 100


def _seen(
    scene: Scene, reference: Reference, crowd: Trajectories, metrics: list[Metric]
) -> dict[str, Statistics]:
    return summarise(read_areas(scene).assign(crowd), reference.blocks, reference.place, metrics)


def _training(blocks: TimeBlocks, split: str) -> np.ndarray:
    """Whether each block is trained on, as `TimeBlocks.training`."""
    return np.ones(len(blocks), dtype=bool) if split == "full" else ~blocks.in_split(split)


def _rows(statistics: Statistics, inside: np.ndarray) -> Statistics:
    return {name: values[inside] for name, values in statistics.items()}
