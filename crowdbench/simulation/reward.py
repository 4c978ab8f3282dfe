"""Rewards: functions of the state of a crowd. The usual one is a weighted sum of eight parts.

Its unit is one metre of progress to the target. Walking at the preferred speed is optimal for every
discount factor; see `Reward`.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from typing import TypeAlias

import numpy as np
from jaxtyping import Float32
from numba import njit, prange

from crowdbench.compilation import Kernel, subroutine
from crowdbench.errors import OwnCodeError, SettingError, checked
from crowdbench.plugins import blaming
from crowdbench.simulation.contact import AHEAD, HEADWAY_S
from crowdbench.simulation.state import GOAL, TO_GOAL, TO_VIA, WAITING, CrowdState
from crowdbench.spawn.recorded_plans import PASSED_M, VISIT_M

PACE_MPS = 0.5
"""Deviation from the preferred speed at which the pace cost is half of its maximum."""
TOGETHER_M = 1.5
"""Up to this distance from a companion, walking apart costs nothing."""
APART_M = 1.0
"""Distance beyond `TOGETHER_M` at which the cost is half of its maximum."""


@checked()
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
    step but has fewer steps. A slower agent gets the same reward later. Unless people overlap, or
    touch walls or bodies, the costs per second are below v*, so that ending a trip early never
    pays.

    Nobody can walk at v* in a queue of people with bodies. There the cost of a slow pace is
    measured from the speed that those ahead admit. (If the commanded speed counted instead,
    standing would cost, pushing would not, and everyone would learn to push.) So those who stand in
    a queue pay for neither, and those who push pay for `contact`. Being late has no cost of its
    own: progress is paid when it is made.
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
    waits. A slower person with bodies ahead, see `speed_ahead`, pays only for being slower than
    they admit."""
    stop: float = -0.8
    """Per second of waiting at a via point, times v*·(1 − 1/((1 + x²)(1 + y²))), where x is the
    speed in units of `PACE_MPS` and y the distance to the via point beyond 1 m, in metres. It is 0
    for a person who stands there."""
    companions: float = -0.15
    """Per second, times v*·z²/(1 + z²), where z is the distance to the nearest companion who is
    present, beyond `TOGETHER_M` and in units of `APART_M`."""
    contact: float = -0.25
    """Per second, times the share of the commanded way that other people's bodies, not walls, kept
    the person from walking (`Slots.held`), and times the commanded speed / v*, at most 1: to push
    gently costs less. 0 where people have no bodies."""

    def __post_init__(self) -> None:
        for name in PARTS:
            if not np.isfinite(getattr(self, name)):
                raise SettingError(
                    f"reward {name}", got=str(getattr(self, name)), expected="a finite weight"
                )


PARTS = tuple(f.name for f in fields(Reward))
"""Names of the parts, in the order in which a `Rewarder` returns them."""

RewardFn: TypeAlias = Callable[[CrowdState], np.ndarray]
"""A reward: called once after each step, it returns the parts of everyone's reward, float32
(W, N, parts), whose sum is the reward. Only those of people who acted in the step count, see
`Slots.acted`. `CrowdEnv` also calls it once when it is made, with empty slots."""


def reward_function(reward: Reward | RewardFn) -> RewardFn:
    """The function of a reward; what a function of a user's own returns is checked.

    Those who did not act get zeros.
    """
    return Rewarder(reward) if isinstance(reward, Reward) else partial(_checked, reward)


