"""Plans on top of any arrival process: companions, and ways with stops and via points.

`PlannedAreas` are areas whose people do not come alone: spawn models that draw places from them
become models of plans. The fits are in `plans.json`, one for each split; as with areas, all models
of a scene share them.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.data.companions import ENTRY_S, LEAST_S, RELATIVE_MPS, SHARE, WITHIN_M
from crowdbench.data.table import Flags, Indices, Numbers, Points
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.plans.links import STAGES, Links
from crowdbench.spawn.plans.ways import (
    GOAL,
    LOG_WAIT,
    SPEED,
    START,
    VIA,
    DrawnWays,
    Ways,
    have_room,
)
from crowdbench.spawn.recorded_plans import turning_points

_ALWAYS = 50.0  # logarithm of a weight that decides alone
_TRIES = 30
"""Number of ways that are drawn for a companion until one stays near, and runs into nobody; and for
a group until people have the companions that are planned."""
_MANY, _HARDLY_FEWER = 50, 0.95
"""Where so many groups are not as planned, and more than this share of them remains so when they
are drawn again, too many people enter at once: they stay as they are."""
_SHORTEST_M = 2.0
"""Shortest common way over which a companion gains on the other one, or falls back."""


@dataclass(frozen=True, eq=False)
class PlannedAreas(Areas):
    """Areas whose people have companions, and ways of their own."""

    links: Links
    ways: Ways

    @classmethod
    def of(cls, areas: Areas, links: Links, ways: Ways) -> "PlannedAreas":
        """The areas with these models of companions and ways."""
        known = {field.name: getattr(areas, field.name) for field in fields(Areas)}
        return cls(**known, links=links, ways=ways)

    def instead(self, spawn: Gaussians, flow: Float[np.ndarray, "k G"]) -> "PlannedAreas":
        """Other spawn areas with the same goals, whose people do not stop.

        Whoever enters at the same time in the same area belongs to one group.
        """
        together = np.where(np.arange(len(self.links.log_weight)) == 0, _ALWAYS, -_ALWAYS)
        links = replace(
            self.links,
            log_weight=together,
            tendency=np.zeros(len(spawn)),
            larger=np.zeros(STAGES - 1),
            crowded=0.0,
        )
        areas = replace(self, spawn=spawn, flow=flow, links=links)
        return replace(areas, ways=self.ways.instead(areas))

    def draw(
        self, time_s: Numbers, spawn_area: Indices, scene: Scene, rng: Generator
    ) -> SpawnEvents:
        """Draw a plan for each arrival; companions have plans that differ by an offset.

        Ways are drawn again where straight walkers would not have the companions that are planned,
        by the rule of `crowdbench.data.companions`.
        """
        from crowdbench.spawn.plans.link_kernels import not_as_planned

        order = np.argsort(time_s, kind="stable")
        time_s, area = time_s[order], spawn_area[order]
        joins = self.links.draw(time_s, area, rng)
        leader, first = _leaders(joins), joins < 0
        goal_area = np.zeros(len(time_s), dtype=np.int64)
        goal_area[first] = self.draw_goal_areas(area[first], rng)
        goal_area = goal_area[leader]
        ways, walks = np.empty((len(time_s), 8)), np.empty((len(time_s), 8))
        again, before = np.ones(len(time_s), dtype=bool), np.inf
        for _ in range(_TRIES):
            chosen = np.flatnonzero(again)
            own = np.searchsorted(chosen, leader[chosen])
            ways[chosen] = self._ways(
                time_s[chosen], area[chosen], goal_area[chosen], own, scene, rng
            )
            walks[chosen] = _straight_walks(ways[chosen])
            wrong = not_as_planned(
                time_s, walks, leader, again, ENTRY_S, LEAST_S, SHARE, WITHIN_M, RELATIVE_MPS
            )
            if not wrong.any() or wrong.sum() > max(_HARDLY_FEWER * before, _MANY):
                break
            again, before = wrong[leader], wrong.sum()
        together = np.bincount(leader, minlength=len(joins))[leader] > 1
        number = np.cumsum(first & together) - 1
        return entering(
            time_s=time_s,
            start=ways[:, START],
            goal=ways[:, GOAL],
            spawn_area=area,
            goal_area=goal_area,
            speed=np.exp(ways[:, SPEED]),
            group=np.where(together, number[leader], -1),
            via=ways[:, VIA],
            wait_s=np.nan_to_num(np.exp(ways[:, LOG_WAIT])),
        )

    def _ways(
        self,
        time_s: Numbers,
        area: Indices,
        goal_area: Indices,
        leader: Indices,
        scene: Scene,
        rng: Generator,
    ) -> DrawnWays:
        """Ways of whole groups with these leaders.

        Those who join a group walk beside the one who came before them; the second ones of all
        groups are drawn first.
        """
        from crowdbench.spawn.plans.link_kernels import keep_company

        leads, radius_m = leader == np.arange(len(leader)), scene.motion.person_radius_m
        ways = np.full((len(time_s), 8), np.nan)
        ways[leads] = self.ways.draw(area[leads], goal_area[leads], scene, rng)
        groups, of_group, size = np.unique(leader, return_inverse=True, return_counts=True)
        slower = leads & (size[of_group] > 1)
        ways[slower, SPEED] = self.ways.possible_speed(
            ways[slower, SPEED] + self.links.group_log_speed
        )
        members = np.full((len(groups), int(size.max(initial=1))), -1)
        members[of_group, _ranks(leader)] = np.arange(len(leader))
        side = np.zeros(len(leader))
        for place in range(1, members.shape[1]):
            open_ = members[members[:, place] >= 0, place]
            for _ in range(_TRIES):
                earlier = members[of_group[open_], :place]
                other = earlier[:, -1]
                walked = np.exp(ways[other, SPEED]) * (time_s[open_] - time_s[other])
                drawn, sides, free = self._beside(ways[other], walked, side[other], scene, rng)
                good = free & keep_company(
                    drawn, time_s[open_], ways, time_s, earlier, radius_m, WITHIN_M
                )
                ways[open_[free]], side[open_[free]] = drawn[free], sides[free]
                open_ = open_[~good]
                if len(open_) == 0:
                    break
            nowhere = open_[np.isnan(ways[open_, 0])]
            ways[nowhere] = ways[members[of_group[nowhere], place - 1]]
        return ways

    def _beside(
        self, ways: DrawnWays, walked_m: Numbers, side_before: Numbers, scene: Scene, rng: Generator
    ) -> tuple[DrawnWays, Numbers, Flags]:
        """Ways of people who join those with these ways, who have walked this far.

        Also their sides, and whether there is room at their starts and goals.
        """
        offset, side = self.links.offsets(walked_m, side_before, rng)
        start, via, goal = ways[:, START], ways[:, VIA], ways[:, GOAL]
        ahead = directions(goal - start)
        at_start, at_goal = turned(ahead, offset[:, START]), turned(ahead, offset[:, GOAL])
        found = ways.copy()
        found[:, START] += at_start
        found[:, GOAL] += at_goal
        found[:, VIA] += (at_start + at_goal) / 2
        at_ends, at_via = have_room(found, scene)
        found[~at_via, VIA] = via[~at_via]
        length_m = np.linalg.norm(via - start, axis=1) + np.linalg.norm(goal - via, axis=1)
        length_m = np.where(np.isfinite(length_m), length_m, np.linalg.norm(goal - start, axis=1))
        left_m = np.maximum(length_m - walked_m, _SHORTEST_M)
        gain = np.log(np.maximum(1 + offset[:, 4] / left_m, 0.5))
        found[:, SPEED] = self.ways.possible_speed(found[:, SPEED] + gain)
        return found, side, at_ends


def _straight_walks(ways: DrawnWays) -> Float[np.ndarray, "n 8"]:
    """Start, turning point, goal, speed and wait (seconds at the turning point) of each way."""
    start, goal = ways[:, START], ways[:, GOAL]
    turn = turning_points(start, ways[:, VIA], goal, np.isfinite(ways[:, LOG_WAIT]))
    wait_s = np.nan_to_num(np.exp(ways[:, LOG_WAIT]))
    return np.column_stack([start, turn, goal, np.exp(ways[:, SPEED]), wait_s])


def _leaders(joins: Indices) -> Indices:
    """The first person of each person's group; `joins` are earlier persons, or −1."""
    leader = np.where(joins < 0, np.arange(len(joins)), joins)
    while (leader[leader] != leader).any():
        leader = leader[leader]
    return leader


def _ranks(leader: Indices) -> Indices:
    """Place of each person in its group: 0 for the first one, who leads it."""
    order = np.argsort(leader, kind="stable")
    rank = np.empty(len(leader), dtype=np.int64)
    rank[order] = np.arange(len(leader)) - np.searchsorted(leader[order], leader[order])
    return rank


def directions(way: Points) -> Points:
    """The vectors, with length 1."""
    length = np.maximum(np.hypot(*way.T), 1e-9)
    return np.asarray(way / length[:, None])


def turned(direction: Points, vector: Points) -> Points:
    """The vectors, turned by the angle of the directions."""
    (cos, sin), (x, y) = direction.T, vector.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])
