"""A fitted spawn model under a scenario: other rates, other goals and more areas, not retrained.

**Rates.** In a fitted model each area has an independent arrival process. A factor f(t) speeds up
its time: with Λ(t) = ∫₀ᵗ f, an arrival at time u moves to Λ⁻¹(u). Members of a group still enter
together. In the transformed time, gaps keep their distribution and their dependence on the past; in
real time they are divided by f. The models are stationary, so the expected number of persons in an
interval is exactly the model's rate times ∫ f. A Poisson process of rate λ becomes one of rate
λ f(t). While f = 0 nobody enters. Source: Daley & Vere-Jones (2003), An Introduction to the Theory
of Point Processes I, sec. 7.4 (the random time change, in reverse).

The alternatives were thinning for f < 1 and the superposition of independent samples for f > 1.
They have the same mean, but their gaps approach those of a Poisson process, so a bursty area would
become less bursty the more people enter there.

**Random numbers.** The unsteered sample is drawn first, with the same random numbers as without a
scenario; everything else uses separate random numbers. Therefore arrivals at an area that the
scenario does not name are identical to those of the model with the same seed. Arrivals at an area
that it names are identical until its factor first changes. If Λ exceeds the length of the sample,
further independent samples of the model are appended. At each of these joints the memory of an area
is lost, but no mean changes.

**Goals.** When the goal distribution of an area changes from P to Q, as few persons as possible get
another goal: a person with goal g keeps it with probability min(1, Q(g)/P(g)), and the others draw
a goal from the positive part of Q − P. Starts, speeds and times do not change. If a goal is closed,
only people who would have walked there are affected. P is that of the scene (or of the model's own
`areas`). The model must draw goals from it independently for each person, as fitted models do.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float, Int
from numpy.random import Generator, default_rng

from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import Arrivals, SpawnEvents, entering, joined
from crowdbench.spawn.model import SpawnModel, Start
from crowdbench.spawn.plans.planned import PlannedAreas
from crowdbench.spawn.steering.scenario import Addition, Number, Profile, Scenario, row

_PURPOSES = ("more", "earlier", "goals", "add", "plans")


@dataclass(frozen=True, eq=False)
class Clock:
    """Λ(t), the integral of a piecewise constant factor, and its inverse; Λ(0) = 0.

    The arrays hold, for each interval with a positive factor, its start, Λ there, and the factor.
    """

    start_s: Float[np.ndarray, " n"]
    reading_s: Float[np.ndarray, " n"]
    factor: Float[np.ndarray, " n"]
    end_s: float
    """Λ at the horizon."""

    @classmethod
    def of(cls, profile: Profile, *, before: float, warm_up_s: float, horizon_s: float) -> "Clock":
        """The clock of a sample that begins `warm_up_s` before time 0 of the profile.

        `before` is the factor before the first step. During the warm-up the factor is that at time
        0.
        """
        steps = ((0.0, profile),) if isinstance(profile, Number) else profile
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
            raise SettingError(
                self.name,
                got="a second scenario",
                expected="one scenario per model",
                hint="Combine both scenarios into one.",
            )
        if self.model.start != "stationary":
            raise SettingError(
                self.name,
                got=f"the spawn model {self.model.name} with start {self.model.start!r}",
                expected="a model with start 'stationary', of which more people can be sampled",
                hint="Use a fitted model or block-replay.",
            )

    @property
    def name(self) -> str:
        """Name of the model in tables: MODEL+SCENARIO."""
        return f"{self.model.name}+{self.scenario.name}"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Sample the people who enter in [0, `horizon_s`), seconds."""
        usual = self.model.sample(horizon_s, scene, rng)
        chance = _Chance(self, horizon_s, scene, usual, int(rng.integers(2**63)))
        usual = chance.stretch(0)
        retimed = [c for c in self.scenario.change if c.factor != 1 or c.shift_s != 0]
        parts = [usual[~np.isin(usual.spawn_area, [c.area for c in retimed])]]
        for change in retimed:
            clock = self._clock(change.factor, 1.0, horizon_s)
            parts.append(_retimed(change.area, clock, change.shift_s, chance))
        events = self._redirected(joined(parts), scene, chance)
        added = [
            self._added(k, addition, scene, chance) for k, addition in enumerate(self.scenario.add)
        ]
        return joined([events, *added])

    def log_likelihood(self, arrivals: Arrivals) -> float:
        """Not available, because a steered model intentionally differs from the recording.

        Raises:
            SettingError: always.
        """
        raise SettingError(
            self.name, got="a request for a likelihood", expected="a model without a scenario"
        )

    def _clock(self, profile: Profile, before: float, horizon_s: float) -> Clock:
        return Clock.of(profile, before=before, warm_up_s=self.warm_up_s, horizon_s=horizon_s)

    def replanned(
        self, events: SpawnEvents, scene: Scene, generator: Callable[[int], Generator]
    ) -> SpawnEvents:
        """The same arrivals, with other groups and stops where the scenario asks for them."""
        for change in (c for c in self.scenario.change if c.of_plans()):
            assert isinstance(self.areas, PlannedAreas)  # checked with the scenario
            mine = events.spawn_area == change.area
            time_s = events.time_s[mine]
            areas = self.areas.changed(change.area, time_s, **change.of_plans())
            number = np.full(len(time_s), change.area)
            drawn = areas.draw(time_s, number, scene, generator(change.area))
            events = joined([events[~mine], drawn])
        return events

    def _redirected(self, events: SpawnEvents, scene: Scene, chance: "_Chance") -> SpawnEvents:
        """The same events, with some goals changed as the scenario requires."""
        flow, wanted = self.areas.flow, self.scenario.flow(self.areas)
        goal_area, goal = events.goal_area.copy(), events.goal.copy()
        for k in np.flatnonzero(~np.isclose(flow, wanted).all(axis=1)).tolist():
            rng = chance.generator("goals", k)
            mine = np.flatnonzero((events.spawn_area == k) & (events.goal_area >= 0))
            leader = _leaders(events, mine)  # companions keep or change their goal together
            mine = mine[leader == mine]
            now = goal_area[mine]
            keep = np.divide(wanted[k], flow[k], out=np.ones(len(flow[k])), where=flow[k] > 0)
            moved = mine[rng.random(len(mine)) >= keep[now]]
            more = np.maximum(0, wanted[k] - flow[k])
            if len(moved):
                goal_area[moved] = rng.choice(len(more), len(moved), p=more / more.sum())
                goal[moved] = self.areas.goal.draw(goal_area[moved], scene, rng)
                everyone = np.flatnonzero((events.spawn_area == k) & (events.goal_area >= 0))
                after = np.isin(leader, moved) & (leader != everyone)
                follower, led = everyone[after], leader[after]
                beside = goal[led] + events.goal[follower] - events.goal[led]
                free = scene.walkable(beside.astype(np.float64))
                goal[follower] = np.where(free[:, None], beside, goal[led])
                goal_area[follower] = goal_area[led]
        # Whoever has a via point goes there first, whatever the goal.
        moved = (goal_area != events.goal_area) & np.isnan(events.via[:, 0])
        headed = entering(
            time_s=events.time_s,
            start=events.start.astype(np.float64),
            goal=goal.astype(np.float64),
            spawn_area=events.spawn_area,
            goal_area=goal_area,
            speed=events.speed.astype(np.float64),
        )
        velocity = np.where(moved[:, None], headed.velocity, events.velocity)
        return replace(events, goal=goal, goal_area=goal_area, velocity=velocity)

    def _added(self, k: int, addition: Addition, scene: Scene, chance: "_Chance") -> SpawnEvents:
        """The people of an added area: a Poisson process of groups with geometric sizes."""
        rng = chance.generator("add", k)
        clock = self._clock(addition.persons_per_min, 0.0, chance.horizon_s)
        groups = rng.poisson(clock.end_s / 60 / addition.group_size)
        time_s = clock.when(rng.random(groups) * clock.end_s)
        time_s = np.repeat(time_s, rng.geometric(1 / addition.group_size, groups))
        covariance = np.diag(np.square(addition.sd_m, dtype=np.float64))
        spawn = Gaussians(np.array([addition.mean_m], dtype=np.float64), covariance[None])
        areas = self.areas.instead(spawn, row(addition.goals, len(self.areas.goal))[None])
        events = areas.draw(time_s, np.zeros(len(time_s), dtype=np.int64), scene, rng)
        return replace(events, spawn_area=events.spawn_area + np.int32(len(self.areas.spawn) + k))


