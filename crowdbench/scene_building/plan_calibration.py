"""How models of plans get companions like those that are found in recordings.

Companions are found by a rule, in recordings as in rollouts (`trajectories.companions`). Where many
people enter, some of those whom it finds only happen to walk side by side. A model that is fitted
to all of them would have them twice: those that it sends as companions, and those among the others
who happen to be. So people are drawn at the recorded times in the recorded areas, and walk
straight:

- The weights of joining are changed until as many companions are found among them as in the
  recording, and as large groups.
- Pairs that are found although they are in different groups show what companions by accident look
  like. Each recorded pair counts for the offsets with the probability that it is none of those.

The times of a model are not the recorded ones. Where they are more crowded, more people join, and
more happen to walk side by side. So four numbers are then found for each model, for which its own
samples have the recorded share of people with companions, sizes of groups, and distances of
companions along and across their way.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator

from crowdbench.metrics.groups import pairs_of as companions_of
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import SpawnEvents
from crowdbench.spawn.links import OFFSETS, Adjustment, one_sided
from crowdbench.spawn.mixtures import log_gaussians, moments, responsibilities
from crowdbench.spawn.plan_fitting import (
    Marks,
    companion_before,
    marks_of,
    offsets_of,
    pairs_of,
)
from crowdbench.spawn.planned import PlannedAreas
from crowdbench.trajectories.blocks import TimeBlocks, cut
from crowdbench.trajectories.companions import groups_of
from crowdbench.trajectories.table import Trajectories, from_rows

_ROUNDS = 6
_PEOPLE = 3_000
"""Number of people drawn in each round; more if the recording has more."""
_LONGEST_WAIT_S = 600.0
_FEWEST = 40
"""With fewer pairs, recorded or by accident, all recorded pairs count fully."""
_COMPONENTS = 4
_ADJUSTING = 8
"""Number of rounds in which plans are adjusted to the times of a model."""
_ADJUSTED = 6_000
"""About the number of people drawn in each of these rounds."""
_FULL_STEPS = 4
"""Rounds with full steps; later ones are shorter."""
_FEWEST_COMPANIONS = 10
_MOST_ODDS = 2.0
"""Largest change of a log weight."""
_HARDLY = 0.05
"""Least distance, and number of people, of which the logarithm is taken."""
_FACTORS = 0.5, 2.0
"""Smallest and largest factor of offsets."""


def calibrated(
    areas: PlannedAreas, crowd: Trajectories, blocks: TimeBlocks, scene: Scene, seed: int = 0
) -> PlannedAreas:
    """The same plans, with companions like those of the people who enter in the time blocks.

    Two numbers are found: how much is added to all log weights, and how much more to those of
    joining a group.
    """
    marks = marks_of(crowd, blocks)
    if not (marks.group >= 0).any():
        return areas
    pairs = pairs_of(crowd, marks)
    aim = _log_odds(groups_of(crowd)[marks.persons])
    rng = np.random.default_rng(seed)
    for k in range(_ROUNDS):
        samples = _samples(areas, marks, scene, rng)
        more, larger = aim - _log_odds(_together([found for _, _, found in samples]))
        links = areas.links.adjusted(Adjustment(more=more, larger=larger))
        if k == _ROUNDS // 2:
            weight = _deliberate(pairs.offsets, samples)
            links = links.with_offsets(pairs.offsets, pairs.walked_m, weight)
        areas = replace(areas, links=links)
    return areas


@runtime_checkable  # tests check annotations at run time
class Times(Protocol):
    """A model of times that has areas, as those of `registry.PLANNED` have."""

    @property
    def areas(self) -> Areas:
        """Areas from which it draws places."""
        ...

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter."""
        ...


def adjustment(
    model: Times,
    areas: PlannedAreas,
    crowd: Trajectories,
    blocks: TimeBlocks,
    scene: Scene,
    seed: int = 0,
) -> Adjustment:
    """How the links of these plans are changed for the times of a model.

    `areas` are those of `calibrated`. Stochastic approximation (Robbins and Monro 1951, Annals of
    Mathematical Statistics 22): each round draws new samples, and later rounds move less.
    """
    aim = _company(crowd, blocks, scene)
    if aim.people < _FEWEST_COMPANIONS:
        return Adjustment()
    # One long sample instead of several short ones, which take longer.
    horizon_s = blocks.exposure_s() * max(1, round(_ADJUSTED / aim.people_in_all))
    whole = cut(
        np.array([[0, scene.frames(horizon_s)]]),
        block_s=horizon_s,
        dt_s=scene.dt_s,
        grid_s=scene.grid_s,
    )
    rng, by = np.random.default_rng(seed), Adjustment()
    for k in range(_ADJUSTING):
        adjusted = replace(areas, links=areas.links.adjusted(by))
        sending = replace(model, areas=adjusted)  # type: ignore[type-var]
        sample = straight_walks(sending.sample(horizon_s, scene, rng), scene)
        found = _company(sample, whole, scene)
        gain = min(1.0, _FULL_STEPS / (k + 1))
        moved = {
            name: getattr(by, name) + gain * off
            for name, off in (
                ("more", aim.log_odds - found.log_odds),
                ("larger", aim.log_larger - found.log_larger),
            )
        }
        by = Adjustment(
            more=float(np.clip(moved["more"], -_MOST_ODDS, _MOST_ODDS)),
            larger=float(np.clip(moved["larger"], -_MOST_ODDS, _MOST_ODDS)),
            along=_factor(by.along, gain, aim.along_m, found.along_m),
            across=_factor(by.across, gain, aim.across_m, found.across_m),
        )
    return by


