"""The reward of the environment views: one rule, five parts, each with a weight."""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float32

from crowdbench.errors import SettingError
from crowdbench.simulation import Simulation
from crowdbench.simulation.state import GOAL

STANDING_W, WALKING_W = 2.23, 1.26
"""e_s in W/kg and e_w in W s²/(kg m²): what standing and walking cost."""


@dataclass(frozen=True)
class Reward:
    """Weights of the parts of a person's reward in a step.

    The effort is the energy of walking, (e_s + e_w v²) dt in J/kg with e_s = 2.23 and e_w = 1.26
    (Guy et al. 2010, PLEdestrians, Symposium on Computer Animation, eq. 1): per metre it is least
    at 1.33 m/s, so that nobody gains by running.
    """

    progress: float = 1.0
    """Per metre come nearer to the goal."""
    arrival: float = 1.0
    """On reaching it."""
    overlap: float = -0.5
    """Times the depth of the overlap with the nearest person, 0 to 1: centre in centre."""
    wall: float = -0.1
    """On meeting a wall."""
    effort: float = -0.05
    """Per J/kg."""

    def __post_init__(self) -> None:
        for name in PARTS:
            if not np.isfinite(getattr(self, name)):
                raise SettingError(
                    f"reward {name}", got=str(getattr(self, name)), expected="a finite weight"
                )

    def parts(self, simulation: Simulation) -> Float32[np.ndarray, "W N 5"]:
        """Weighted parts, in the order of `PARTS`, of everyone who acted in the last step.

        It needs `simulation.nearest` of after the step, which `observe` makes; the sum over the
        last axis is the reward. Slots of others hold zeros.
        """
        slots, scene = simulation.slots, simulation.scene
        found = np.zeros((*slots.alive.shape, len(PARTS)), np.float32)
        acted = (slots.alive & ~slots.spawned) | (slots.ended != 0)
        at = np.nonzero(acted)
        velocity = slots.velocity[at]
        squared = velocity[:, 0] ** 2 + velocity[:, 1] ** 2
        diameter = 2 * scene.motion.person_radius_m
        overlap = np.maximum(0, 1 - simulation.nearest[at] / np.float32(diameter))
        measured = (
            slots.progress[at],
            slots.ended[at] == GOAL,
            overlap,
            slots.hit_wall[at],
            (STANDING_W + WALKING_W * squared) * np.float32(scene.dt_s),
        )
        found[at] += np.stack(measured, axis=1) * self._weights  # added: no −0.0
        return found

    @property
    def _weights(self) -> np.ndarray:
        return np.array([getattr(self, name) for name in PARTS], np.float32)


PARTS = tuple(f.name for f in fields(Reward))
"""Names of the parts, in order."""