@dataclass(frozen=True, eq=False)
class _Chance:
    """The unsteered sample of a model, further samples, and random numbers for everything else."""

    steered: Steered
    horizon_s: float
    scene: Scene
    usual: SpawnEvents
    root: int

    def generator(self, purpose: str, *index: int) -> Generator:
        """A separate random generator for each purpose and index, independent of the scenario."""
        return default_rng([self.root, _PURPOSES.index(purpose), *index])

    def stretch(self, j: int) -> SpawnEvents:
        """The events in [j, j + 1) horizons of an endless sample; j = 0 is the unsteered sample."""
        events = self.usual
        if j != 0:
            rng = self.generator("more", j) if j > 0 else self.generator("earlier", -j)
            events = self.steered.model.sample(self.horizon_s, self.scene, rng)
        which = 2 * abs(j) + (j < 0)
        events = self.steered.replanned(
            events, self.scene, lambda area: self.generator("plans", which, area)
        )
        return events.shifted(j * self.horizon_s) if j else events


def _leaders(events: SpawnEvents, mine: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """Index of the first of these events with the same group and goal area as each of them."""
    key = np.stack([events.group[mine], events.goal_area[mine]], axis=1)
    key[events.group[mine] < 0, 1] = -1 - np.flatnonzero(events.group[mine] < 0)
    _, first, which = np.unique(key, axis=0, return_index=True, return_inverse=True)
    return np.asarray(mine[first[which.reshape(-1)]])


def _retimed(area: int, clock: Clock, shift_s: Number, chance: _Chance) -> SpawnEvents:
    """The events of an area, shifted by `shift_s` and then transformed by its clock."""
    first = int(np.floor(-shift_s / chance.horizon_s))
    last = int(np.ceil((clock.end_s - shift_s) / chance.horizon_s))
    stretches: Sequence[SpawnEvents] = [chance.stretch(j) for j in range(first, last)]
    mine = joined([s[s.spawn_area == area] for s in stretches]).shifted(shift_s)
    mine = mine[(mine.time_s >= 0) & (mine.time_s < clock.end_s)]
    events = replace(mine, time_s=clock.when(mine.time_s))
    return events[events.time_s < chance.horizon_s]  # rounding may move events to the horizon
