"""The reward of the environments: a weighted sum of seven parts.

Its unit is one metre of progress to the target. Walking at the preferred speed is optimal for every
discount factor; see `Reward`.
"""

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Bool, Float32, Int

from crowdbench.errors import SettingError
from crowdbench.simulation import Simulation
from crowdbench.simulation.state import GOAL, TO_GOAL, TO_VIA, WAITING
from crowdbench.spawn.plans import PASSED_M, VISIT_M

PACE_MPS = 0.5
"""Deviation from the preferred speed at which the pace cost is half of its maximum."""
TOGETHER_M = 1.5
"""Up to this distance from a companion, walking apart costs nothing."""
APART_M = 1.0
"""Distance beyond `TOGETHER_M` at which the cost is half of its maximum."""


@dataclass(frozen=True)
class Reward:
    """Weights of the parts of a person's reward in a step of dt seconds.

    A plain reward for progress or arrival makes agents run, for two reasons. With a discount,
    earlier rewards count more (Kwiatkowski et al. 2023, Reward Function Design for Crowd Simulation
    via Reinforcement Learning, MIG '23, doi 10.1145/3623264.3624452). During exploration, each
    noisy step has a cost, so that fewer steps cost less.

    Here progress towards the target (the via point, then the goal) is rewarded only up to a
    schedule of v* metres per second since the person entered, where v* is the preferred speed. The
    schedule pauses while the person waits at its via point. An agent that runs gets no more per
    step but has fewer steps. A slower agent gets the same reward later. Unless people overlap or
    touch walls, the costs per second are below v*, so that ending a trip early never pays.
    """

    progress: float = 1.0
    """Per metre of progress to the target (along the path that the observation shows), up to the
    distance that the person could have covered at its preferred speed since it entered."""
    arrival: float = 1.0
    """On reaching the goal, times v*·dt, the reward of one step. With a greater weight, running
    pays if γ is small."""
    overlap: float = -1.0
    """Per second, times the depth of the overlap with the nearest person, from 0 (none) to 1 (same
    position)."""
    wall: float = -0.25
    """Per second of contact with a wall."""
    pace: float = -0.8
    """Per second, times v*·x²/(1 + x²), where x is the deviation of the speed from v* in units of
    `PACE_MPS`. It is 0 at the preferred speed and bounded at other speeds. Not while the person
    waits."""
    stop: float = -0.8
    """Per second of waiting at a via point, times v*·(1 − 1/((1 + x²)(1 + y²))), where x is the
    speed in units of `PACE_MPS` and y the distance to the via point beyond 1 m, in metres. It is 0
    for a person who stands there."""
    companions: float = -0.15
    """Per second, times v*·z²/(1 + z²), where z is the distance to the nearest companion who is
    present, beyond `TOGETHER_M` and in units of `APART_M`."""

    def __post_init__(self) -> None:
        for name in PARTS:
            if not np.isfinite(getattr(self, name)):
                raise SettingError(
                    f"reward {name}", got=str(getattr(self, name)), expected="a finite weight"
                )


PARTS = tuple(f.name for f in fields(Reward))
"""Names of the parts, in the order of `Rewarder.parts`."""


