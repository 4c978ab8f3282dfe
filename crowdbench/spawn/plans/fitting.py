"""Fitting of companions and ways to a recording; see `crowdbench.spawn.plans.planned`."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.companions import groups_of
from crowdbench.data.stops import HALF_S
from crowdbench.data.table import Indices, Trajectories
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.plans.links import FEWEST, Links, candidates, fit_links
from crowdbench.spawn.plans.planned import PlannedAreas, directions, turned
from crowdbench.spawn.plans.way_fitting import Trips, fit_ways, trips_of
from crowdbench.spawn.recorded_plans import SLOWEST_MPS, plans_of

_FEWEST_ROWS = 4  # least number of times at which two people walk together that tell how they do so


def fit_plans(crowd: Trajectories, blocks: TimeBlocks, areas: Areas) -> PlannedAreas:
    """Fit companions and ways to the people who enter in the time blocks.

    `crowd` is a recording as `fit_areas` returns it.

    Raises:
        SceneError: no trip is complete.
    """
    marks = marks_of(crowd, blocks)
    log_speed = np.log(plans_of(crowd).speed)
    walks = marks.first & np.isfinite(log_speed)
    together, alone = walks & marks.in_group, walks & ~marks.in_group
    slower = 0.0
    if min(together.sum(), alone.sum()) >= FEWEST:
        slower = float(log_speed[together].mean() - log_speed[alone].mean())
    links = fit_links(marks.time_s, marks.area, marks.group, len(areas.spawn))
    links = replace(_with_companions(links, crowd, marks), group_log_speed=slower)
    return PlannedAreas.of(areas, links, fit_ways(trips_alone(crowd, marks, slower), areas))


@dataclass(frozen=True, eq=False)
class Marks:
    """Who of `P` people enters when, where, and with whom, in order of time."""

    persons: Int[np.ndarray, " E"]
    time_s: Float[np.ndarray, " E"]
    area: Int[np.ndarray, " E"]
    group: Int[np.ndarray, " E"]
    """−1 for people who are alone."""
    earlier: Int[np.ndarray, " E"]
    """Index of the last one of the same group who entered the same area before, or −1."""
    first: Bool[np.ndarray, " P"]
    """Which of all people join nobody."""
    in_group: Bool[np.ndarray, " P"]
    """Which of all people have companions."""


def marks_of(crowd: Trajectories, blocks: TimeBlocks) -> Marks:
    """The companions of the people who enter in the time blocks, in areas of their own."""
    persons, _, _ = blocks.of_arrivals(crowd)
    persons = persons[crowd.spawn_area[persons] >= 0]
    persons = persons[np.argsort(crowd.spawn_s[persons], kind="stable")]
    time_s = crowd.spawn_s[persons]
    area = crowd.spawn_area[persons].astype(np.int64)
    group = groups_of(crowd)[persons].astype(np.int64)
    pairs = candidates(time_s, area)
    same, earlier = pairs.same(group), np.full(len(persons), -1)
    earlier[pairs.later[same]] = pairs.earlier[same]  # sorted: the last one stays
    first, in_group = np.zeros(len(crowd), dtype=bool), np.zeros(len(crowd), dtype=bool)
    first[persons], in_group[persons] = earlier < 0, group >= 0
    return Marks(persons, time_s, area, group, earlier, first, in_group)


def trips_alone(crowd: Trajectories, marks: Marks, group_log_speed: float) -> Trips:
    """Complete trips of those who join nobody, at the speeds that they would have alone.

    Ways are those of people who are alone; companions get them from the first of their group.
    """
    plans = plans_of(crowd)
    alone = np.where(marks.in_group, plans.speed * np.exp(-group_log_speed), plans.speed)
    return trips_of(crowd, replace(plans, speed=alone), marks.first)


def _with_companions(links: Links, crowd: Trajectories, marks: Marks) -> Links:
    """Links with the offsets and sides of the companions who were seen to walk and to leave."""
    speed, persons = plans_of(crowd).speed, marks.persons
    later = np.flatnonzero(marks.earlier >= 0)
    known = np.isfinite(speed[persons]) & crowd.left[persons]
    later = later[known[later] & known[marks.earlier[later]]]
    i, j = persons[later], persons[marks.earlier[later]]
    offsets = offsets_of(crowd, i, j)
    side = np.full(len(crowd), np.nan)
    side[i] = offsets[:, 1]
    before = side[j]  # NaN for the first of a group
    same = (offsets[:, 1] * before > 0).sum()
    share = float((same + 1) / (np.isfinite(before).sum() + 2))  # half without anybody
    walked_m = speed[j] * (crowd.spawn_s[i] - crowd.spawn_s[j])
    return replace(links.with_offsets(offsets, walked_m), same_side=share)


def offsets_of(crowd: Trajectories, later: Indices, earlier: Indices) -> Float[np.ndarray, "n 5"]:
    """Offsets of people to those whom they join; see `links.OFFSETS`."""
    start, goal = crowd.start.astype(np.float64), crowd.goal.astype(np.float64)
    ahead = directions(goal[earlier] - start[earlier])
    back = ahead * [1.0, -1.0]
    found = np.column_stack(
        [
            turned(back, start[later] - start[earlier]),
            turned(back, goal[later] - goal[earlier]),
            np.zeros(len(later)),
        ]
    )
    for k, (i, j) in enumerate(zip(later.tolist(), earlier.tolist(), strict=True)):
        gap = _gap(crowd, i, j)
        if gap is not None:
            # Straight walkers are as far abreast all the way as they are at its ends. Companions
            # come closer to each other at doors: what counts is how they walk in between.
            (_, found[k, 1]), (_, found[k, 3]) = gap
            found[k, 4] = gap[1, 0] - gap[0, 0]
    return found


def _gap(crowd: Trajectories, i: int, j: int) -> Float[np.ndarray, "2 2"] | None:
    """From j to i, along and across their common direction, when both begin and end to walk there.

    The ends of the straight line through the gaps at all times at which they walk; None if these
    are too few.
    """
    half = max(1, round(HALF_S / crowd.dt_s))
    begin, end = max(crowd.first[i], crowd.first[j]), min(crowd.last[i], crowd.last[j])
    if end - begin < 2 * half + _FEWEST_ROWS:
        return None
    one, other = (
        crowd.path(p)[begin - crowd.first[p] : end - crowd.first[p] + 1].astype(np.float64)
        for p in (i, j)
    )
    middle = (one + other) / 2
    moved = middle[2 * half :] - middle[: -2 * half]
    walks = np.hypot(*moved.T) >= SLOWEST_MPS * 2 * half * crowd.dt_s
    if walks.sum() < _FEWEST_ROWS:
        return None
    gap = turned(directions(moved[walks]) * [1.0, -1.0], (one - other)[half:-half][walks])
    side = 1.0 if gap[:, 1].mean() >= 0 else -1.0  # they are not nearer because they change sides
    gap[:, 1] = np.abs(gap[:, 1])
    margin = half / (len(gap) + 2 * half - 1)
    line = np.polynomial.polynomial.polyfit(np.linspace(margin, 1 - margin, len(gap)), gap, 1)
    return np.array([line[0], line[0] + line[1]]) * [1.0, side]
