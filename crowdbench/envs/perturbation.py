"""Displacements of recorded people from their paths, and their return to them.

If a recording was annotated only every few frames and interpolated linearly in between, displaced
people also change their velocity in the annotated frames only. Otherwise their motion would be less
steady than the recorded motion.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Float32

from crowdbench.data.table import Indices, Points, Trajectories

HOMING_S = 2.0
"""In this time before the end of a trajectory, the actions of a displaced person lead straight to
the last recorded position, each from the position on the spring in its frame. A cloned policy needs
these demonstrations to reach its goal."""
PACE_S = 4.0
"""Window over which the speed of a person is measured."""
WALKING_MPS = 0.8
"""People slower than this are displaced by less, and those who stand still are not displaced.
Otherwise a cloned policy would not learn to stand still."""


@dataclass(frozen=True, eq=False)
class PathPerturbation:
    """Displacement of each of the `R` rows of a recording."""

    now: Float[np.ndarray, "R 2"]
    """Offset from the recorded position, in metres."""
    drift: Float[np.ndarray, "R 2"]
    """Offset from the recorded velocity, in m/s."""
    after: Float[np.ndarray, "R 2"]
    """Offset from the next recorded position to which the action leads, in metres."""

    @classmethod
    def of(
        cls,
        recording: Trajectories,
        displaced_m: float,
        recovery_s: float,
        seed: int,
        interval: int = 1,
    ) -> "PathPerturbation":
        """Displace a random half of the persons, each with a new spring every 4 τ.

        They change their velocities in the annotated frames or, if `interval` is above 1, in each
        `interval`-th frame of their trips.
        """
        shape = (len(recording.xy), 2)
        found = cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        rng = np.random.default_rng(seed)
        chosen = rng.random(len(recording)) < 0.5
        if displaced_m == 0:
            return found
        dt_s = recording.dt_s
        knot = interval if interval > 1 else max(1, round(recording.grid_s / dt_s))
        every = max(1, round(4 * recovery_s / (knot * dt_s)))
        for person in np.flatnonzero(chosen).tolist():
            rows = slice(*recording.offsets[person : person + 2].tolist())
            length = rows.stop - rows.start
            since = 0 if interval > 1 else recording.first[person]
            at, within = np.divmod(since + np.arange(length), knot)
            k, step = np.divmod(at - at[0] + int(rng.integers(every)), every)
            delta, epsilon = rng.normal(0.0, displaced_m, (2, k[-1] + 1, 2))[:, k]
            velocity = epsilon / recovery_s
            pace = _pace(recording.path(person), dt_s)

            # The frames before, now and after are all computed from the present spring. A person
            # who has just been displaced thus has the velocity of that spring.
            before, now, after = (
                _between_knots(delta, velocity, step, within + ahead, knot, dt_s, recovery_s)
                * pace[1 + ahead : 1 + ahead + length]
                for ahead in (-1, 0, 1)
            )
            left = np.arange(length - 1, -1, -1)[:, None]  # frames until the end
            homing = (left > 0) & (left * dt_s <= HOMING_S)
            after = np.where(homing, now * (1 - 1 / np.maximum(left, 1)), after)
            now[-1] = before[-1] = 0.0  # at the goal
            found.now[rows], found.after[rows] = now, after
            found.drift[rows] = (now - before) / dt_s
        return found


def _pace(path: Float32[np.ndarray, "n 2"], dt_s: float) -> Float[np.ndarray, "n+2 1"]:
    """Weight of displacements, from 0 (standing) to 1 (walking), per frame.

    The first and last values belong to the frames before and after the trajectory.
    """
    half = max(1, round(PACE_S / dt_s / 2))
    known = np.pad(path.astype(np.float64), ((half + 1, half + 1), (0, 0)), mode="edge")
    way = np.linalg.norm(known[2 * half :] - known[: -2 * half], axis=1)
    return np.clip(way / (2 * half * dt_s) / WALKING_MPS, 0, 1)[:, None]


def _between_knots(
    displaced: Points,
    velocity: Points,
    step: Indices,
    within: Indices,
    knot: int,
    dt_s: float,
    tau: float,
) -> Points:
    """The spring at frames `step` · `knot` + `within`, interpolated linearly between knots."""
    first = (step + within // knot)[:, None] * knot * dt_s
    share = (within % knot / knot)[:, None]
    ends = [_spring(displaced, velocity, t, tau) for t in (first, first + knot * dt_s)]
    return (1 - share) * ends[0] + share * ends[1]


def _spring(displaced: Points, velocity: Points, t: Float[np.ndarray, "n 1"], tau: float) -> Points:
    """Displacement at time t of a critically damped spring, from displacement and velocity at 0."""
    return (displaced + (velocity + displaced / tau) * t) * np.exp(-t / tau)
