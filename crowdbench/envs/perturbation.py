"""Displacements: where people are shown instead of on their recorded paths, and come back.

Where a recording was annotated in some frames only and lies straight in between, displaced people
change their velocity in these frames only too: else they would be told by their unrest.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32, Int

from crowdbench.trajectories.table import Trajectories

HOMING_S = 2.0
"""So long before its record ends whoever is displaced goes straight to where that is, from any
frame as if it had not begun to yet. This looks like no unrest, since the goal is in sight, and is
what a clone needs so as not to miss it."""
PACE_S = 4.0
WALKING_MPS = 0.8
"""Who goes more slowly than this, over 4 s, is displaced by less, and who stands by nothing: else
a clone would not know how to stand."""


@dataclass(frozen=True, eq=False)
class PathPerturbation:
    """Where each row of a recording is shown instead, beside its place, and how fast."""

    now: Float[np.ndarray, "R 2"]
    """Metres."""
    drift: Float[np.ndarray, "R 2"]
    """Added to the velocity, m/s."""
    after: Float[np.ndarray, "R 2"]
    """Where its action leads to, beside the next row's place, metres."""

    @classmethod
    def of(
        cls, recording: Trajectories, displaced_m: float, recovery_s: float, seed: int
    ) -> "PathPerturbation":
        """Half of the persons are on a spring at each time, a new one after 4 τ."""
        shape = (len(recording.xy), 2)
        found = cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        rng = np.random.default_rng(seed)
        chosen = rng.random(len(recording)) < 0.5
        if displaced_m == 0:
            return found
        dt_s = recording.dt_s
        knot = max(1, round(recording.grid_s / dt_s))
        every = max(1, round(4 * recovery_s / (knot * dt_s)))
        for person in np.flatnonzero(chosen).tolist():
            rows = slice(*recording.offsets[person : person + 2].tolist())
            length = rows.stop - rows.start
            at, within = np.divmod(recording.first[person] + np.arange(length), knot)
            k, step = np.divmod(at - at[0] + int(rng.integers(every)), every)
            delta, epsilon = rng.normal(0.0, displaced_m, (2, k[-1] + 1, 2))[:, k]
            velocity = epsilon / recovery_s
            pace = _pace(recording.path(person), dt_s)

            # The frames before, now and after, each on the spring of now: who has just been
            # displaced has a velocity as if it had come along that.
            before, now, after = (
                _between_knots(delta, velocity, step, within + ahead, knot, dt_s, recovery_s)
                * pace[1 + ahead : 1 + ahead + length]
                for ahead in (-1, 0, 1)
            )
            left = np.arange(length - 1, -1, -1)[:, None]  # frames
            homing = (left > 0) & (left * dt_s <= HOMING_S)
            after = np.where(homing, now * (1 - 1 / np.maximum(left, 1)), after)
            now[-1] = before[-1] = 0.0  # at the goal
            found.now[rows], found.after[rows] = now, after
            found.drift[rows] = (now - before) / dt_s
        return found


def _pace(path: Float32[np.ndarray, "n 2"], dt_s: float) -> Float[np.ndarray, "n+2 1"]:
    """0 for who stands to 1 for who walks, in each frame, the one before them and the one after."""
    half = max(1, round(PACE_S / dt_s / 2))
    known = np.pad(path.astype(np.float64), ((half + 1, half + 1), (0, 0)), mode="edge")
    way = np.linalg.norm(known[2 * half :] - known[: -2 * half], axis=1)
    return np.clip(way / (2 * half * dt_s) / WALKING_MPS, 0, 1)[:, None]


def _between_knots(
    displaced: Float[np.ndarray, "n 2"],
    velocity: Float[np.ndarray, "n 2"],
    step: Int[np.ndarray, " n"],
    within: Int[np.ndarray, " n"],
    knot: int,
    dt_s: float,
    tau: float,
) -> Float[np.ndarray, "n 2"]:
    """The spring at the frames `step` · `knot` + `within`, straight from one knot to the next."""
    first = (step + within // knot)[:, None] * knot * dt_s
    share = (within % knot / knot)[:, None]
    ends = [_spring(displaced, velocity, t, tau) for t in (first, first + knot * dt_s)]
    return (1 - share) * ends[0] + share * ends[1]


def _spring(
    displaced: Float[np.ndarray, "n 2"],
    velocity: Float[np.ndarray, "n 2"],
    t: Float[np.ndarray, "n 1"],
    tau: float,
) -> Float[np.ndarray, "n 2"]:
    """Where a critically damped spring is at t if it is there, at that velocity, at 0."""
    return (displaced + (velocity + displaced / tau) * t) * np.exp(-t / tau)