class Rewarder:
    """The weighted parts of `Reward`, in the order of `PARTS`.

    Each simulation needs one of its own, because it tracks how far people are behind their
    schedules. Everyone is on schedule when an episode begins.
    """

    def __init__(self, reward: Reward) -> None:
        self._weights = np.array([getattr(reward, name) for name in PARTS], np.float64)
        self._episode = np.zeros(0, np.int64)
        self._person = np.zeros((0, 0), np.int32)
        self._behind = self._apart = np.zeros((0, 0), np.float32)
        self._pay = pay.fresh()

    def __call__(self, state: CrowdState) -> Float32[np.ndarray, "W N 8"]:
        """The parts of everyone who acted in the last step, zeros in other slots.

        `Simulation.observe` must have been called before the step and after it.
        """
        slots, motion = state.slots, state.scene.motion
        shape = slots.alive.shape
        if self._person.shape != shape:
            self._episode = np.zeros(shape[0], np.int64)
            self._person = np.full(shape, -1, np.int32)
            self._behind, self._apart = np.zeros((2, *shape), np.float32)
        begun = state.episode != self._episode
        if begun.any():
            self._person[begun] = -1
            self._episode[:] = state.episode
        parts = np.zeros((*shape, len(PARTS)), np.float32)
        self._pay(
            slots.alive.size if shape[0] > 1 else 1,
            slots,
            state.queue,
            state.towards,
            state.remaining,
            state.remaining_before,
            state.nearest,
            state.scene.dt_s,
            motion.goal_radius_m,
            2 * motion.person_radius_m,
            motion.body_radius_m,
            self._weights,
            self._person,
            self._behind,
            self._apart,
            parts,
        )
        return parts


def total(parts: Float32[np.ndarray, "*n parts"]) -> Float32[np.ndarray, "*n"]:
    """Sum of the parts of each person, added in their order.

    `sum` adds eight numbers in another order than seven: a zero at the end would change the result.
    """
    added: np.ndarray = np.cumsum(parts, axis=-1)[..., -1]
    return added


def _checked(function: RewardFn, state: CrowdState) -> Float32[np.ndarray, "W N _"]:
    with blaming("reward"):
        parts = np.asarray(function(state), np.float32)
    acted = state.slots.acted
    if parts.shape[:-1] != acted.shape or not parts.shape[-1]:
        raise OwnCodeError(
            "reward",
            got=f"an array of shape {parts.shape}",
            expected=f"one of shape ({acted.shape[0]}, {acted.shape[1]}, parts), with at least "
            "one part",
            hint="Return reward[..., None] if it has no parts.",
        )
    parts = np.where(acted[..., None], parts, np.float32(0))
    if not np.isfinite(parts).all():
        got = f"{int((~np.isfinite(parts)).sum())} values that are not finite"
        raise OwnCodeError("reward", got=got, expected="finite numbers for everyone who acted")
    return parts


@Kernel
def pay(
    slots, queue, towards, remaining, remaining_before, nearest, dt, goal_radius, diameter,
    body_radius, weights, person, behind, apart, out,
):  # fmt: skip
    """Write the weighted parts of everyone who acted in the last step to `out` (W, N, 8).

    `person` and `behind` (W, N) are kept from step to step: whose schedule it is, and by how many
    metres the person is behind it. `apart` (W, N) is working memory.
    """
    for w in prange(slots.alive.shape[0]):
        measure_companions(w, slots.alive, slots.ended, slots.position, slots.event, queue.group,
                           apart)  # fmt: skip
        for i in range(slots.alive.shape[1]):
            pay_person(
                w, i, slots, queue, towards, remaining, remaining_before, nearest, dt, goal_radius,
                diameter, body_radius, weights, person, behind, apart[w, i], out,
            )  # fmt: skip


