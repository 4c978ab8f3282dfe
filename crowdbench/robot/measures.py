"""Measures of a robot's episodes: success, safety, comfort and efficiency.

The names are those of Francis et al. (2023), "Principles and guidelines for evaluating social robot
navigation algorithms", Table 4, and of HuNavSim (Pérez-Higueras et al. 2023, IEEE RA-L 8), where
these have one. All distances to people are between surfaces, as in HuNavSim: the distance of the
centres minus both radii.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

INTIMATE_M = 0.45
PERSONAL_M = 1.2
"""Hall's (1966) bounds of intimate and personal space, as in HuNavSim."""
SOON_S = 2.0
STILL_MPS = 0.01
STILL_RPS = 0.02
"""Speeds below which a robot stands still, as in HuNavSim's `time_not_moving`."""

MEASURES = {
    "success": "1 if the last goal was reached",
    "collision": "1 if the robot touched a person or a wall",
    "collision_person": "number of contacts with people that began",
    "collision_wall": "number of contacts with walls that began",
    "timeout": "1 if the time limit ended the episode",
    "time_s": "length of the episode, seconds",
    "path_length_m": "length of the robot's path, metres",
    "spl": "success weighted by path length: success · L / max(L, path length), with the length L "
    "of the shortest path around walls at the start (Anderson et al. 2018, eq. 1)",
    "min_distance_m": "least distance to a person, metres; NaN if nobody was there",
    "mean_distance_m": "mean over time of the distance to the nearest person, metres",
    "intimate_space_share": "share of time with a person nearer than 0.45 m",
    "personal_space_share": "share of time with a person nearer than 1.2 m",
    "ttc_below_2s_share": "share of time in which the robot would touch a person within 2 s if all "
    "kept their velocities",
    "jerk_mps3": "mean length of the change of the robot's acceleration per second, m/s³",
    "stalled_s": "time in which the robot neither drove (0.01 m/s) nor turned (0.02 rad/s), "
    "seconds",
}
"""The measures of an episode, in `info` at its end, and what they mean.

Of each period of time, the state at its end counts. Contacts are found along the whole way.
"""


class Period(NamedTuple):
    """What the robots of W worlds did in a control period."""

    moved_m: Float[np.ndarray, " W"]
    velocity: Float[np.ndarray, "W 2"]
    still: Bool[np.ndarray, " W"]
    gap_m: Float[np.ndarray, " W"]
    """Distance to the nearest person, infinite if there is none."""
    collision_s: Float[np.ndarray, " W"]
    """Time to collision."""
    contacts: Int[np.ndarray, " W"]
    """Contacts with people that began."""
    walls: Bool[np.ndarray, " W"]
    """Whether a contact with a wall began."""


class Measures:
    """Sums over the present episodes of W worlds."""

    def __init__(self, worlds: int, period_s: float) -> None:
        self._period_s = period_s
        self._sums = {name: np.zeros(worlds) for name in _SUMS}
        self._shortest = np.zeros(worlds)
        self._nearest = np.full(worlds, np.inf)
        self._velocity = np.zeros((worlds, 2))
        self._acceleration = np.zeros((worlds, 2))

    @property
    def steps(self) -> Int[np.ndarray, " W"]:
        """Number of control periods of each episode so far."""
        return self._sums["steps"].astype(np.int64)

    @property
    def collided(self) -> Bool[np.ndarray, " W"]:
        """Whether the robot has touched a person or wall in the episode."""
        return (self._sums["people"] + self._sums["walls"]) > 0

    def begin(self, worlds: Int[np.ndarray, " n"], shortest_m: Float[np.ndarray, " n"]) -> None:
        """Begin an episode in some worlds; `shortest_m` is the shortest way to the last goal."""
        for sums in self._sums.values():
            sums[worlds] = 0.0
        self._shortest[worlds] = shortest_m
        self._nearest[worlds] = np.inf
        self._velocity[worlds] = self._acceleration[worlds] = 0.0

    def add(self, period: Period) -> None:
        """Add a control period to all episodes."""
        sums, met = self._sums, np.isfinite(period.gap_m)
        sums["steps"] += 1
        sums["path"] += period.moved_m
        sums["still"] += period.still
        sums["people"] += period.contacts
        sums["walls"] += period.walls
        sums["met"] += met
        sums["distance"] += np.where(met, period.gap_m, 0.0)
        sums["intimate"] += period.gap_m < INTIMATE_M
        sums["personal"] += period.gap_m < PERSONAL_M
        sums["soon"] += period.collision_s < SOON_S
        np.minimum(self._nearest, period.gap_m, out=self._nearest)
        acceleration = (period.velocity - self._velocity) / self._period_s
        change = (acceleration - self._acceleration) / self._period_s
        sums["jerk"] += np.sqrt((change * change).sum(axis=1))
        self._velocity[:] = period.velocity
        self._acceleration = acceleration

    def of(
        self,
        worlds: Int[np.ndarray, " n"],
        success: Bool[np.ndarray, " n"],
        timeout: Bool[np.ndarray, " n"],
    ) -> dict[str, np.ndarray]:
        """The measures of the episodes of some worlds, each (n,); see `MEASURES`."""
        sums = {name: values[worlds] for name, values in self._sums.items()}
        steps, path = np.maximum(sums["steps"], 1), sums["path"]
        shortest, nearest = self._shortest[worlds], self._nearest[worlds]
        longest = np.maximum(np.maximum(shortest, path), 1e-9)
        met = np.maximum(sums["met"], 1)
        return {
            "success": success.astype(np.float64),
            "collision": (sums["people"] + sums["walls"] > 0).astype(np.float64),
            "collision_person": sums["people"],
            "collision_wall": sums["walls"],
            "timeout": timeout.astype(np.float64),
            "time_s": sums["steps"] * self._period_s,
            "path_length_m": path,
            "spl": success * shortest / longest,
            "min_distance_m": np.where(np.isfinite(nearest), nearest, np.nan),
            "mean_distance_m": np.where(sums["met"] > 0, sums["distance"] / met, np.nan),
            "intimate_space_share": sums["intimate"] / steps,
            "personal_space_share": sums["personal"] / steps,
            "ttc_below_2s_share": sums["soon"] / steps,
            "jerk_mps3": sums["jerk"] / steps,
            "stalled_s": sums["still"] * self._period_s,
        }


_SUMS = (
    "steps", "path", "still", "people", "walls", "met", "distance", "intimate", "personal", "soon",
    "jerk",
)  # fmt: skip
