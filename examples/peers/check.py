"""Checks the adapter: ORCA through it, beside `crowdbench.baselines.orca`.

ORCA draws no random numbers, but who gives way first depends on tiny nudges. Rollouts with other
nudges show by how much scores differ by chance.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

import crowdbench.baselines.orca as orca
from crowdbench.metrics import WALK
from crowdbench.policies import Policy
from crowdbench.registry import spawn_model
from crowdbench.run.jobs import Job
from crowdbench.run.judge import judge
from crowdbench.run.rollout import rollout
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import read_anchors

from .rvo_crowd import ORCA

TURN = 0.37
"""By how much the angles of nudges differ from one rollout to the next, radians."""


class Compared(NamedTuple):
    """The held-out scores of a family: means and standard deviations over rollouts."""

    scene: str
    family: str
    direct: tuple[float, float]
    """Of `crowdbench.baselines.orca`."""
    adapted: tuple[float, float]
    """Of ORCA through the adapter."""
    rollouts: int

    @property
    def apart(self) -> float:
        """Difference of the means in standard errors."""
        error = np.hypot(self.direct[1], self.adapted[1]) / np.sqrt(self.rollouts)
        return float(abs(self.adapted[0] - self.direct[0]) / max(error, 1e-9))


def compare(scene: str, rollouts: int = 5) -> Iterator[Compared]:
    """The scores of walking of both, under the recorded arrivals."""
    place = load_scene(scene)
    reference, arrivals = read_reference(place), spawn_model("replay", place)
    angle, rolled = orca.GOLDEN_ANGLE, {}
    try:
        for k in range(rollouts):
            orca.GOLDEN_ANGLE = angle + TURN * k
            kinds: dict[str, Policy] = {"direct": orca.ORCA(), "adapted": ORCA()}
            for name, walker in kinds.items():
                crowd = rollout(place, arrivals, walker, seed=0)
                job = Job(place.id, "replay", f"{name} {k}", "full", 0, 0, Path(), "")
                rolled[job] = RolloutSummary.of_crowd(crowd, reference)
    finally:
        orca.GOLDEN_ANGLE = angle
    yield from _compared(place, rolled, rollouts)


def _compared(place: Scene, rolled: dict[Job, RolloutSummary], rollouts: int) -> Iterator[Compared]:
    scale = read_anchors(place).protocols["heldout"]
    card = judge(place, read_reference(place), rolled, "heldout", 2, scale)
    for family in WALK:
        found = {}
        for name in ("direct", "adapted"):
            mine = [row for row in rows(card) if row.policy.startswith(name)]
            values = [row.families[family].value for row in mine]
            found[name] = (float(np.mean(values)), float(np.std(values, ddof=1)))
        yield Compared(place.id, family, found["direct"], found["adapted"], rollouts)
