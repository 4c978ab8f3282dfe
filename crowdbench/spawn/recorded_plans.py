"""Recorded plans: the stop, the preferred speed and the end of each recorded trip.

A recorded trip goes on until the person leaves the picture; a simulated one ends when the person
comes within the goal radius of its goal. So that both are treated alike, recorded trips are cut off
where a simulated one would end.
"""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from jaxtyping import Float, Int

from crowdbench.data.stops import HALF_S, stops_of
from crowdbench.data.table import Flags, Numbers, Points, Trajectories
from crowdbench.scene import Scene

VISIT_M = 1.0
"""Distance at which a via point counts as visited; see `Simulation`."""
PASSED_M = 3.0
"""Distance up to which a via point counts as visited by those who have passed it."""
SLOWEST_MPS = 0.3
"""People who are slower than this, outside their stops, hardly walk."""
SHORTEST_S = 2.0
"""People who walk for less time than this, or less than 1 m, hardly walk either."""
SHORTEST_M = 1.0


@dataclass(frozen=True, eq=False)
class RecordedPlans:
    """What each of the `P` persons of a recording does between entry and goal."""

    via: Float[np.ndarray, "P 2"]
    """Place of the person's longest stop, metres; NaN without a stop."""
    wait_s: Float[np.ndarray, " P"]
    """Time from the step that visits that place, by the rule of the simulation, to the end of the
    stop, seconds; 0 without a stop."""
    resumed: Int[np.ndarray, " P"]
    """Row of `Trajectories.xy` where the longest stop ends; the person's first row without one."""
    speed: Float[np.ndarray, " P"]
    """Path length over duration outside all stops, m/s. The 0.8 s in which people come to rest, and
    set off, are left out too. NaN for people who hardly walk: for less than 2 s, for less than 1 m,
    or at less than 0.3 m/s."""


@lru_cache(maxsize=4)  # a scene's recording is used by models, policies and metrics
def plans_of(crowd: Trajectories) -> RecordedPlans:
    """The plans of the people in a recording."""
    size, stops = len(crowd), stops_of(crowd)
    order = np.lexsort((stops.first, -stops.duration_s, stops.person))
    person, at = np.unique(stops.person[order], return_index=True)
    longest = order[at]
    via, wait_s = np.full((size, 2), np.nan), np.zeros(size)
    via[person] = stops.place[longest]
    resumed = crowd.offsets[:-1].astype(np.int64)
    resumed[person] = stops.last[longest]
    xy = crowd.xy.astype(np.float64)
    for p in person.tolist():
        first, stop = crowd.offsets[p], crowd.offsets[p + 1]
        came = first + _visited(xy[first:stop], via[p])
        wait_s[p] = max(0, resumed[p] - came) * crowd.dt_s
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
    walks = (time_s >= SHORTEST_S) & (way >= np.maximum(SHORTEST_M, SLOWEST_MPS * time_s))
    speed = np.divide(way, time_s, out=np.full(size, np.nan), where=walks)
    return RecordedPlans(via, wait_s, resumed, speed)


def _visited(path: Points, via: Float[np.ndarray, " 2"]) -> int:
    """Index of the position at which the via point of a path is visited; see `Simulation`."""
    if np.hypot(*(path[0] - via)) <= VISIT_M:
        return 0
    distance = _distance(np.broadcast_to(via, (len(path) - 1, 2)), path[:-1], path[1:])
    beyond = (path[1:] - via) @ (via - path[0]) > 0
    visits = np.flatnonzero((distance <= VISIT_M) | ((distance <= PASSED_M) & beyond))
    return int(visits[0]) + 1 if len(visits) else len(path) - 1


def places_of(crowd: Trajectories, scene: Scene) -> tuple[Points, Points, Points]:
    """Starts, goals and via points, moved to the nearest places where people can walk."""
    via = plans_of(crowd).via.copy()
    stops = ~np.isnan(via[:, 0])
    via[stops] = scene.nearest_walkable(via[stops])
    start, goal = (scene.nearest_walkable(p.astype(np.float64)) for p in (crowd.start, crowd.goal))
    return start, goal, via


def cut_at_goals(crowd: Trajectories, scene: Scene) -> Trajectories:
    """The crowd, with each trip cut off where a simulated trip would have ended.

    That is the first step that comes within the goal radius of its goal (moved to the nearest
    walkable place) when the person's longest stop is over. Columns of persons remain as they are.
    """
    goal = scene.nearest_walkable(crowd.goal.astype(np.float64))
    xy, person = crowd.xy.astype(np.float64), crowd.row_person()
    earliest = np.maximum(plans_of(crowd).resumed, crowd.offsets[:-1] + 1)
    near = np.zeros(len(xy), dtype=bool)  # whether the step that leads to a row comes near the goal
    near[1:] = _distance(goal[person[1:]], xy[:-1], xy[1:]) <= scene.motion.goal_radius_m
    near &= np.arange(len(xy)) >= earliest[person]
    last = crowd.offsets[1:] - 1
    arrived = np.flatnonzero(near)
    whose, at = np.unique(person[arrived], return_index=True)
    last[whose] = arrived[at]
    kept = np.arange(len(xy)) <= last[person]
    length: Int[np.ndarray, " P"] = last + 1 - crowd.offsets[:-1]
    return replace(crowd, xy=crowd.xy[kept], offsets=np.concatenate([[0], np.cumsum(length)]))


def _distance(point: Points, a: Points, b: Points) -> Numbers:
    way, off = b - a, point - a
    squared = (way * way).sum(axis=1)
    along = np.divide((off * way).sum(axis=1), squared, out=np.zeros(len(a)), where=squared > 0)
    off -= np.clip(along, 0, 1)[:, None] * way
    return np.asarray(np.sqrt((off * off).sum(axis=1)))


def turning_points(start: Points, via: Points, goal: Points, stops: Flags) -> Points:
    """Where straight walkers turn to their goals.

    That is at the via point for those who stop there. Others turn when it is within `VISIT_M`.
    Without a via point it is half way.
    """
    way = via - start
    length = np.hypot(*way.T)
    near = np.where(stops, 0.0, np.minimum(VISIT_M / np.maximum(length, 1e-9), 1.0))
    return np.asarray(
        np.where(np.isnan(length)[:, None], (start + goal) / 2, via - near[:, None] * way)
    )