@subroutine
def pay_person(
    w, i, slots, queue, towards, remaining, remaining_before, nearest, dt, goal_radius, diameter,
    body_radius, weights, person, behind, apart, out,
):  # fmt: skip
    """The same for one person, whose nearest companion is `apart` metres away (0 without one)."""
    if person[w, i] != slots.person[w, i]:  # a new person starts on schedule
        person[w, i] = slots.person[w, i]
        behind[w, i] = 0.0
    if not ((slots.alive[w, i] and not slots.spawned[w, i]) or slots.ended[w, i] != 0):
        return
    to_via = np.nan
    if slots.stage_before[w, i] != TO_GOAL:
        e = slots.event[w, i]
        dx = np.float64(queue.via[w, e, 0]) - np.float64(slots.position[w, i, 0])
        dy = np.float64(queue.via[w, e, 1]) - np.float64(slots.position[w, i, 1])
        to_via = math.sqrt(dx * dx + dy * dy)
    vx, vy = np.float64(slots.velocity[w, i, 0]), np.float64(slots.velocity[w, i, 1])
    pace_mps, preferred = math.sqrt(vx * vx + vy * vy), np.float64(slots.speed[w, i])
    due_mps = preferred
    if body_radius > 0.0 and pace_mps < preferred:
        ahead = speed_ahead(w, i, slots.alive, slots.ended, slots.position, towards, body_radius)
        due_mps = max(pace_mps, min(preferred, ahead))
    before = np.float64(behind[w, i])
    progress, arrival, pace, stop, late = trip_parts(
        slots.stage_before[w, i], slots.stage[w, i], slots.ended[w, i] == GOAL,
        np.float64(remaining_before[w, i]), np.float64(remaining[w, i]), to_via, before,
        preferred, due_mps, pace_mps, dt, goal_radius,
    )  # fmt: skip
    behind[w, i] = late
    usual = preferred * dt
    depth = max(0.0, 1.0 - np.float64(nearest[w, i]) / diameter)
    wall = dt if slots.hit_wall[w, i] else 0.0
    cx, cy = np.float64(slots.commanded[w, i, 0]), np.float64(slots.commanded[w, i, 1])
    pushed = min(math.sqrt(cx * cx + cy * cy), preferred) * np.float64(slots.held[w, i])
    beyond = max(0.0, np.float64(apart) - TOGETHER_M) / APART_M
    me = out[w, i]
    me[0] = weights[0] * progress
    me[1] = weights[1] * arrival
    me[2] = weights[2] * dt * depth
    me[3] = weights[3] * wall
    me[4] = weights[4] * pace
    me[5] = weights[5] * stop
    me[6] = weights[6] * usual * bounded(beyond)
    me[7] = weights[7] * dt * pushed / preferred if preferred > 0.0 else 0.0
    for k in range(me.shape[0]):
        me[k] += np.float32(0.0)  # no −0.0


@subroutine
def trip_parts(
    stage_before, stage, arrived, remaining_before, remaining, to_via, behind, preferred, due_mps,
    speed, dt, goal_radius,
):  # fmt: skip
    """The parts of one person that depend on its own trip, without weights.

    `remaining_before` and `remaining` are the lengths of its path to the target before and after
    the step, `to_via` the straight distance to its via point after it (read only if the target was
    not the goal before the step) and `behind` by how much it was behind its schedule, in metres;
    `preferred`, `due_mps` and `speed` are in m/s: the preferred speed, the one from which the pace
    is measured, and the present one. Returns progress, arrival, pace and stop, see `Reward`, and by
    how much it is behind now.
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
    return progress, arrival, usual * bounded((speed - due_mps) / PACE_MPS), 0.0, late


@subroutine
def speed_ahead(w, i, alive, ended, position, towards, radius):
    """The speed in m/s towards the next point of its path that bodies ahead of a person admit.

    It is gap / `HEADWAY_S` with the smallest gap to somebody who is ahead, that is, whose direction
    has a cosine of more than `AHEAD` with that of the path; infinite if nobody is. Those whose
    trips have just ended count.
    """
    x, y = np.float64(position[w, i, 0]), np.float64(position[w, i, 1])
    to_x, to_y = np.float64(towards[w, i, 0]) - x, np.float64(towards[w, i, 1]) - y
    length = math.sqrt(to_x * to_x + to_y * to_y)
    least = np.inf
    for j in range(alive.shape[1]):
        if j != i and (alive[w, j] or ended[w, j] != 0):
            dx, dy = np.float64(position[w, j, 0]) - x, np.float64(position[w, j, 1]) - y
            distance = math.sqrt(dx * dx + dy * dy)
            if dx * to_x + dy * to_y > AHEAD * distance * length:
                least = min(least, distance)
    return max(0.0, least - 2.0 * radius) / HEADWAY_S


@subroutine
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