class Rewarder:
    """Computes the rewards of a simulation and tracks how far people are behind their schedules."""

    def __init__(self, reward: Reward, simulation: Simulation) -> None:
        self._simulation = simulation
        self._weights = np.array([getattr(reward, name) for name in PARTS], np.float32)
        shape = simulation.slots.alive.shape
        self._person = np.full(shape, -1, np.int32)
        self._behind = np.zeros(shape, np.float32)
        self._stage = np.full(shape, TO_GOAL, np.int8)

    def begin(self, worlds: Int[np.ndarray, " n"] | slice = slice(None)) -> None:
        """Begin an episode of these worlds, or of all, with everyone on schedule."""
        self._person[worlds] = -1
        self._stage[worlds] = self._simulation.slots.stage[worlds]

    def parts(self) -> Float32[np.ndarray, "W N 7"]:
        """Weighted parts, in the order of `PARTS`, for everyone who acted in the last step.

        Call it once per step, after `observe`, which must also have been called before the step.
        The sum over the last axis is the reward. Other slots are zero.
        """
        simulation = self._simulation
        slots, scene = simulation.slots, simulation.scene
        self._behind[self._person != slots.person] = 0.0  # a new person starts on schedule
        self._person[:] = slots.person
        found = np.zeros((*slots.alive.shape, len(PARTS)), np.float32)
        at = np.nonzero((slots.alive & ~slots.spawned) | (slots.ended != 0))
        dt = np.float32(scene.dt_s)
        usual = slots.speed[at] * dt
        waiting = self._stage[at] == WAITING
        due = np.where(waiting, np.float32(0), usual)
        arrived = slots.ended[at] == GOAL
        # The path ends at the disc around the goal, so the distance walked inside does not count.
        nearer = simulation.remaining_before[at]
        radius = np.float32(scene.motion.goal_radius_m)
        # Where the target has just changed, progress is that to the former one.
        turned = (self._stage[at] != TO_GOAL) & (slots.stage[at] == TO_GOAL)
        left = simulation.remaining[at]
        left[turned] = simulation.to_via(at[0][turned], at[1][turned])
        nearer -= np.where(arrived, np.minimum(radius, nearer), left)
        # Giving up a via point is no progress; the straight way to it may lead through walls.
        nearer[turned & (self._stage[at] == TO_VIA) & (left > PASSED_M)] = 0.0
        self._stage[:] = slots.stage
        before = self._behind[at]
        behind = before + due - nearer
        self._behind[at] = behind
        diameter = 2 * scene.motion.person_radius_m
        speed = np.hypot(*slots.velocity[at].T)
        x = (speed - slots.speed[at]) / np.float32(PACE_MPS)
        measured = (
            due - (np.maximum(behind, 0) - np.maximum(before, 0)),
            usual * arrived,
            dt * np.maximum(0, 1 - simulation.nearest[at] / np.float32(diameter)),
            dt * slots.hit_wall[at],
            np.where(waiting, np.float32(0), usual * _bounded(x)),
            usual * self._moving(at[0], at[1], waiting, speed),
            usual * _bounded(np.maximum(0, self._apart()[at] - TOGETHER_M) / APART_M),
        )
        found[at] += np.stack(measured, axis=1) * self._weights  # added: no −0.0
        return found

    def _moving(
        self,
        world: Int[np.ndarray, " n"],
        slot: Int[np.ndarray, " n"],
        waiting: Bool[np.ndarray, " n"],
        speed: Float32[np.ndarray, " n"],
    ) -> Float32[np.ndarray, " n"]:
        """How far people who wait are from standing at their via points: 0 to 1."""
        found = np.zeros(len(waiting), np.float32)
        if waiting.any():
            off = self._simulation.to_via(world[waiting], slot[waiting]) - VISIT_M
            x, y = speed[waiting] / PACE_MPS, np.maximum(0, off) / VISIT_M
            found[waiting] = 1 - 1 / ((1 + x**2) * (1 + y**2))
        return found

    def _apart(self) -> Float32[np.ndarray, "W N"]:
        """Distance of each person to the nearest companion who is present, metres; 0 without."""
        slots = self._simulation.slots
        found = np.zeros(slots.alive.shape, np.float32)
        world, slot = np.nonzero(slots.alive | (slots.ended != 0))
        group = self._simulation.groups(world, slots.event[world, slot])
        order = np.flatnonzero(group >= 0)
        order = order[np.lexsort((group[order], world[order]))]
        world, slot, group = world[order], slot[order], group[order]
        position = slots.position[world, slot]
        nearest = np.full(len(order), np.inf, np.float32)
        for lag in range(1, len(order)):  # until no group is that large
            same = (group[lag:] == group[:-lag]) & (world[lag:] == world[:-lag])
            if not same.any():
                break
            gap = np.where(same, np.hypot(*(position[lag:] - position[:-lag]).T), np.inf)
            nearest[lag:] = np.minimum(nearest[lag:], gap)
            nearest[:-lag] = np.minimum(nearest[:-lag], gap)
        found[world, slot] = np.where(np.isfinite(nearest), nearest, 0)
        return found


def _bounded(x: Float32[np.ndarray, " n"]) -> Float32[np.ndarray, " n"]:
    """x²/(1 + x²): 0 at 0, half at 1, at most 1."""
    square = x * x
    return np.asarray(square / (1 + square), np.float32)
