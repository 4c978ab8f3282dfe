"""The reward of the environment views: one rule, five parts, each with a weight.

Its unit is the metre of the way to the goal. The optimum is to walk at one's preferred speed,
whatever the discount: see `Reward`.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float32

from crowdbench.errors import SettingError
from crowdbench.simulation import Simulation
from crowdbench.simulation.state import GOAL

PACE_MPS = 0.5
"""Deviation from the preferred speed at which half of the pace's cost is due."""


@dataclass(frozen=True)
class Reward:
    """Weights of the parts of a person's reward in a step of dt seconds.

    A plain reward for progress or arrival makes agents run. With a discount, a sooner reward counts
    more (Kwiatkowski et al. 2023, Reward Function Design for Crowd Simulation via Reinforcement
    Learning, MIG '23, doi 10.1145/3623264.3624452). And while an agent explores, each noisy step
    has a cost, so that fewer steps cost less.

    Here a person has a schedule: v* metres per second since it entered, v* being its preferred
    speed. Progress is paid up to the schedule, never ahead of it. An agent that runs gets no more
    per step, and has fewer steps; one that is slower gets the same metres later. Unless people
    overlap, the costs per second are smaller than v*, so that a shorter life never pays.
    """

    progress: float = 1.0
    """Per metre come nearer to the goal (along the way that the observation shows), up to what the
    preferred speed has had time for since the person entered."""
    arrival: float = 1.0
    """On reaching the goal, times v*·dt: worth one step of the walk. With a greater weight, running
    pays where γ is small."""
    overlap: float = -1.0
    """Per second, times the depth of the overlap with the nearest person, 0 to 1: centre in
    centre."""
    wall: float = -0.25
    """Per second of meeting a wall."""
    pace: float = -0.8
    """Per second, times v*·x²/(1 + x²), where x is the speed's deviation from v* in units of
    `PACE_MPS`: 0 at the preferred speed, bounded for whoever stands or runs."""

    def __post_init__(self) -> None:
        for name in PARTS:
            if not np.isfinite(getattr(self, name)):
                raise SettingError(
                    f"reward {name}", got=str(getattr(self, name)), expected="a finite weight"
                )


PARTS = tuple(f.name for f in fields(Reward))
"""Names of the parts, in order."""


class Rewarder:
    """Hands out a reward in a simulation; keeps how far people are behind their schedules."""

    def __init__(self, reward: Reward, simulation: Simulation) -> None:
        self._simulation = simulation
        self._weights = np.array([getattr(reward, name) for name in PARTS], np.float32)
        shape = simulation.slots.alive.shape
        self._person = np.full(shape, -1, np.int32)
        self._behind = np.zeros(shape, np.float32)

    def begin(self) -> None:
        """An episode begins: everyone is on schedule."""
        self._person[:] = -1

    def parts(self) -> Float32[np.ndarray, "W N 5"]:
        """Weighted parts, in the order of `PARTS`, of everyone who acted in the last step.

        To be called once per step, after `observe`, which must have been called before the step
        too. The sum over the last axis is the reward. Slots of others hold zeros.
        """
        simulation = self._simulation
        slots, scene = simulation.slots, simulation.scene
        self._behind[self._person != slots.person] = 0.0  # the schedule begins
        self._person[:] = slots.person
        found = np.zeros((*slots.alive.shape, len(PARTS)), np.float32)
        at = np.nonzero((slots.alive & ~slots.spawned) | (slots.ended != 0))
        dt = np.float32(scene.dt_s)
        due = slots.speed[at] * dt
        arrived = slots.ended[at] == GOAL
        # The way ends at the disc around the goal: how far a last step goes into it does not count.
        nearer = simulation.remaining_before[at]
        radius = np.float32(scene.motion.goal_radius_m)
        nearer -= np.where(arrived, np.minimum(radius, nearer), simulation.remaining[at])
        before = self._behind[at]
        behind = before + due - nearer
        self._behind[at] = behind
        diameter = 2 * scene.motion.person_radius_m
        x = (np.hypot(*slots.velocity[at].T) - slots.speed[at]) / np.float32(PACE_MPS)
        measured = (
            due - (np.maximum(behind, 0) - np.maximum(before, 0)),
            due * arrived,
            dt * np.maximum(0, 1 - simulation.nearest[at] / np.float32(diameter)),
            dt * slots.hit_wall[at],
            due * x**2 / (1 + x**2),
        )
        found[at] += np.stack(measured, axis=1) * self._weights  # added: no −0.0
        return found
