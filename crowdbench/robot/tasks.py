"""Tasks about a person of the crowd: to follow them, or to stand aside and let them in.

- `follow`: the robot begins near somebody who still has far to go. It reaches its goal if it is
  within 2 m of them when they leave, or when the time is up. Habitat 3.0 (Puig et al. 2024,
  arXiv:2310.13724, section 4.1) calls it social navigation, and asks for 1 to 2 m, too.
- `stand-aside`: the robot begins in the entrance of the next person. It reaches its goal if it
  waits at a place beside their way when they have come past. Nobody enters where a robot stands,
  unless they lose patience.
"""

from typing import TYPE_CHECKING

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from crowdbench.robot.measures import PERSONAL_M
from crowdbench.simulation.state import DROPPED, PENDING

if TYPE_CHECKING:
    from crowdbench.robot.worlds import RobotWorlds

FOLLOW_M = 2.0
"""A robot follows somebody if the distance of their surfaces is at most this."""
BEHIND_M = 0.8
"""Distance of the surfaces that a follower drives up to."""
PAST_M = 3.0
"""Somebody has come past when they are this far from where they entered."""
EARLIEST_S = 2.0
"""The robot begins in an entrance at least this long before somebody enters, if possible."""
_IN_ENTRANCE_M = 1.5  # from where the person enters
_BESIDE_M = 1.0  # least distance of a waiting place from the start
_ENTRANCES = 8  # that are tried

MEASURES = {"following_share": "share of time within 2 m of the person to follow, 0 to 1"}
"""The measures of the task `follow`, in `info` at the end of an episode, and what they mean."""


