"""Fitting of companions and ways to a recording; see `crowdbench.spawn.planned`."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from crowdbench.spawn.areas import Areas
from crowdbench.spawn.links import FEWEST, candidates, fit_links
from crowdbench.spawn.planned import PlannedAreas, directions, turned
from crowdbench.spawn.plans import plans_of
from crowdbench.spawn.ways import fit_ways
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.companions import groups_of
from crowdbench.trajectories.table import Trajectories

_COMMON_M = 2.0
"""Shortest common way from which a ratio of speeds is computed."""


def fit_plans(crowd: Trajectories, blocks: TimeBlocks, areas: Areas) -> PlannedAreas:
    """Fit companions and ways to the people who enter in the time blocks.

    `crowd` is a recording as `fit_areas` returns it.

    Raises:
        SceneError: no trip is complete.
    """
    persons, _, _ = blocks.of_arrivals(crowd)
    persons = persons[crowd.spawn_area[persons] >= 0]
    persons = persons[np.argsort(crowd.spawn_s[persons], kind="stable")]
    time_s = crowd.spawn_s[persons]
    area = crowd.spawn_area[persons].astype(np.int64)
    group, plans = groups_of(crowd)[persons].astype(np.int64), plans_of(crowd)
    earlier = _companion(time_s, area, group)
    later = np.flatnonzero(earlier >= 0)
    known = np.isfinite(plans.speed[persons]) & crowd.left[persons]
    later = later[known[later] & known[earlier[later]]]
    pairs = persons[later], persons[earlier[later]]
    offsets = _offsets(crowd, plans.speed, *pairs)
    walked_m = plans.speed[pairs[1]] * (crowd.spawn_s[pairs[0]] - crowd.spawn_s[pairs[1]])
    first = np.zeros(len(crowd), dtype=bool)
    first[persons[earlier < 0]] = True
    in_group = np.zeros(len(crowd), dtype=bool)
    in_group[persons[group >= 0]] = True
    log_speed = np.log(plans.speed)
    walks = first & np.isfinite(log_speed)
    slower = 0.0
    if min((walks & in_group).sum(), (walks & ~in_group).sum()) >= FEWEST:
        slower = float(log_speed[walks & in_group].mean() - log_speed[walks & ~in_group].mean())
    links = replace(
        fit_links(time_s, area, group, offsets, walked_m, len(areas.spawn)),
        group_log_speed=slower,
    )
    # Ways are those of people who are alone; companions get them from the first of their group.
    as_alone = replace(plans, speed=np.where(in_group, plans.speed * np.exp(-slower), plans.speed))
    return PlannedAreas.of(areas, links, fit_ways(crowd, as_alone, areas, first))


def _companion(
    time_s: Float[np.ndarray, " E"], area: Int[np.ndarray, " E"], group: Int[np.ndarray, " E"]
) -> Int[np.ndarray, " E"]:
    """The last person of the same group who entered the same area before each person; else −1."""
    pairs = candidates(time_s, area)
    same = (group[pairs.later] >= 0) & (group[pairs.later] == group[pairs.earlier])
    found = np.full(len(time_s), -1)
    found[pairs.later[same]] = pairs.earlier[same]  # sorted: the last one stays
    return found


def _offsets(
    crowd: Trajectories,
    speed: Float[np.ndarray, " P"],
    later: Int[np.ndarray, " n"],
    earlier: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "n 5"]:
    """Offsets of people to those whom they join; see `links.OFFSETS`."""
    start, goal = crowd.start.astype(np.float64), crowd.goal.astype(np.float64)
    ahead = directions(goal[earlier] - start[earlier])
    back = ahead * [1.0, -1.0]
    return np.column_stack(
        [
            turned(back, start[later] - start[earlier]),
            turned(back, goal[later] - goal[earlier]),
            _log_ratios(crowd, speed, later, earlier),
        ]
    )


def _log_ratios(
    crowd: Trajectories,
    speed: Float[np.ndarray, " P"],
    later: Int[np.ndarray, " n"],
    earlier: Int[np.ndarray, " n"],
) -> Float[np.ndarray, " n"]:
    """Log ratio of the distances that two people cover while both are there.

    Speeds of whole lives would differ more: one of two companions may have stopped alone, before
    the other one entered. They are used where the common distance is too short.
    """
    found = np.log(speed[later] / speed[earlier])
    for k, (i, j) in enumerate(zip(later.tolist(), earlier.tolist(), strict=True)):
        begin = max(crowd.first[i], crowd.first[j])
        end = min(crowd.last[i], crowd.last[j])
        if end <= begin:
            continue
        ways = [
            float(np.hypot(*(path[end - since] - path[begin - since])))
            for path, since in (
                (crowd.path(i), crowd.first[i]),
                (crowd.path(j), crowd.first[j]),
            )
        ]
        if min(ways) >= _COMMON_M:
            found[k] = np.log(ways[0] / ways[1])
    return found
