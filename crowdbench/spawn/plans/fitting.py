"""Fitting of companions and ways to a recording; see `crowdbench.spawn.plans.planned`."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from crowdbench.data.blocks import TimeBlocks
from crowdbench.data.companions import groups_of
from crowdbench.data.stops import HALF_S
from crowdbench.data.table import Trajectories
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.plans.links import FEWEST, candidates, fit_links
from crowdbench.spawn.plans.planned import PlannedAreas, directions, turned
from crowdbench.spawn.plans.way_fitting import fit_ways, trips_of
from crowdbench.spawn.plans.ways import Trips
from crowdbench.spawn.recorded_plans import SLOWEST_MPS, plans_of

_FEWEST_ROWS = 4
"""Least number of times at which two people walk together that tell how they do so."""


def fit_plans(crowd: Trajectories, blocks: TimeBlocks, areas: Areas) -> PlannedAreas:
    """Fit companions and ways to the people who enter in the time blocks.

    `crowd` is a recording as `fit_areas` returns it.

    Raises:
        SceneError: no trip is complete.
    """
    marks, plans = marks_of(crowd, blocks), plans_of(crowd)
    pairs = pairs_of(crowd, marks)
    first, in_group = marks.first(crowd), marks.in_group(crowd)
    log_speed = np.log(plans.speed)
    walks = first & np.isfinite(log_speed)
    slower = 0.0
    if min((walks & in_group).sum(), (walks & ~in_group).sum()) >= FEWEST:
        slower = float(log_speed[walks & in_group].mean() - log_speed[walks & ~in_group].mean())
    links = replace(
        fit_links(marks.time_s, marks.area, marks.group, len(areas.spawn)),
        same_side=pairs.same_side(),
        group_log_speed=slower,
    ).with_offsets(pairs.offsets, pairs.walked_m)
    return PlannedAreas.of(areas, links, fit_ways(trips_alone(crowd, marks, slower), areas))


@dataclass(frozen=True, eq=False)
class Marks:
    """Who enters when, where, and with whom, in order of time."""

    persons: Int[np.ndarray, " E"]
    time_s: Float[np.ndarray, " E"]
    area: Int[np.ndarray, " E"]
    group: Int[np.ndarray, " E"]
    """−1 for people who are alone."""
    earlier: Int[np.ndarray, " E"]
    """Index of the last one of the same group who entered the same area before, or −1."""

    def first(self, crowd: Trajectories) -> Bool[np.ndarray, " P"]:
        """Which of the crowd's people join nobody."""
        found = np.zeros(len(crowd), dtype=bool)
        found[self.persons[self.earlier < 0]] = True
        return found

    def in_group(self, crowd: Trajectories) -> Bool[np.ndarray, " P"]:
        """Which of the crowd's people have companions."""
        found = np.zeros(len(crowd), dtype=bool)
        found[self.persons[self.group >= 0]] = True
        return found


@dataclass(frozen=True, eq=False)
class Pairs:
    """Companions, and those who came before them in their groups."""

    later: Int[np.ndarray, " n"]
    earlier: Int[np.ndarray, " n"]
    offsets: Float[np.ndarray, "n 5"]
    """See `links.OFFSETS`."""
    walked_m: Float[np.ndarray, " n"]
    """How far the earlier one had walked when the later one entered, metres."""

    def same_side(self) -> float:
        """Share of those who are on the same side as the one before; half without anybody."""
        side = dict(zip(self.later.tolist(), self.offsets[:, 1].tolist(), strict=True))
        known = [k for k, j in enumerate(self.earlier.tolist()) if j in side]
        same = [self.offsets[k, 1] * side[int(self.earlier[k])] > 0 for k in known]
        return float((sum(same) + 1) / (len(same) + 2))


def pairs_of(crowd: Trajectories, marks: Marks) -> Pairs:
    """The companions among these people who were seen to walk and to leave."""
    speed, persons = plans_of(crowd).speed, marks.persons
    later = np.flatnonzero(marks.earlier >= 0)
    known = np.isfinite(speed[persons]) & crowd.left[persons]
    later = later[known[later] & known[marks.earlier[later]]]
    i, j = persons[later], persons[marks.earlier[later]]
    walked_m = speed[j] * (crowd.spawn_s[i] - crowd.spawn_s[j])
    return Pairs(i, j, offsets_of(crowd, i, j), walked_m)


def marks_of(crowd: Trajectories, blocks: TimeBlocks) -> Marks:
    """The companions of the people who enter in the time blocks, in areas of their own."""
    persons, _, _ = blocks.of_arrivals(crowd)
    persons = persons[crowd.spawn_area[persons] >= 0]
    persons = persons[np.argsort(crowd.spawn_s[persons], kind="stable")]
    time_s = crowd.spawn_s[persons]
    area = crowd.spawn_area[persons].astype(np.int64)
    group = groups_of(crowd)[persons].astype(np.int64)
    return Marks(persons, time_s, area, group, companion_before(time_s, area, group))


def trips_alone(crowd: Trajectories, marks: Marks, group_log_speed: float) -> Trips:
    """Complete trips of those who join nobody, at the speeds that they would have alone.

    Ways are those of people who are alone; companions get them from the first of their group.
    """
    plans, in_group = plans_of(crowd), marks.in_group(crowd)
    alone = np.where(in_group, plans.speed * np.exp(-group_log_speed), plans.speed)
    return trips_of(crowd, replace(plans, speed=alone), marks.first(crowd))


def companion_before(
    time_s: Float[np.ndarray, " E"], area: Int[np.ndarray, " E"], group: Int[np.ndarray, " E"]
) -> Int[np.ndarray, " E"]:
    """The last person of the same group who entered the same area before each person; else −1."""
    pairs = candidates(time_s, area)
    same = (group[pairs.later] >= 0) & (group[pairs.later] == group[pairs.earlier])
    found = np.full(len(time_s), -1)
    found[pairs.later[same]] = pairs.earlier[same]  # sorted: the last one stays
    return found


def offsets_of(
    crowd: Trajectories,
    later: Int[np.ndarray, " n"],
    earlier: Int[np.ndarray, " n"],
) -> Float[np.ndarray, "n 5"]:
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