def _factor(now: float, gain: float, aim: float, found: float) -> float:
    return float(np.clip(now * (aim / found) ** gain, *_FACTORS))


@dataclass(frozen=True)
class _Company:
    """The companions of a crowd."""

    people: int
    """Number of people with a companion."""
    people_in_all: int
    mean_size: float
    """Mean size of the groups of people with a companion."""
    along_m: float
    """Mean distance of companions along the way of both, and across it, metres."""
    across_m: float

    @property
    def log_odds(self) -> float:
        """Log odds that a person has a companion."""
        return float(np.log((self.people + 0.5) / (self.people_in_all - self.people + 0.5)))

    @property
    def log_larger(self) -> float:
        """Log of how many people more than two there are in the groups."""
        return float(np.log(self.mean_size - 2 + _HARDLY))


def _company(crowd: Trajectories, blocks: TimeBlocks, scene: Scene) -> _Company:
    persons, group = blocks.of_arrivals(crowd)[0], groups_of(crowd)
    together = group[persons[group[persons] >= 0]]
    size = np.bincount(group[group >= 0], minlength=1)[together]
    gap = np.abs(companions_of(crowd, blocks, scene.walking.tick_frames).abreast()[1])
    along_m, across_m = gap.mean(axis=0).tolist() if len(gap) else (_HARDLY, _HARDLY)
    mean_size = float(size.mean()) if len(size) else 2.0
    return _Company(
        len(together), len(persons), mean_size, max(along_m, _HARDLY), max(across_m, _HARDLY)
    )


_Sample = tuple[SpawnEvents, Trajectories, Int[np.ndarray, " _"]]
"""Plans, the people who walk them, and the groups that are found among these."""


def _samples(areas: PlannedAreas, marks: Marks, scene: Scene, rng: Generator) -> list[_Sample]:
    samples = []
    for _ in range(-(-_PEOPLE // len(marks.persons))):
        events = areas.draw(marks.time_s, marks.area, scene, rng)
        walked = straight_walks(events, scene)
        samples.append((events, walked, groups_of(walked)))
    return samples


def _together(groups: Sequence[Int[np.ndarray, " _"]]) -> Int[np.ndarray, " n"]:
    """The groups of several samples, numbered apart."""
    offset = np.cumsum([0, *(len(group) for group in groups)])
    each = zip(groups, offset[:-1].tolist(), strict=True)
    return np.concatenate([np.where(group >= 0, group + first, -1) for group, first in each])


def _deliberate(
    offsets: Float[np.ndarray, "n 5"], samples: Sequence[_Sample]
) -> Float[np.ndarray, " n"]:
    """Probability that recorded pairs with these offsets are no companions by accident."""
    found, number = [np.empty((0, OFFSETS))], 0
    for events, walked, group in samples:
        before = companion_before(events.time_s, events.spawn_area.astype(np.int64), group)
        later = np.flatnonzero(before >= 0)
        number += len(later)
        apart = (events.group[later] < 0) | (events.group[later] != events.group[before[later]])
        found.append(offsets_of(walked, later[apart], before[later[apart]]))
    accidental = np.concatenate(found)
    return _unlikely_by_accident(offsets, accidental, len(accidental) / max(number, 1))


def _unlikely_by_accident(
    offsets: Float[np.ndarray, "n 5"], accidental: Float[np.ndarray, "m 5"], share: float
) -> Float[np.ndarray, " n"]:
    """1 − a f(x) / r(x) for recorded offsets x, at least 0.

    a is the `share` of companions by accident among all that are found, f the density of their
    offsets, and r that of the recorded offsets.
    """
    if min(len(accidental), len(offsets)) < _FEWEST:
        return np.ones(len(offsets))
    recorded = one_sided(offsets)
    off = _log_density(recorded, one_sided(accidental)) - _log_density(recorded, recorded)
    return np.asarray((1 - share * np.exp(off)).clip(0, 1))


def _log_density(
    at: Float[np.ndarray, "n 5"], sample: Float[np.ndarray, "m 5"]
) -> Float[np.ndarray, " n"]:
    """Log density of a mixture fitted to a sample."""
    shares = responsibilities(sample, 0, 1e-2, _COMPONENTS)
    fitted = [moments(sample, share) for share in shares.T]
    each = log_gaussians(
        at,
        np.stack([mean for mean, _ in fitted]),
        np.stack([covariance for _, covariance in fitted]) + 1e-2 * np.eye(OFFSETS),
    )
    return np.asarray(np.logaddexp.reduce(each + np.log(shares.mean(axis=0)), axis=1))


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
