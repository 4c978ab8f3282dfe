"""Displacements: where people are shown instead of on their recorded paths, and come back."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from crowdbench.trajectories import Trajectories


@dataclass(frozen=True, eq=False)
class Aside:
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
    ) -> "Aside":
        """Half of the persons are on a spring at each time, a new one after 4 τ."""
        shape = (len(recording.xy), 2)
        found = cls(np.zeros(shape), np.zeros(shape), np.zeros(shape))
        rng = np.random.default_rng(seed)
        chosen = rng.random(len(recording)) < 0.5
        if displaced_m == 0:
            return found
        dt_s, every = recording.dt_s, max(1, round(4 * recovery_s / recording.dt_s))
        for person in np.flatnonzero(chosen).tolist():
            rows = slice(*recording.offsets[person : person + 2].tolist())
            length = rows.stop - rows.start
            k, step = np.divmod(np.arange(length) + int(rng.integers(every)), every)
            delta, epsilon = rng.normal(0.0, displaced_m, (2, k[-1] + 1, 2))[:, k]
            velocity = epsilon / recovery_s
            left_s = (np.arange(length - 1, -1, -1) * dt_s)[:, None]
            # The steps before, now and after, each on the spring of now: who has just been
            # displaced has a velocity as if it had come along that.
            before, now, after = (
                _spring(delta, velocity, step[:, None] * dt_s + step_s, recovery_s)
                * np.clip((left_s - step_s) / recovery_s, 0, 1)
                for step_s in (-dt_s, 0.0, dt_s)
            )
            found.now[rows], found.after[rows] = now, after
            found.drift[rows] = (now - before) / dt_s
        return found


def _spring(
    displaced: Float[np.ndarray, "n 2"],
    velocity: Float[np.ndarray, "n 2"],
    t: Float[np.ndarray, "n 1"],
    tau: float,
) -> Float[np.ndarray, "n 2"]:
    """Where a critically damped spring is at t if it is there, at that velocity, at 0."""
    return (displaced + (velocity + displaced / tau) * t) * np.exp(-t / tau)
