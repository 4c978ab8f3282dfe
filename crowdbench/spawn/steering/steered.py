"""A fitted spawn model under a scenario: other rates, other goals and more areas, not retrained.

With Λ(t) = ∫₀ᵗ f of an area's factor f, an arrival at time u moves to Λ⁻¹(u): Daley & Vere-Jones
(2003), An Introduction to the Theory of Point Processes I, sec. 7.4 (the random time change, in
reverse). If Λ exceeds the length of the sample, further independent samples of the model are
appended. At each of these joints the memory of an area is lost, but no mean changes.

When the goal distribution of an area changes from P to Q, a person with goal g keeps it with
probability min(1, Q(g)/P(g)), and the others draw a goal from the positive part of Q − P. The model
must draw goals from P independently for each person or group, as fitted models do.

The unsteered sample is drawn first, with the same random numbers as without a scenario; everything
else uses separate random numbers. `docs/steering.md` says what follows, and what the alternatives
were.
"""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator, default_rng

from crowdbench.data.table import Indices, Numbers
from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from crowdbench.spawn.events import SpawnEvents, entering, joined
from crowdbench.spawn.model import SpawnModel, Start
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.steering.scenario import Addition, Change, Profile, Scenario, row, steps_of

_PURPOSES = ("more", "earlier", "goals", "add", "plans")


@dataclass(frozen=True, eq=False)
class TimeChange:
    """Λ(t), the integral of a piecewise constant factor, and its inverse; Λ(0) = 0.

    The arrays hold, for each interval with a positive factor, its start, Λ there, and the factor.
    """

    start_s: Float[np.ndarray, " n"]
    reading_s: Float[np.ndarray, " n"]
    factor: Float[np.ndarray, " n"]
    end_s: float
    """Λ at the horizon."""

    @classmethod
    def of(
        cls, profile: Profile, before: float, horizon_s: float, warm_up_s: float = 0.0
    ) -> "TimeChange":
        """That of a sample that begins `warm_up_s` before time 0 of the profile.

        `before` is the factor before the first step. During the warm-up the factor is that at time
        0.
        """
        steps = steps_of(profile)
        start = np.array([0.0, *(warm_up_s + t for t, _ in steps)])
        factor = np.array([before, *(f for _, f in steps)], dtype=np.float64)
        if steps[0][0] == 0:
            factor[0] = factor[1]
        inside = start < horizon_s
        start, factor = start[inside], factor[inside]
        grown = np.cumsum(np.diff(start, append=horizon_s) * factor)
        reading = np.concatenate([[0.0], grown[:-1]])
        runs = factor > 0
        return cls(start[runs], reading[runs], factor[runs], float(grown[-1]))

    def when(self, reading_s: Float[np.ndarray, " E"]) -> Float[np.ndarray, " E"]:
        """Λ⁻¹ of these values, each in [0, `end_s`)."""
        at = np.searchsorted(self.reading_s, reading_s, side="right") - 1
        # Computed so that times before the first change are exactly unchanged.
        late = self.start_s[at] - self.reading_s[at] / self.factor[at]
        return reading_s / self.factor[at] + late


