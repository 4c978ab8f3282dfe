"""The reward of the environments: a weighted sum of seven parts.

Its unit is one metre of progress to the target. Walking at the preferred speed is optimal for every
discount factor; see `Reward`.
"""

import math
from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float32, Int
from numba import njit, prange

from crowdbench.compilation import kernel
from crowdbench.errors import SettingError
from crowdbench.simulation.simulation import Simulation
from crowdbench.simulation.state import GOAL, TO_GOAL, TO_VIA, WAITING
from crowdbench.spawn.recorded_plans import PASSED_M, VISIT_M

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
        self._weights = np.array([getattr(reward, name) for name in PARTS], np.float64)
        shape = simulation.slots.alive.shape
        self._person = np.full(shape, -1, np.int32)
        self._behind = np.zeros(shape, np.float32)
        self._apart = np.zeros(shape, np.float32)
        self._parts = pay.fresh()

    def begin(self, worlds: Int[np.ndarray, " n"] | slice = slice(None)) -> None:
        """Begin an episode of these worlds, or of all, with everyone on schedule."""
        self._person[worlds] = -1

    def parts(self) -> Float32[np.ndarray, "W N 7"]:
        """Weighted parts, in the order of `PARTS`, for everyone who acted in the last step.

        Call it once per step, after `observe`, which must also have been called before the step.
        The sum over the last axis is the reward. Other slots are zero.
        """
        simulation = self._simulation
        slots, motion = simulation.slots, simulation.scene.motion
        found = np.zeros((*slots.alive.shape, len(PARTS)), np.float32)
        self._parts(
            slots.alive.size if simulation.worlds > 1 else 1,
            slots,
            simulation.queue,
            simulation.remaining,
            simulation.remaining_before,
            simulation.nearest,
            simulation.limits,
            2 * motion.person_radius_m,
            self._weights,
            self._person,
            self._behind,
            self._apart,
            found,
        )
        return found


@kernel
def pay(
    slots, queue, remaining, remaining_before, nearest, limits, diameter, weights, person, behind,
    apart, out,
):  # fmt: skip
    """Write the weighted parts of everyone who acted in the last step to `out` (W, N, 7).

    `person` and `behind` (W, N) are kept from step to step: whose schedule it is, and by how many
    metres the person is behind it. `apart` (W, N) is working memory.
    """
    alive, ended, spawned, hit_wall = slots.alive, slots.ended, slots.spawned, slots.hit_wall
    position, velocity, speed = slots.position, slots.velocity, slots.speed
    stage_before, stage, event, via = slots.stage_before, slots.stage, slots.event, queue.via
    for w in prange(alive.shape[0]):
        measure_companions(w, alive, ended, position, event, queue.group, apart)
        for i in range(alive.shape[1]):
            if person[w, i] != slots.person[w, i]:  # a new person starts on schedule
                person[w, i] = slots.person[w, i]
                behind[w, i] = 0.0
            if (alive[w, i] and not spawned[w, i]) or ended[w, i] != 0:
                to_via = np.nan
                if stage_before[w, i] != TO_GOAL:
                    dx = np.float64(via[w, event[w, i], 0]) - np.float64(position[w, i, 0])
                    dy = np.float64(via[w, event[w, i], 1]) - np.float64(position[w, i, 1])
                    to_via = math.sqrt(dx * dx + dy * dy)
                vx, vy = np.float64(velocity[w, i, 0]), np.float64(velocity[w, i, 1])
                before = np.float64(behind[w, i])
                progress, arrival, pace, stop, late = trip_parts(
                    stage_before[w, i], stage[w, i], ended[w, i] == GOAL,
                    np.float64(remaining_before[w, i]), np.float64(remaining[w, i]), to_via, before,
                    np.float64(speed[w, i]), math.sqrt(vx * vx + vy * vy), limits.dt,
                    limits.goal_radius,
                )  # fmt: skip
                behind[w, i] = late
                usual = np.float64(speed[w, i]) * limits.dt
                depth = max(0.0, 1.0 - np.float64(nearest[w, i]) / diameter)
                wall = limits.dt if hit_wall[w, i] else 0.0
                beyond = max(0.0, np.float64(apart[w, i]) - TOGETHER_M) / APART_M
                me = out[w, i]
                me[0] = weights[0] * progress
                me[1] = weights[1] * arrival
                me[2] = weights[2] * limits.dt * depth
                me[3] = weights[3] * wall
                me[4] = weights[4] * pace
                me[5] = weights[5] * stop
                me[6] = weights[6] * usual * bounded(beyond)
                for k in range(me.shape[0]):
                    me[k] += np.float32(0.0)  # no −0.0


@njit(error_model="numpy")
def trip_parts(
    stage_before, stage, arrived, remaining_before, remaining, to_via, behind, preferred, speed, dt,
    goal_radius,
):  # fmt: skip
    """The parts of one person that depend on its own trip, without weights.

    `remaining_before` and `remaining` are the lengths of its path to the target before and after
    the step, `to_via` the straight distance to its via point after it (read only if the target was
    not the goal before the step) and `behind` by how much it was behind its schedule, in metres;
    `preferred` and `speed` are in m/s. Returns progress, arrival, pace and stop, see `Reward`, and
    by how much it is behind now.
    """
    usual = preferred * dt
    waiting = stage_before == WAITING
    due = 0.0 if waiting else usual
    left = remaining
    # Where the target has just changed, progress is that to the former one.
    turned = stage_before != TO_GOAL and stage == TO_GOAL
    if turned:
        left = to_via
    if arrived:  # the path ends at the disc around the goal: the way inside does not count
        left = min(goal_radius, remaining_before)
    nearer = remaining_before - left
    # Giving up a via point is no progress; the straight way to it may lead through walls.
    if turned and stage_before == TO_VIA and to_via > PASSED_M:
        nearer = 0.0
    late = behind + due - nearer
    progress = due - (max(0.0, late) - max(0.0, behind))
    arrival = usual if arrived else 0.0
    if waiting:
        x, y = speed / PACE_MPS, max(0.0, to_via - VISIT_M) / VISIT_M
        return progress, arrival, 0.0, usual * (1.0 - 1.0 / ((1.0 + x * x) * (1.0 + y * y))), late
    return progress, arrival, usual * bounded((speed - preferred) / PACE_MPS), 0.0, late


@njit(error_model="numpy")
def bounded(x):
    """x²/(1 + x²): 0 at 0, half at 1, at most 1."""
    return x * x / (1.0 + x * x)


@njit(error_model="numpy")
def measure_companions(w, alive, ended, position, event, group, apart):
    """Write everyone's distance to the nearest companion who is present to `apart`; 0 without.

    Those whose trips have just ended are present.
    """
    size = alive.shape[1]
    slot = np.empty(size, np.int32)
    count = 0
    for i in range(size):
        apart[w, i] = 0.0
        if (alive[w, i] or ended[w, i] != 0) and group[w, event[w, i]] >= 0:
            apart[w, i] = np.inf
            slot[count] = i
            count += 1
    for a in range(count):
        i = slot[a]
        mine = group[w, event[w, i]]
        for b in range(a + 1, count):
            j = slot[b]
            if group[w, event[w, j]] == mine:
                dx, dy = (
                    position[w, i, 0] - position[w, j, 0],
                    position[w, i, 1] - position[w, j, 1],
                )
                gap = math.sqrt(dx * dx + dy * dy)
                apart[w, i] = min(apart[w, i], gap)
                apart[w, j] = min(apart[w, j], gap)
    for a in range(count):
        if apart[w, slot[a]] == np.inf:
            apart[w, slot[a]] = 0.0
