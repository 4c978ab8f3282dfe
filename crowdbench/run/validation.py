"""How well a policy walks in the time blocks that it was trained on.

Settings of a policy, such as the width of its samples, must not be chosen on the blocks that it is
scored on. `validate` gives the walk score of a policy on the training blocks of a split instead.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Int

from crowdbench import registry
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import SettingError
from crowdbench.metrics import WALK
from crowdbench.metrics.groups import CompanionDistance, CompanionOffset
from crowdbench.metrics.interaction import WallClearance
from crowdbench.metrics.metric import Statistics
from crowdbench.metrics.motion import Speed
from crowdbench.metrics.rows import block_of_frames
from crowdbench.policies import Policy, Straight
from crowdbench.run.judge import FINISHED
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout
from crowdbench.run.rollout import rollouts as roll_out
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.reference import summarise
from crowdbench.scoring.score import LOWEST
from crowdbench.spawn.areas import read_areas
from crowdbench.spawn.fits import check_split

COMPANIONS = (CompanionDistance.name, CompanionOffset.name)
_SEEDS = 1_000_000
"""First seed of the rollouts, far from those of evaluations."""


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
    """Share of those whose trips ended in these blocks who reached the goal."""
    ratios: Mapping[str, float]
    """Mean of each metric's typical value, divided by that of the recording: of the metrics of
    walking, and of `COMPANIONS`, if the scene has statistics of them. A crowd without companions
    counts as one whose companions are 5 m apart."""
    clearance: tuple[tuple[float, ...], tuple[float, ...]]
    """Shares (41 each) of positions at each distance to walls, in steps of 5 cm up to 2 m and
    beyond: of the recording, and of the policy."""
    passes: bool
    """Whether speed and arrivals are within the limits of the scene's gate. The standard is the
    recording, where all reach their goals."""

    @property
    def companion_distance(self) -> float:
        """The ratio of the distance of companions; NaN if the scene has no statistics of them."""
        return self.ratios.get(CompanionDistance.name, np.nan)

    @property
    def walk(self) -> float:
        """The lesser of the two families; at most 0 if the policy does not pass the gate."""
        value = min(self.families.values())
        return value if self.passes else min(0.0, value)


def validate(
    scene: str | Path | Scene, policy: str | Policy, split: str = "full", *, rollouts: int = 1
) -> Validation:
    """Walk a policy under the recorded arrivals and score it on the training blocks of `split`.

    The whole recording is simulated, because crowds at the beginning of a block are part of it.
    Only what happens in the training blocks is compared: all positions outside of them are removed
    first, also those of the delayed people that `avoidance` needs. The random numbers are not those
    of evaluations.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        policy: a policy, or its name, file or folder as in `crowdbench.policy`; of a folder, the
            file of `split`.
        split: `full`, or `fold0`, `fold1`, … for the blocks that the fold is *not* scored on.
        rollouts: number of rollouts whose distances are averaged.

    Raises:
        RecordingError: the recording is not imported.
        SceneError, SettingError: the scene, split or policy does not exist, `rollouts` is not
            positive, or straight walkers cannot be told from the recording in these blocks.
        WeightsError: the file of the policy is missing or invalid.
    """
    return Validator(scene, split).validate(policy, rollouts=rollouts)


class Validator:
    """Validates several policies on the same scene and split, as `validate` does one.

    Straight walkers, which all are compared with, are walked only once.
    """

    def __init__(
        self, scene: str | Path | Scene, split: str = "full", *, horizon_s: float | None = None
    ) -> None:
        """Raises RecordingError, SceneError, SettingError: see `validate`.

        With `horizon_s`, only the first seconds are simulated; blocks that end in them count.
        """
        check_split(split, 0)
        self.scene, self.split, self._horizon_s = load_scene(scene), split, horizon_s
        self._arrivals = registry.spawn_model("replay", self.scene)
        self._reference = reference_of(self.scene)
        self._blocks = self._reference.blocks.training(split)
        if horizon_s is not None:
            within = self._blocks.frames[:, 1] <= self.scene.frames(horizon_s)
            if not within.any():
                raise SettingError(
                    "horizon_s", got=f"{horizon_s:g}", expected="a time in which a block ends"
                )
            self._blocks = self._blocks.take(within)
        self._metrics = [m for m in self._reference.metrics if m.family in WALK]
        self._metrics += [m for m in self._reference.metrics if m.name in COMPANIONS]
        self._recorded = self._seen(registry.recording_of(self.scene))
        straight = rollout(self.scene, self._arrivals, Straight(), seed=_SEEDS, horizon_s=horizon_s)
        self._anchor = self._distances([self._seen(straight)])
        if not any(self._anchor.values()):
            raise SettingError(
                f"scene {self.scene.id}",
                got="no metric of walking that is scored",
                expected="at least one",
            )

    def judges(self, metric: str) -> bool:
        """Whether policies get a score of this metric."""
        return self._anchor.get(metric, 0) > 0

    def validate(self, policy: str | Policy, *, rollouts: int = 1) -> Validation:
        """See the function `validate`."""
        if rollouts < 1:
            raise SettingError("rollouts", got=str(rollouts), expected="1 or more")
        place, recorded, blocks = self.scene, self._recorded, self._blocks
        walker = registry.policy(policy, place, self.split)
        seeds = [_SEEDS + k for k in range(rollouts)]
        if self._horizon_s is None:
            crowds = roll_out(place, [self._arrivals] * rollouts, walker, seeds=seeds)
        else:
            crowds = [
                rollout(place, self._arrivals, walker, seed=seed, horizon_s=self._horizon_s)
                for seed in seeds
            ]
        seen = [self._seen(crowd) for crowd in crowds]
        scores = {
            name: max(LOWEST, 1 - distance / self._anchor[name])
            for name, distance in self._distances(seen).items()
            if self._anchor[name] > 0
        }
        families: dict[str, float] = {}
        for family in WALK:
            metrics = [m.name for m in self._metrics if m.family == family and m.name in scores]
            if metrics:
                families[family] = float(np.mean([scores[name] for name in metrics]))
        ended = np.sum([self._ended(crowd) for crowd in crowds], axis=0)
        at_goal = float(ended[FINISHED[0]] / max(1, ended[list(FINISHED)].sum()))
        speed, walls = Speed(), WallClearance()
        speed_mps = float(np.mean([speed.walking_mps(here[speed.name]) or 0.0 for here in seen]))
        recorded_mps = speed.walking_mps(recorded[speed.name]) or np.nan
        ratios = {}
        for metric in self._metrics:
            if metric.name in recorded and metric.applies(blocks):
                of = [metric.compare(recorded[metric.name], h[metric.name], blocks) for h in seen]
                if of[0].recorded:
                    ratios[metric.name] = float(np.mean([r.simulated / r.recorded for r in of]))
        largest = walls.if_empty(blocks)
        clear = [_shares(here[walls.name], largest) for here in seen]
        passes = (
            abs(speed_mps / recorded_mps - 1) <= place.gate.speed and at_goal >= place.gate.arrivals
        )
        return Validation(
            scores=scores,
            families=families,
            speed_mps=speed_mps,
            recorded_speed_mps=recorded_mps,
            at_goal=at_goal,
            ratios=ratios,
            clearance=(
                _shares(recorded[walls.name], largest),
                tuple(np.mean(clear, axis=0).tolist()),
            ),
            passes=passes,
        )

    def _ended(self, crowd: Trajectories) -> Int[np.ndarray, " outcomes"]:
        inside = block_of_frames(self._blocks, crowd.frames)[crowd.last] >= 0
        return np.bincount(crowd.outcome[inside], minlength=len(OUTCOMES))

    def _seen(self, crowd: Trajectories) -> dict[str, Statistics]:
        here = self._blocks.parts(read_areas(self.scene).assign(crowd))
        return summarise(here, self._blocks, self._reference.place, self._metrics)

    def _distances(self, seen: list[dict[str, Statistics]]) -> dict[str, float]:
        """Mean distance of crowds to the recording in each scored metric of walking."""
        recorded, blocks = self._recorded, self._blocks
        names = set(self.scene.protocol.scored) - {*COMPANIONS}
        return {
            m.name: float(
                np.mean([m.compare(recorded[m.name], of[m.name], blocks).distance for of in seen])
            )
            for m in self._metrics
            if m.name in names and m.applies(blocks)
        }


def _shares(statistics: Statistics, largest: int) -> tuple[float, ...]:
    """Shares of positions at each distance to walls, which are 0 to `largest` lattice steps."""
    counts = statistics["counts"].sum(axis=0)
    found = np.zeros(1 + largest)
    found[: len(counts)] = counts / max(1, counts.sum())
    return tuple(found.tolist())
