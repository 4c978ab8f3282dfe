"""Plans on top of any arrival process: companions, and ways with stops and via points.

`PlannedAreas` are areas whose people do not come alone: spawn models that draw places from them
become models of plans. The fits are in `plans.json`, one for each split; as with areas, all models
of a scene share them.
"""

from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from numpy.random import Generator

from crowdbench.data.companions import ENTRY_S, LEAST_S, RELATIVE_MPS, SHARE, WITHIN_M
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import SpawnEvents, entering
from crowdbench.spawn.plans.links import STAGES, Links
from crowdbench.spawn.plans.ways import Ways
from crowdbench.spawn.recorded_plans import SLOWEST_MPS, turning_points

_ALWAYS = 50.0
"""Logarithm of a weight that decides alone."""
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

    def changed(
        self,
        area: int,
        time_s: Float[np.ndarray, " E"],
        *,
        group_size: float | None = None,
        stop: float | None = None,
        wait_s: float | None = None,
    ) -> "PlannedAreas":
        """The same areas, with other groups and stops of one of them.

        `group_size` is the mean size of groups, of which one for people who enter at these times
        (ascending, seconds); the nearest possible one is taken. `stop` is P(a person stops),
        `wait_s` the mean wait of those who do.
        """
        links, ways = self.links, self.ways
        if group_size is not None:
            links = links.with_group_size(area, time_s, group_size)
        stopping, longer = ways.stopping.copy(), ways.longer.copy()
        if stop is not None:
            stopping[area] = stop
        if wait_s is not None:
            longer[area] = np.log(wait_s / ways.mean_wait_s(area, self.flow[area]))
        return replace(self, links=links, ways=replace(ways, stopping=stopping, longer=longer))

    def instead(self, spawn: Gaussians, flow: Float[np.ndarray, "k G"]) -> "PlannedAreas":
        """Other spawn areas with the same goals, whose people do not stop.

        Whoever enters at the same time in the same area belongs to one group.
        """
        plain = Areas(self.scene, spawn, self.goal, flow, self.speed_quantiles, self.left_out)
        together = np.where(np.arange(len(self.links.log_weight)) == 0, _ALWAYS, -_ALWAYS)
        links = replace(
            self.links,
            log_weight=together,
            tendency=np.zeros(len(spawn)),
            larger=np.zeros(STAGES - 1),
            crowded=0.0,
        )
        return PlannedAreas.of(plain, links, self.ways.instead(plain))

    def draw(
        self,
        time_s: Float[np.ndarray, " E"],
        spawn_area: Int[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> SpawnEvents:
        """Draw a plan for each arrival; companions have plans that differ by an offset.

        Ways are drawn again where straight walkers would not have the companions that are planned,
        by the rule of `crowdbench.data.companions`.
        """
        from crowdbench.spawn.plans.link_kernels import not_as_planned

        order = np.argsort(time_s, kind="stable")
        time_s, area = time_s[order], spawn_area[order]
        joins = self.links.draw(time_s, area, rng)
        leader = _leaders(joins)
        first = joins < 0
        goal_area = np.zeros(len(time_s), dtype=np.int64)
        cumulative = self.flow.cumsum(axis=1)[area[first]]
        u = rng.random((len(cumulative), 1)) * cumulative[:, -1:]
        goal_area[first] = (u >= cumulative).sum(axis=1)
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
        stops = np.isfinite(ways[:, 7])
        return entering(
            time_s=time_s,
            start=ways[:, :2],
            goal=ways[:, 2:4],
            spawn_area=area,
            goal_area=goal_area,
            speed=np.exp(ways[:, 4]),
            group=np.where(together, number[leader], -1),
            via=ways[:, 5:7],
            wait_s=np.where(stops, np.exp(np.where(stops, ways[:, 7], 0.0)), 0.0),
        )

    def _ways(
        self,
        time_s: Float[np.ndarray, " E"],
        area: Int[np.ndarray, " E"],
        goal_area: Int[np.ndarray, " E"],
        leader: Int[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> Float[np.ndarray, "E 8"]:
        """Ways of whole groups with these leaders, as `Ways.draw` has them."""
        first = leader == np.arange(len(leader))
        ways = np.full((len(time_s), 8), np.nan)
        ways[first] = self.ways.draw(area[first], goal_area[first], scene, rng)
        slower = first & (np.bincount(leader, minlength=len(leader)) > 1)
        ways[slower, 4] = self._possible_speed(ways[slower, 4] + self.links.group_log_speed)
        self._place_companions(ways, time_s, leader, scene, rng)
        return ways

    def _place_companions(
        self,
        ways: Float[np.ndarray, "E 8"],
        time_s: Float[np.ndarray, " E"],
        leader: Int[np.ndarray, " E"],
        scene: Scene,
        rng: Generator,
    ) -> None:
        """Fill in the ways of those who join a group, the second of each group first.

        They walk beside the one who came before them.
        """
        from crowdbench.spawn.plans.link_kernels import keep_company

        rank = _ranks(leader)
        groups, of_group = np.unique(leader, return_inverse=True)
        members = np.full((len(groups), int(rank.max(initial=0)) + 1), -1)
        members[of_group, rank] = np.arange(len(leader))
        side = np.zeros(len(leader))
        for place in range(1, members.shape[1]):
            open_ = members[:, place]
            open_ = open_[open_ >= 0]
            for _ in range(_TRIES):
                earlier = members[of_group[open_], :place]
                other = earlier[:, -1]
                walked = np.exp(ways[other, 4]) * (time_s[open_] - time_s[other])
                drawn, sides, free = self._beside(ways[other], walked, side[other], scene, rng)
                good = free & keep_company(
                    drawn, time_s[open_], ways, time_s, earlier,
                    scene.motion.person_radius_m, WITHIN_M,
                )  # fmt: skip
                ways[open_[free]], side[open_[free]] = drawn[free], sides[free]
                open_ = open_[~good]
                if len(open_) == 0:
                    break
            nowhere = open_[np.isnan(ways[open_, 0])]
            ways[nowhere] = ways[members[of_group[nowhere], place - 1]]

    def _beside(
        self,
        ways: Float[np.ndarray, "n 8"],
        walked_m: Float[np.ndarray, " n"],
        side_before: Float[np.ndarray, " n"],
        scene: Scene,
        rng: Generator,
    ) -> tuple[Float[np.ndarray, "n 8"], Float[np.ndarray, " n"], Bool[np.ndarray, " n"]]:
        """Ways of people who join those with these ways, who have walked this far.

        Also their sides, and whether there is room at their starts and goals.
        """
        offset, side = self.links.offsets(walked_m, side_before, rng)
        ahead = directions(ways[:, 2:4] - ways[:, :2])
        at_start, at_goal = turned(ahead, offset[:, :2]), turned(ahead, offset[:, 2:4])
        found = ways.copy()
        found[:, :2] += at_start
        found[:, 2:4] += at_goal
        via = found[:, 5:7] + (at_start + at_goal) / 2
        with_via = np.flatnonzero(np.isfinite(via[:, 0]))
        # One call, which takes hardly longer than each of three.
        points = np.concatenate([found[:, :2], found[:, 2:4], via[with_via]])
        at_starts, at_goals, at_via = np.split(scene.has_room(points), [len(found), 2 * len(found)])
        moved = with_via[at_via]
        found[moved, 5:7] = via[moved]
        left_m = np.maximum(_length_m(ways) - walked_m, _SHORTEST_M)
        gain = np.log(np.maximum(1 + offset[:, 4] / left_m, 0.5))
        found[:, 4] = self._possible_speed(found[:, 4] + gain)
        return found, side, at_starts & at_goals

    def _possible_speed(self, log_speed: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
        return np.clip(log_speed, *np.log([SLOWEST_MPS, self.ways.fastest_mps]))


def _straight_walks(ways: Float[np.ndarray, "n 8"]) -> Float[np.ndarray, "n 8"]:
    """Start, turning point, goal, speed and wait (seconds at the turning point) of each way."""
    start, goal, stops = ways[:, :2], ways[:, 2:4], np.isfinite(ways[:, 7])
    turn = turning_points(start, ways[:, 5:7], goal, stops)
    wait_s = np.where(stops, np.exp(np.where(stops, ways[:, 7], 0.0)), 0.0)
    return np.column_stack([start, turn, goal, np.exp(ways[:, 4]), wait_s])


def _leaders(joins: Int[np.ndarray, " E"]) -> Int[np.ndarray, " E"]:
    """The first person of each person's group; `joins` are earlier persons, or −1."""
    leader = np.where(joins < 0, np.arange(len(joins)), joins)
    while (leader[leader] != leader).any():
        leader = leader[leader]
    return leader


def _ranks(leader: Int[np.ndarray, " E"]) -> Int[np.ndarray, " E"]:
    """Place of each person in its group: 0 for the first one, who leads it."""
    order = np.argsort(leader, kind="stable")
    size = np.bincount(leader, minlength=len(leader))
    before = np.cumsum(size) - size
    rank = np.empty(len(leader), dtype=np.int64)
    rank[order] = np.arange(len(leader)) - before[leader[order]]
    return rank


def _length_m(ways: Float[np.ndarray, "n 8"]) -> Float[np.ndarray, " n"]:
    """Length of the ways, by their via points if they have one, metres."""
    start, goal, via = ways[:, :2], ways[:, 2:4], ways[:, 5:7]
    by_via = np.linalg.norm(via - start, axis=1) + np.linalg.norm(goal - via, axis=1)
    return np.where(np.isfinite(by_via), by_via, np.linalg.norm(goal - start, axis=1))


def directions(way: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """The vectors, with length 1."""
    length = np.maximum(np.hypot(*way.T), 1e-9)
    return np.asarray(way / length[:, None])


def turned(
    direction: Float[np.ndarray, "n 2"], vector: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n 2"]:
    """The vectors, turned by the angle of the directions."""
    (cos, sin), (x, y) = direction.T, vector.T
    return np.column_stack([cos * x - sin * y, sin * x + cos * y])