@dataclass(frozen=True, eq=False)
class Steered:
    """A spawn model under a scenario; created and checked by `registry.spawn_model`."""

    model: SpawnModel
    scenario: Scenario
    areas: Areas
    """The areas that the model draws from."""
    warm_up_s: float = 0.0
    """Length of the warm-up in seconds; the scenario's times are relative to its end."""
    start: ClassVar[Start] = "stationary"

    def __post_init__(self) -> None:
        """Check that the model can be steered.

        Raises:
            SettingError: the model is not stationary, or it is steered already.
        """
        if isinstance(self.model, Steered):
            got = "a second scenario"
            hint = "Combine both scenarios into one."
            raise SettingError(self.name, got=got, expected="one scenario per model", hint=hint)
        if self.model.start != "stationary":
            got = f"the spawn model {self.model.name} with start {self.model.start!r}"
            expected = "a model with start 'stationary', of which more people can be sampled"
            hint = "Use a fitted model or block-replay."
            raise SettingError(self.name, got=got, expected=expected, hint=hint)

    @property
    def name(self) -> str:
        """Name of the model in tables: MODEL+SCENARIO."""
        return f"{self.model.name}+{self.scenario.name}"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds."""
        usual = self.model.sample(horizon_s, scene, rng)
        return _Sample(self, horizon_s, scene, usual, int(rng.integers(2**63))).steered()


@dataclass(frozen=True, eq=False)
class _Sample:
    """The unsteered sample of a model, and what the scenario makes of it."""

    of: Steered
    horizon_s: float
    scene: Scene
    usual: SpawnEvents
    root: int
    """What all random numbers but those of the unsteered sample are made of."""

    def steered(self) -> SpawnEvents:
        """The people who enter under the scenario."""
        usual, scenario = self._stretch(0), self.of.scenario
        retimed = [c for c in scenario.change if c.retimes]
        others = usual[~np.isin(usual.spawn_area, [c.area for c in retimed])]
        events = self._redirected(joined([others, *map(self._retimed, retimed)]))
        return joined([events, *(self._added(k, new) for k, new in enumerate(scenario.add))])

    def _generator(self, purpose: str, *index: int) -> Generator:
        """A separate random generator for each purpose and index, independent of the scenario."""
        return default_rng([self.root, _PURPOSES.index(purpose), *index])

    def _stretch(self, j: int) -> SpawnEvents:
        """The events in [j, j + 1) horizons of an endless sample; j = 0 is the unsteered sample.

        They have other groups and stops where the scenario asks for them.
        """
        events, areas = self.usual, self.of.areas
        if j != 0:
            rng = self._generator("more", j) if j > 0 else self._generator("earlier", -j)
            events = self.of.model.sample(self.horizon_s, self.scene, rng)
        for change in (c for c in self.of.scenario.change if c.of_plans):
            assert isinstance(areas, PlannedAreas)  # checked with the scenario
            mine = events.spawn_area == change.area
            time_s = events.time_s[mine]
            rng = self._generator("plans", 2 * abs(j) + (j < 0), change.area)
            changed, number = _changed(areas, change, time_s), np.full(len(time_s), change.area)
            drawn = changed.draw(time_s, number, self.scene, rng)
            events = joined([events[~mine], drawn])
        return events.shifted(j * self.horizon_s) if j else events

    def _retimed(self, change: Change) -> SpawnEvents:
        """The events of an area, shifted and then transformed by its factor."""
        time_change = TimeChange.of(change.factor, 1.0, self.horizon_s, self.of.warm_up_s)
        first = int(np.floor(-change.shift_s / self.horizon_s))
        last = int(np.ceil((time_change.end_s - change.shift_s) / self.horizon_s))
        stretches = [self._stretch(j) for j in range(first, last)]
        mine = joined([s[s.spawn_area == change.area] for s in stretches]).shifted(change.shift_s)
        mine = mine[(mine.time_s >= 0) & (mine.time_s < time_change.end_s)]
        events = replace(mine, time_s=time_change.when(mine.time_s))
        return events[events.time_s < self.horizon_s]  # rounding may move events to the horizon

    def _redirected(self, events: SpawnEvents) -> SpawnEvents:
        """The same events, with some goals changed as the scenario requires."""
        areas = self.of.areas
        flow, wanted = areas.flow, self.of.scenario.flow(areas)
        goal_area, goal = events.goal_area.copy(), events.goal.copy()
        for k in np.flatnonzero(~np.isclose(flow, wanted).all(axis=1)).tolist():
            rng = self._generator("goals", k)
            everyone = np.flatnonzero((events.spawn_area == k) & (events.goal_area >= 0))
            leader = _leaders(events, everyone)  # companions keep or change their goal together
            leaders = everyone[leader == everyone]
            keep = np.divide(wanted[k], flow[k], out=np.ones(len(flow[k])), where=flow[k] > 0)
            moved = leaders[rng.random(len(leaders)) >= keep[goal_area[leaders]]]
            if len(moved) == 0:
                continue
            more = np.maximum(0, wanted[k] - flow[k])
            goal_area[moved] = rng.choice(len(more), len(moved), p=more / more.sum())
            goal[moved] = areas.goal.draw(goal_area[moved], self.scene, rng)
            after = np.isin(leader, moved) & (leader != everyone)
            follower, led = everyone[after], leader[after]
            beside = goal[led] + events.goal[follower] - events.goal[led]
            free = self.scene.walkable(beside.astype(np.float64))
            goal[follower] = np.where(free[:, None], beside, goal[led])
            goal_area[follower] = goal_area[led]
        headed = entering(
            time_s=events.time_s,
            start=events.start.astype(np.float64),
            goal=goal.astype(np.float64),
            spawn_area=events.spawn_area,
            goal_area=goal_area,
            speed=events.speed.astype(np.float64),
        )
        # Whoever has a via point goes there first, whatever the goal.
        turns = (goal_area != events.goal_area) & np.isnan(events.via[:, 0])
        velocity = np.where(turns[:, None], headed.velocity, events.velocity)
        return replace(events, goal=goal, goal_area=goal_area, velocity=velocity)

    def _added(self, k: int, addition: Addition) -> SpawnEvents:
        """The people of an added area: a Poisson process of groups with geometric sizes."""
        rng, areas = self._generator("add", k), self.of.areas
        rate, warm_up_s = addition.persons_per_min, self.of.warm_up_s
        time_change = TimeChange.of(rate, 0.0, self.horizon_s, warm_up_s)
        groups = rng.poisson(time_change.end_s / 60 / addition.group_size)
        time_s = time_change.when(rng.random(groups) * time_change.end_s)
        time_s = np.repeat(time_s, rng.geometric(1 / addition.group_size, groups))
        flow = row(addition.goals, len(areas.goal))[None]
        number = np.zeros(len(time_s), dtype=np.int64)
        drawn = areas.instead(addition.gaussian(), flow).draw(time_s, number, self.scene, rng)
        return replace(drawn, spawn_area=drawn.spawn_area + np.int32(len(areas.spawn) + k))


def _changed(areas: PlannedAreas, change: Change, time_s: Numbers) -> PlannedAreas:
    """The same areas, with other groups and stops of people who enter one of them then."""
    k, links, ways = change.area, areas.links, areas.ways
    if change.group_size is not None:
        links = links.with_group_size(k, time_s, change.group_size)
    stopping, longer = ways.stopping.copy(), ways.longer.copy()
    if change.stop is not None:
        stopping[k] = change.stop
    if change.wait_s is not None:
        longer[k] = np.log(change.wait_s / ways.mean_wait_s(k, areas.flow[k]))
    return replace(areas, links=links, ways=replace(ways, stopping=stopping, longer=longer))


def _leaders(events: SpawnEvents, mine: Indices) -> Indices:
    """Index of the first of these events with the same group and goal area as each of them."""
    key = np.stack([events.group[mine], events.goal_area[mine]], axis=1)
    key[events.group[mine] < 0, 1] = -1 - np.flatnonzero(events.group[mine] < 0)
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return np.asarray(mine[first[which.reshape(-1)]])
