"""How models of plans get as many companions as recordings have.

Companions are found by a rule (`trajectories.companions`), in recordings as in rollouts. Plans are
drawn so that it finds those who are planned as companions, and nobody else, among straight walkers
(`spawn.planned`). Who joins whom is fitted to recorded times. The times of a model are others:
where they are more crowded, more people join. So four numbers are found for each model, for which
its own samples have the recorded share of people with companions, sizes of groups, distances of
companions, and distances across their way.
"""

from dataclasses import dataclass, replace
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator

from crowdbench.data.blocks import TimeBlocks, cut
from crowdbench.data.companions import groups_of
from crowdbench.data.table import Trajectories, from_rows
from crowdbench.metrics.groups import APART_M
from crowdbench.metrics.groups import pairs_of as companions_of
from crowdbench.registry import policy
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.model import Start
from crowdbench.spawn.plans.links import Adjustment
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.recorded_plans import turning_points

_LONGEST_WAIT_S = 600.0
_ADJUSTING = 10  # number of rounds in which plans are adjusted to the times of a model
_ADJUSTED = 6_000  # about the number of people drawn in each of these rounds
_GAIN = 1.5
"""Gain of the first rounds: statistics change less than in proportion to what is changed."""
_FULL_STEPS = np.array([2.5, 2.5, 5.0, 5.0])
"""The gains of round k are these numbers divided by k, from the round on in which they are smaller.
Distances change least."""
_CORRECTING = 4  # round in which it is found how people in the simulation differ from straight ones
_SIMULATED = 2_000  # about the number of people who are simulated then
_FEWEST_COMPANIONS = 10
_MOST_ODDS = 8.0  # largest change of a log weight
_HARDLY = 0.05  # least distance, and number of people, of which the logarithm is taken
_FACTORS = 0.2, 3.0  # smallest and largest factor of offsets


def adjustment(
    model: Any,
    areas: PlannedAreas,
    crowd: Trajectories,
    blocks: TimeBlocks,
    scene: Scene,
    seed: int = 0,
) -> Adjustment:
    """How the links of these plans are changed for the times of a model of `registry.PLANNED`.

    Stochastic approximation (Robbins and Monro 1951, Annals of Mathematical Statistics 22): each
    round draws new samples, and later rounds move less. People walk straight through walls, which
    is fast. Once the same people are simulated, and what they do differently is accounted for.
    """
    recorded = _company(crowd, blocks, scene)
    if recorded.people < _FEWEST_COMPANIONS:
        return Adjustment()

    def sent(by: Adjustment, people: int) -> tuple[SpawnEvents, TimeBlocks]:
        """About this number of people, and the whole time as one block.

        One long sample takes less time than several short ones.
        """
        horizon_s = blocks.exposure_s() * max(1, round(people / recorded.people_in_all))
        whole = cut(
            np.array([[0, scene.frames(horizon_s)]]),
            block_s=horizon_s,
            dt_s=scene.dt_s,
            grid_s=scene.grid_s,
        )
        sending = replace(model, areas=replace(areas, links=areas.links.adjusted(by)))
        return sending.sample(horizon_s, scene, rng), whole

    rng, by, aim = np.random.default_rng(seed), Adjustment(), recorded.numbers()
    for k in range(_ADJUSTING):
        if k == _CORRECTING:
            events, whole = sent(by, _SIMULATED)
            walked = _company(straight_walks(events, scene), whole, scene)
            horizon_s = float(events.time_s.max(initial=0.0)) + scene.grid_s
            straight = policy("straight", scene)
            by_policy = rollout(scene, _These(events), straight, seed=0, horizon_s=horizon_s)
            simulated = _company(by_policy, whole, scene)
            aim = aim + walked.numbers() - simulated.numbers()
        events, whole = sent(by, _ADJUSTED)
        found = _company(straight_walks(events, scene), whole, scene)
        gain = np.minimum(_GAIN, _FULL_STEPS / (k + 1))
        more, larger, along, across = gain * (aim - found.numbers())
        by = Adjustment(
            more=float(np.clip(by.more + more, -_MOST_ODDS, _MOST_ODDS)),
            larger=float(np.clip(by.larger + larger, -_MOST_ODDS, _MOST_ODDS)),
            along=float(np.clip(by.along * np.exp(along), *_FACTORS)),
            across=float(np.clip(by.across * np.exp(across), *_FACTORS)),
        )
    return by


@dataclass(frozen=True)
class _Company:
    people: int
    """Number of people with a companion."""
    people_in_all: int
    mean_size: float
    """Mean size of the groups of people with a companion."""
    distance_m: float
    """Mean distance of companions, and how far they are apart across their way, metres."""
    across_m: float

    def numbers(self) -> Float[np.ndarray, " 4"]:
        """What the four numbers of an adjustment change.

        Log odds that a person has a companion, log of how many people more than two there are in
        the groups, and the logs of both distances.
        """
        alone = self.people_in_all - self.people
        larger, *far = np.maximum([self.mean_size - 2, self.distance_m, self.across_m], _HARDLY)
        return np.log([(self.people + 0.5) / (alone + 0.5), larger, *far])


def _company(crowd: Trajectories, blocks: TimeBlocks, scene: Scene) -> _Company:
    persons, group = blocks.of_arrivals(crowd)[0], groups_of(crowd)
    together = group[persons[group[persons] >= 0]]
    size = np.bincount(group[group >= 0], minlength=1)[together]
    pairs = companions_of(crowd, blocks, scene.walking.tick_frames)
    across = np.abs(pairs.abreast()[1][:, 1])
    distance_m, across_m = (
        float(x.clip(max=APART_M).mean()) if len(x) else 0.0
        for x in (np.hypot(*pairs.gap.T), across)
    )
    mean_size = float(size.mean()) if len(size) else 2.0
    return _Company(len(together), len(persons), mean_size, distance_m, across_m)


@dataclass(frozen=True, eq=False)
class _These:
    events: SpawnEvents
    start: ClassVar[Start] = "empty"
    name: ClassVar[str] = "people who are known"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        return self.events


def straight_walks(events: SpawnEvents, scene: Scene) -> Trajectories:
    """The people of these events, who walk straight to their via points, wait, and to their goals.

    Walls and other people do not hinder them.
    """
    start, goal = events.start.astype(np.float64), events.goal.astype(np.float64)
    via = turning_points(start, events.via.astype(np.float64), goal, events.wait_s > 0)
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
