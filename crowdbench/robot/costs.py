"""What a robot costs people: against a twin of its world in which there is no robot.

A twin is made when an episode begins: the same people in the same places, with the same arrivals
and the same random numbers of their policy. Both worlds are stepped side by side. Where the robot
influences nobody, they remain equal to the last bit, and all costs are exactly 0.
"""

import math
from typing import NamedTuple

import numpy as np

from crowdbench.compilation import compiled
from crowdbench.robot.crowds import Crowds
from crowdbench.simulation.routes import Routes
from crowdbench.simulation.state import PENDING, TO_VIA, WAITING

COSTS = {
    "extra_time_s": "time that the robot cost all people together: by how much longer they are "
    "there or wait to enter, and by how much more time, at their preferred speeds, they still need "
    "to their goals at the end; seconds",
    "extra_path_m": "by how much longer the ways of all people together are, those that they still "
    "have to go at the end included; metres",
    "extra_acceleration_mps2": "by how much higher the mean length of a person's acceleration is, "
    "m/s²",
}
"""The costs of an episode, in `info` at its end, and what they mean."""
_SLOWEST_MPS = 0.1


class Tally(NamedTuple):
    """Sums over the people of each world since an episode began, (rows,)."""

    frames: np.ndarray
    """Frames in which somebody walked or waited to enter."""
    walked: np.ndarray
    """Way walked, metres."""
    acted: np.ndarray
    """Frames in which somebody walked."""
    changed: np.ndarray
    """Changes of velocities, m/s."""


class Costs:
    """The costs of the present episodes of W worlds, whose twins are the worlds W to 2W − 1."""

    def __init__(self, crowds: Crowds) -> None:
        self._crowds = crowds
        rows = crowds.simulation.worlds
        self._tally = Tally(*(np.zeros(rows) for _ in Tally._fields))
        self._velocity = crowds.simulation.slots.velocity[:, :-1].copy()
        self._routes = Routes.on(crowds.scene)

    def begin(self, worlds: np.ndarray) -> None:
        """Begin an episode in some worlds (n,) with new twins."""
        self._crowds.fork(worlds)
        rows = np.concatenate([worlds, worlds + self._crowds.worlds])
        for of in self._tally:
            of[rows] = 0.0
        self._velocity[rows] = self._crowds.simulation.slots.velocity[rows, :-1]

    def add(self) -> None:
        """Add the frame in which everyone has just walked."""
        simulation = self._crowds.simulation
        slots, queue, clock = simulation.slots, simulation.queue, simulation.clock
        _add(
            slots.alive, slots.spawned, slots.ended, self._crowds.before, slots.position,
            self._velocity, slots.velocity, queue.due, queue.status, clock.cursor, clock.frame,
            self._tally,
        )  # fmt: skip
        np.copyto(self._velocity, slots.velocity[:, :-1])

    def of(self, worlds: np.ndarray) -> dict[str, np.ndarray]:
        """The costs of the episodes of some worlds (n,) so far; see `COSTS`."""
        twins = worlds + self._crowds.worlds
        dt_s = self._crowds.scene.dt_s
        here, there = (Tally(*(of[rows] for of in self._tally)) for rows in (worlds, twins))
        left_s, left_m = zip(*(self._left(rows) for rows in (worlds, twins)), strict=True)
        mean = [t.changed / np.maximum(t.acted * dt_s, dt_s) for t in (here, there)]
        return {
            "extra_time_s": dt_s * (here.frames - there.frames) + (left_s[0] - left_s[1]),
            "extra_path_m": (here.walked - there.walked) + (left_m[0] - left_m[1]),
            "extra_acceleration_mps2": mean[0] - mean[1],
        }

    def _left(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Time and way that the people of some rows (n,) still need to their goals, together."""
        simulation = self._crowds.simulation
        slots, queue, dt_s = simulation.slots, simulation.queue, self._crowds.scene.dt_s
        there = slots.alive[rows].copy()
        there[:, -1] = False
        k, i = np.nonzero(there)
        w = rows[k]
        target = slots.target[w, i].astype(np.float64)
        position = slots.position[w, i].astype(np.float64)
        to, beyond = self._routes.next_of(w, i, position, target)
        way = np.linalg.norm(to - position, axis=1) + beyond
        way += np.linalg.norm(slots.goal[w, i] - target, axis=1)
        event, frame = slots.event[w, i], simulation.clock.frame[w]
        stage = slots.stage[w, i]
        rest = np.where(stage == TO_VIA, queue.wait[w, event], 0)
        rest += np.where(stage == WAITING, np.maximum(slots.until[w, i] - frame, 0), 0)
        time_s = way / np.maximum(slots.speed[w, i], _SLOWEST_MPS) + dt_s * rest
        # Whoever still waits to enter has the whole way to go.
        m, e = np.nonzero(
            (queue.due[rows] <= simulation.clock.frame[rows, None])
            & (queue.status[rows] == PENDING)
        )
        w = rows[m]
        start, goal = queue.start[w, e], queue.goal[w, e]
        via = np.where(np.isnan(queue.via[w, e]), start, queue.via[w, e])
        whole = np.linalg.norm(via - start, axis=1) + np.linalg.norm(goal - via, axis=1)
        whole_s = whole / np.maximum(queue.speed[w, e], _SLOWEST_MPS) + dt_s * queue.wait[w, e]
        index, size = np.concatenate([k, m]), len(rows)
        return (
            np.bincount(index, np.concatenate([time_s, whole_s]), size),
            np.bincount(index, np.concatenate([way, whole]), size),
        )


@compiled
def _add(
    alive, spawned, ended, before, position, velocity_before, velocity, due, status, cursor, frame,
    tally,
):  # fmt: skip
    """Add a frame to the tally of each row; see `Tally`."""
    for w in range(alive.shape[0]):
        acted, walked, changed = 0, 0.0, 0.0
        for i in range(before.shape[1]):
            if (alive[w, i] and not spawned[w, i]) or ended[w, i] != 0:
                dx = np.float64(position[w, i, 0]) - np.float64(before[w, i, 0])
                dy = np.float64(position[w, i, 1]) - np.float64(before[w, i, 1])
                vx = np.float64(velocity[w, i, 0]) - np.float64(velocity_before[w, i, 0])
                vy = np.float64(velocity[w, i, 1]) - np.float64(velocity_before[w, i, 1])
                acted += 1
                walked += math.sqrt(dx * dx + dy * dy)
                changed += math.sqrt(vx * vx + vy * vy)
        waiting = 0
        e = np.int64(cursor[w])
        while e < due.shape[1] and due[w, e] <= frame[w]:
            if status[w, e] == PENDING:
                waiting += 1
            e += 1
        tally.frames[w] += acted + waiting
        tally.walked[w] += walked
        tally.acted[w] += acted
        tally.changed[w] += changed
