"""A random search for blind wanderers that score well.

    python -m studies cheats-search [SCENE] [--draws N]

Each draw is a crowd of straight walkers with random errors in their velocities: white noise, a slow
wander along and across the path, a sinusoidal sway, and a personal deviation from the preferred
speed. None of them sees anybody.
"""

from pathlib import Path

import numpy as np

from crowdbench.errors import SettingError
from crowdbench.policies import Policy, SocialForce, StateView
from crowdbench.registry import recording_of
from crowdbench.run.jobs import Job
from crowdbench.run.judge import judge
from crowdbench.run.references import reference_of
from crowdbench.run.rollout import rollout
from crowdbench.run.summaries import RolloutSummary
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.scorecard import read_anchors
from crowdbench.spawn import Replay
from studies.cheats.walkers import Wanderer

NAMES = ("white", "wander along", "wander across", "memory", "sway", "period, s", "speeds")


class RandomWanderer(Wanderer):
    """A blind wanderer with random parameters."""

    def __init__(self, name: str, of: np.ndarray) -> None:
        super().__init__(name, (float(of[1]), float(of[2])), float(of[3]))
        self._of = of

    def act(self, seen: StateView) -> np.ndarray:
        """Actions with wander, white noise, sway and a personal speed."""
        white, _, _, _, sway, period_s, speeds = self._of.tolist()
        actions = super().act(seen).astype(np.float64)
        own = np.random.default_rng(3).standard_normal((100_000, 2))[seen.person % 100_000]
        phase = 2 * np.pi * (seen.frame * self._scene.dt_s / period_s + own[:, 0])
        across = np.stack([-actions[:, 1], actions[:, 0]], axis=1)
        actions = actions * (1 + speeds * own[:, 1:]) + sway * np.sin(phase)[:, None] * across
        noise = self._rng.standard_normal(actions.shape) * white
        return (actions + noise / self._scene.motion.max_speed_mps).astype(np.float32)


def search(of_scene: str, draws: int) -> list[str]:
    """Lines with the ten best draws by walk, the best by motion, and social forces.

    Raises:
        SceneError, RecordingError: the scene does not exist, or its recording is not imported.
        SettingError: there are no draws.
    """
    if draws < 1:
        raise SettingError("draws", got=str(draws), expected="1 or more")
    scene = load_scene(of_scene)
    reference, crowd = reference_of(scene), recording_of(scene)
    scale, rng = read_anchors(scene).protocols["full"], np.random.default_rng(0)
    low = np.array([0.0, 0.0, 0.0, 0.5, 0.0, 2.0, 0.0])
    high = np.array([0.2, 0.5, 0.5, 0.98, 0.4, 12.0, 0.15])
    drawn = {f"draw {k}": low + rng.random(7) * (high - low) for k in range(draws)}
    policies: dict[str, Policy] = {"social-force": SocialForce()}
    policies |= {name: RandomWanderer(name, of) for name, of in drawn.items()}
    rolled = {}
    for name, policy in policies.items():
        job = Job(scene.id, "replay", name, "full", 0, 0, Path(), "")
        walked = rollout(scene, Replay(crowd), policy, seed=0)
        rolled[job] = RolloutSummary.of_crowd(walked, reference)
    table = [
        r for r in rows(judge(scene, reference, rolled, "full", 2, scale)) if r.kind == "entry"
    ]
    best = sorted(table, key=lambda row: -row.walk.value if row.walk else 9.0)
    blind = [row for row in table if row.policy in drawn]
    moving = max(blind, key=lambda row: row.families["motion"].value)
    shown = [*best[:10], moving, next(r for r in table if r.policy == "social-force")]
    lines = []
    for row in shown:
        families = {name: round(score.value, 2) for name, score in row.families.items()}
        of = drawn.get(row.policy)
        settings = {} if of is None else dict(zip(NAMES, of.round(2).tolist(), strict=True))
        walk = None if row.walk is None else round(row.walk.value, 2)
        lines.append(f"{row.policy:13} walk {walk} {families} {settings}")
    return lines
