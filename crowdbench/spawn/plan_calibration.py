"""How models of plans get as many companions as are found in a recording.

Companions are found by a rule, in recordings as in rollouts (`trajectories.companions`). Where many
people enter, some of those whom it finds only happen to walk side by side. A model that is fitted
to all of them would have them twice: those that it sends as companions, and those among the others
who happen to be. So the weights of its links are changed until people who are drawn at the recorded
times in the recorded areas, and walk straight, have as many companions as are found in the
recording, and as large groups.
"""

from dataclasses import replace

import numpy as np
from jaxtyping import Int

from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.links import Links
from crowdbench.spawn.plan_fitting import marks_of
from crowdbench.spawn.planned import PlannedAreas
from crowdbench.trajectories.blocks import TimeBlocks
from crowdbench.trajectories.companions import groups_of
from crowdbench.trajectories.table import Trajectories, from_rows

_ROUNDS = 5
_PEOPLE = 3_000
"""Number of people drawn in each round; more if the recording has more."""
_LONGEST_WAIT_S = 600.0


def calibrated(
    areas: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks, scene: Scene, seed: int = 0
) -> PlannedAreas:
    """The same plans, with as many companions as the people who enter in the time blocks have.

    Two numbers are fitted: one that is added to the log weights of all links, and one to those of
    people who join two others or more.
    """
    marks = marks_of(crowd, blocks)
    if not (marks.group >= 0).any():
        return areas
    aim = _log_odds(groups_of(crowd)[marks.persons])
    rng = np.random.default_rng(seed)
    draws = -(-_PEOPLE // len(marks.persons))
    links = areas.links
    for _ in range(_ROUNDS):
        plans = replace(areas, links=links)
        groups, offset = [], 0
        for _ in range(draws):
            events = plans.draw(marks.time_s, marks.area, scene, rng)
            found = groups_of(straight_walks(events, scene))
            groups.append(np.where(found >= 0, found + offset, -1))
            offset += len(found)
        more, larger = aim - _log_odds(np.concatenate(groups))
        links = _shifted(links, more, larger)
    return replace(areas, links=links)


def _shifted(links: Links, more: float, larger: float) -> Links:
    """Links with these numbers added to all log weights, and to those of joining two or more."""
    of_larger = links.larger + np.where(np.arange(len(links.larger)) > 0, larger, larger / 2)
    return replace(links, log_weight=links.log_weight + more, larger=of_larger)


def _log_odds(group: Int[np.ndarray, " n"]) -> np.ndarray:
    """Log odds that a person has a companion, and that those who do are three or more."""
    together = group[group >= 0]
    _, label, size = np.unique(together, return_inverse=True, return_counts=True)
    of_three = (size[label] >= 3).sum()
    return np.log(
        [
            (len(together) + 0.5) / (len(group) - len(together) + 0.5),
            (of_three + 0.5) / (len(together) - of_three + 0.5),
        ]
    )


def straight_walks(events: SpawnEvents, scene: Scene) -> Trajectories:
    """The people of these events, who walk straight to their via points, wait, and to their goals.

    Walls and other people do not hinder them.
    """
    start, goal = events.start.astype(np.float64), events.goal.astype(np.float64)
    via = np.where(np.isnan(events.via), (start + goal) / 2, events.via)
    speed = np.maximum(events.speed.astype(np.float64), 0.1)
    wait_s = events.wait_s.clip(max=_LONGEST_WAIT_S)
    first_m, second_m = (np.linalg.norm(b - a, axis=1) for a, b in ((start, via), (via, goal)))
    way_m = np.maximum(first_m + second_m - scene.motion.goal_radius_m, 0.0)
    rows = np.floor((way_m / speed + wait_s) / scene.dt_s).astype(np.int64) + 2
    person = np.repeat(np.arange(len(events)), rows)
    step = np.arange(len(person)) - np.repeat(np.cumsum(rows) - rows, rows)
    since_s = step * scene.dt_s
    came_s = (first_m / speed)[person]
    walked_s = np.minimum(since_s, came_s) + np.maximum(since_s - came_s - wait_s[person], 0.0)
    walked_m = np.minimum(walked_s * speed[person], way_m[person])
    first = np.divide(
        walked_m, first_m[person], out=np.ones(len(person)), where=first_m[person] > 0
    )
    rest = (walked_m - first_m[person]).clip(0) / np.maximum(second_m[person], 1e-9)
    xy = start[person] + first.clip(max=1)[:, None] * (via - start)[person]
    xy += rest.clip(max=1)[:, None] * (goal - via)[person]
    entry = np.ceil(events.time_s / scene.dt_s - 1e-6).astype(np.int64)
    return from_rows(
        scene=scene.id,
        dt_s=scene.dt_s,
        person_id=person,
        frame=entry[person] + step,
        xy=xy,
        where="plans",
    )
