"""Recorded plans: the stop, the preferred speed and the end of each recorded trip.

A recorded trip goes on until the person leaves the picture; a simulated one ends when the person
comes within the goal radius of its goal. So that both are treated alike, recorded trips are cut off
where a simulated one would end.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.scene import Scene
from crowdbench.trajectories.stops import HALF_S, stops_of
from crowdbench.trajectories.table import Trajectories

VISIT_M = 1.0
"""Distance at which a via point counts as visited; see `Simulation`."""


@dataclass(frozen=True, eq=False)
class RecordedPlans:
    """What each of the `P` persons of a recording does between entry and goal."""

    via: Float[np.ndarray, "P 2"]
    """Place of the person's longest stop, metres; NaN without a stop."""
    wait_s: Float[np.ndarray, " P"]
    """Time from coming within 1 m of that place, where a simulated wait begins, to the end of the
    stop, seconds; 0 without a stop."""
    speed: Float[np.ndarray, " P"]
    """Path length over duration outside all stops, m/s; NaN for people who never walk. The 0.8 s
    in which people come to rest, and set off, are left out too."""


@lru_cache(maxsize=4)  # a scene's recording is used by models, policies and metrics
def plans_of(crowd: Trajectories) -> RecordedPlans:
    """The plans of the people in a recording."""
    size, stops = len(crowd), stops_of(crowd)
    order = np.lexsort((stops.first, -stops.duration_s, stops.person))
    person, at = np.unique(stops.person[order], return_index=True)
    longest = order[at]
    via, wait_s = np.full((size, 2), np.nan), np.zeros(size)
    via[person] = stops.place[longest]
    xy = crowd.xy.astype(np.float64)
    for p, stop in zip(person.tolist(), longest.tolist(), strict=True):
        came = int(stops.first[stop])
        while came > crowd.offsets[p] and np.hypot(*(xy[came - 1] - via[p])) <= VISIT_M:
            came -= 1
        wait_s[p] = (stops.last[stop] - came) * crowd.dt_s
    steps = np.linalg.norm(np.diff(xy, axis=0), axis=1)
    of_row = crowd.row_person()
    walked = np.diff(of_row) == 0
    half = max(1, round(HALF_S / crowd.dt_s))  # people come to rest and set off in this time
    begins = np.maximum(stops.first - half, crowd.offsets[stops.person])
    ends = np.minimum(stops.last + half, crowd.offsets[stops.person + 1] - 1)
    for first, last in zip(begins.tolist(), ends.tolist(), strict=True):
        walked[first:last] = False
    whose = of_row[1:][walked]
    way = np.bincount(whose, steps[walked], minlength=size)
    time_s = np.bincount(whose, minlength=size) * crowd.dt_s
    speed = np.divide(way, time_s, out=np.full(size, np.nan), where=time_s > 0)
    return RecordedPlans(via, wait_s, speed)


def cut_at_goals(crowd: Trajectories, scene: Scene) -> Trajectories:
    """The crowd, with each trip cut off where a simulated trip would have ended.

    That is the first step after the person's last stop that comes within the goal radius of its
    goal (moved to the nearest walkable place). Columns of persons remain as they are.
    """
    goal = scene.nearest_walkable(crowd.goal.astype(np.float64))
    xy, person = crowd.xy.astype(np.float64), crowd.row_person()
    earliest = crowd.offsets[:-1].copy()
    stops = stops_of(crowd)
    np.maximum.at(earliest, stops.person, stops.last)
    near = np.zeros(len(xy), dtype=bool)  # whether the step that leads to a row comes near the goal
    near[1:] = _distance(goal[person[1:]], xy[:-1], xy[1:]) <= scene.motion.goal_radius_m
    near &= np.arange(len(xy)) > earliest[person]
    last = crowd.offsets[1:] - 1
    arrived = np.flatnonzero(near)
    whose, at = np.unique(person[arrived], return_index=True)
    last[whose] = arrived[at]
    kept = np.arange(len(xy)) <= last[person]
    length: Int[np.ndarray, " P"] = last + 1 - crowd.offsets[:-1]
    return replace(crowd, xy=crowd.xy[kept], offsets=np.concatenate([[0], np.cumsum(length)]))


def _distance(
    point: Float[np.ndarray, "n 2"], a: Float[np.ndarray, "n 2"], b: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, " n"]:
    """Distance of each point to the segment from a to b, metres."""
    way, off = b - a, point - a
    squared = (way * way).sum(axis=1)
    along = np.divide((off * way).sum(axis=1), squared, out=np.zeros(len(a)), where=squared > 0)
    off -= np.clip(along, 0, 1)[:, None] * way
    return np.asarray(np.sqrt((off * off).sum(axis=1)))