class PersonTask:
    """The persons whom the present episodes of W worlds are about, known by their spawn events."""

    def __init__(self, worlds: "RobotWorlds") -> None:
        """A task of worlds in which no episode has begun."""
        self._worlds, count = worlds, worlds.worlds
        self._follows = worlds.config.task == "follow"
        self.event = np.full(count, -1)
        """(W,) index of the person's spawn event, −1 for nobody."""
        self.position = np.zeros((count, 2))
        """(W, 2) where the person is, was last, or will enter, metres."""
        self.over = np.zeros(count, bool)
        """(W,) whether the person is gone or has come past, or the time to follow is up."""
        self.reached = np.zeros(count, bool)
        """(W,) whether it is over and the robot is where it should be."""
        self._entrance = np.zeros((count, 2))
        self._entered = np.zeros(count, bool)
        self._near = np.zeros(count)
        self._steps = np.zeros(count)

    def begin(
        self, world: int, clearance_m: float
    ) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, "1 2"]]:
        """Choose the person of a world, and return the start and the goal of its robot.

        If nobody is there or will come, the robot begins in the middle, and its time will be up.
        """
        worlds = self._worlds
        people = worlds.present.position[world][worlds.present.there[world]]
        choose = self._choose_leader if self._follows else self._choose_entrance
        self.event[world] = -1
        start, goal = choose(world, people, clearance_m)
        self._entrance[world] = self.position[world]
        self._entered[world] = self._there(np.array([world]))[0]
        self._near[world] = self._steps[world] = 0
        return start, goal[None]

    def update(self) -> None:
        """Follow what people did in a control period; the goal of followers moves with them."""
        worlds = self._worlds
        everywhere = np.arange(worlds.worlds)
        there = self._there(everywhere)
        self._entered |= there
        known = self.event >= 0
        status = worlds.crowds.simulation.queue.status[everywhere, self.event]
        over = known & ~there & (self._entered | (status == DROPPED))
        robot = worlds.view.position
        self._steps += 1
        if self._follows:
            gap = _distance(robot, self.position) - worlds.crowds.reach_m
            near = known & self._entered & (gap <= FOLLOW_M)
            self._near += near
            over |= worlds.measures.steps + 1 >= worlds.limit
            self.over, self.reached = over, over & near
            np.copyto(worlds.view.goal, self.position, where=known[:, None])
            return
        over |= known & there & (_distance(self.position, self._entrance) >= PAST_M)
        waits = _distance(robot, worlds.view.goal) <= worlds.config.goal_radius_m
        self.over, self.reached = over, over & waits & self._entered

    def aim(self, worlds: Int[np.ndarray, " n"]) -> None:
        """Let paths end where robots should stop: behind the person, or at the waiting place."""
        view = self._worlds.view
        way = view.towards[worlds] - view.position[worlds]
        direct = np.sqrt((way * way).sum(axis=1))
        off = self._worlds.config.goal_radius_m / 2
        if self._follows:
            off = self._worlds.crowds.reach_m + BEHIND_M
        left = np.maximum(view.remaining[worlds] - off, 0.0)
        # Only the last point of a path moves; those before it are corners of walls.
        share = np.minimum(1.0, left / np.maximum(direct, 1e-9))[:, None]
        view.towards[worlds] = view.position[worlds] + share * way
        view.remaining[worlds] = left

    def measures(self, worlds: Int[np.ndarray, " n"]) -> dict[str, np.ndarray]:
        """The measures of the task, each (n,); see `MEASURES`."""
        share = self._near[worlds] / np.maximum(self._steps[worlds], 1)
        return {"following_share": share} if self._follows else {}

    def _there(self, worlds: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
        """Whether the persons of some worlds are there; their positions are written."""
        present = self._worlds.present
        events = self._worlds.crowds.simulation.slots.event[worlds, :-1]
        is_it = present.there[worlds] & (events == self.event[worlds, None])
        row, slot = np.nonzero(is_it & (self.event[worlds, None] >= 0))
        self.position[worlds[row]] = present.position[worlds[row], slot]
        return np.asarray(is_it.any(axis=1) & (self.event[worlds] >= 0))

    def _choose_leader(
        self, world: int, people: Float[np.ndarray, "P 2"], clearance_m: float
    ) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
        """Choose who has farthest to go, or enters next; a start near them, and where they are."""
        worlds = self._worlds
        slots = worlds.crowds.simulation.slots
        there = np.flatnonzero(worlds.present.there[world])
        if len(there):
            k = int(np.argmax(_distance(slots.goal[world, there], people)))
            self.event[world], self.position[world] = slots.event[world, there[k]], people[k]
        elif len(coming := self._coming(world, 0.0)):
            self.event[world] = coming[0]
            self.position[world] = worlds.crowds.simulation.queue.start[world, coming[0]]
        else:
            self.position[world] = self._middle()
        leader = self.position[world].copy()
        if worlds.config.start is not None:
            return np.array(worlds.config.start, np.float64), leader
        places = worlds.places.around(leader)
        free = self._free(places, np.vstack([people, leader]), clearance_m)
        return places[free[0]] if len(free) else self._middle(), leader

    def _choose_entrance(
        self, world: int, people: Float[np.ndarray, "P 2"], clearance_m: float
    ) -> tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]:
        """Choose who comes next; a start in their entrance, and a place beside their way."""
        worlds = self._worlds
        coming = self._coming(world, EARLIEST_S)
        if not len(coming):
            coming = self._coming(world, 0.0)
        queue = worlds.crowds.simulation.queue
        for event in coming[:_ENTRANCES].tolist():
            entrance = queue.start[world, event].astype(np.float64)
            places = worlds.places.around(entrance)
            free = self._free(places, people, clearance_m)
            if not len(free) or np.linalg.norm(places[free[0]] - entrance) > _IN_ENTRANCE_M:
                continue
            start = places[free[0]]
            beside = places[np.linalg.norm(places - start, axis=1) >= _BESIDE_M]
            if len(beside):
                self.event[world], self.position[world] = event, entrance
                return start, self._off_way(world, event, beside)
        return self._middle(), self._middle()

    def _middle(self) -> Float[np.ndarray, " 2"]:
        """A free place near the middle of the scene."""
        b = self._worlds.scene.bounds
        middle = np.array([b.x_min_m + b.x_max_m, b.y_min_m + b.y_max_m]) / 2
        around = self._worlds.places.around(middle)
        return around[0] if len(around) else middle

    def _coming(self, world: int, after_s: float) -> Int[np.ndarray, " n"]:
        """Spawn events of the world that are still to come, the next first."""
        simulation = self._worlds.crowds.simulation
        queue, frame = simulation.queue, int(simulation.clock.frame[world])
        first = frame + after_s / self._worlds.scene.dt_s
        due = queue.due[world]
        last = frame + self._worlds.crowds.episode_frames
        found = np.flatnonzero((queue.status[world] == PENDING) & (due > first) & (due <= last))
        return found[np.argsort(due[found], kind="stable")]

    def _off_way(
        self, world: int, event: int, places: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, " 2"]:
        """The first of the places off the way of somebody; the farthest off if none is."""
        worlds = self._worlds
        queue = worlds.crowds.simulation.queue
        stops = [queue.start[world, event], queue.via[world, event], queue.goal[world, event]]
        way = shapely.LineString([stop for stop in stops if not np.isnan(stop).any()])
        off = shapely.distance(way, shapely.points(places))
        enough = off >= worlds.crowds.reach_m + PERSONAL_M
        return np.asarray(places[np.argmax(enough) if enough.any() else np.argmax(off)])

    @staticmethod
    def _free(
        places: Float[np.ndarray, "n 2"], people: Float[np.ndarray, "P 2"], clearance_m: float
    ) -> Int[np.ndarray, " free"]:
        """Indices of the places to which nobody is nearer than `clearance_m`."""
        off = np.linalg.norm(places[:, None] - people, axis=2)
        return np.flatnonzero(off.min(axis=1, initial=np.inf) > clearance_m)


def _distance(a: np.ndarray, b: np.ndarray) -> Float[np.ndarray, " n"]:
    off = a - b
    return np.sqrt((off * off).sum(axis=1))
