"""A fitted spawn model under a scenario: other rates, other goals, areas more, and no retraining.

**Rates.** Each area of a fitted model lets people in on a clock of its own, independently of the
others. A factor f(t) makes that clock run f times as fast: with Λ(t) = ∫₀ᵗ f, who would have come
at u comes at Λ⁻¹(u). Members of a group still come together, gaps keep their distribution and
their dependence on the past in the clock's time (on the wall they are divided by f), and since the
models are stationary, the expected number of persons in a stretch is exactly the model's rate
times ∫ f. A Poisson process of rate λ becomes the one of rate λ f(t). While f = 0 the clock stands
still and nobody comes. Source: Daley & Vere-Jones (2003), An Introduction to the Theory of Point
Processes I, sec. 7.4 (the random time change, backwards).

The other ways were thinning groups for f < 1 and putting independent samples on top of each other
for f > 1. They keep the mean too, but gaps tend to those of a Poisson process, so that a bursty
area would be the less bursty the more people it lets in.

**Chance.** The unsteered sample is drawn first, with the very random numbers it would get anyway,
and all else from others. So the arrivals of an area that the scenario does not name are bit for bit
those of the model with the same seed, and those of one that it names are until its factor changes
first. A clock that reads more than the sample is long goes on with another, independent sample of
the model; there, once per length of the sample, an area's memory is lost, but no mean changes.

**Goals.** From P to Q as few persons as can be change their goal: who walks to g keeps it with
probability min(1, Q(g)/P(g)), the others draw from what Q has more than P. Starts, speeds and times
stay. For a closed goal that moves just those who would have walked there. P is the scene's (or the
model's own `areas`): a model must draw its goals by it, person by person, as fitted ones do.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
from jaxtyping import Float
from numpy.random import Generator, default_rng

from crowdbench.errors import SettingError
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.events import Arrivals, SpawnEvents, entering, joined
from crowdbench.spawn.model import SpawnModel, Start
from crowdbench.spawn.scenario import Addition, Number, Profile, Scenario, row

_PURPOSES = ("more", "earlier", "goals", "add")


@dataclass(frozen=True, eq=False)
class Clock:
    """Λ(t) of a factor that is constant on stretches, and its inverse; 0 at t = 0.

    The arrays hold of each stretch in which the clock runs its start, Λ there and its factor.
    """

    start_s: Float[np.ndarray, " n"]
    reading_s: Float[np.ndarray, " n"]
    factor: Float[np.ndarray, " n"]
    end_s: float
    """What it reads at the horizon."""

    @classmethod
    def of(cls, profile: Profile, *, before: float, warm_up_s: float, horizon_s: float) -> "Clock":
        """The clock from the start of a sample, `warm_up_s` before the profile's time 0.

        `before` is the factor before the first step; in the warm-up holds what holds at time 0.
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
        """The times at which it reads these numbers, each from 0 to below `end_s`."""
        at = np.searchsorted(self.reading_s, reading_s, side="right") - 1
        # So that before the first change it is, to the last bit, what the clock reads.
        late = self.start_s[at] - self.reading_s[at] / self.factor[at]
        return reading_s / self.factor[at] + late


@dataclass(frozen=True, eq=False)
class Steered:
    """A spawn model under a scenario; `registry.spawn_model` makes one and checks that it fits."""

    model: SpawnModel
    scenario: Scenario
    areas: Areas
    """Those that the model draws from."""
    warm_up_s: float = 0.0
    """Seconds of a sample before the episode: the scenario's times count from there."""
    start: ClassVar[Start] = "stationary"

    def __post_init__(self) -> None:
        """Refuse models that cannot be asked for more of the same.

        Raises:
            SettingError: its episodes do not begin stationary, or it is steered already.
        """
        if isinstance(self.model, Steered):
            raise SettingError(
                self.name,
                got="a second scenario",
                expected="one scenario over a model",
                hint="Put both into one.",
            )
        if self.model.start != "stationary":
            raise SettingError(
                self.name,
                got=f"the spawn model {self.model.name}, which starts {self.model.start}",
                expected="a stationary one: there is nothing more to draw from replayed people",
                hint="Steer a fitted model, or block-replay.",
            )

    @property
    def name(self) -> str:
        """Under which tables show it."""
        return f"{self.model.name}+{self.scenario.name}"

    def sample(self, horizon_s: float, scene: Scene, rng: Generator) -> SpawnEvents:
        """Events in [0, `horizon_s`)."""
        usual = self.model.sample(horizon_s, scene, rng)
        chance = _Chance(self.model, horizon_s, scene, usual, int(rng.integers(2**63)))
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
        """A recording says nothing about what was changed on purpose.

        Raises:
            SettingError: always.
        """
        raise SettingError(
            self.name, got="a request for a likelihood", expected="a model that is not steered"
        )

    def _clock(self, profile: Profile, before: float, horizon_s: float) -> Clock:
        return Clock.of(profile, before=before, warm_up_s=self.warm_up_s, horizon_s=horizon_s)

    def _redirected(self, events: SpawnEvents, scene: Scene, chance: "_Chance") -> SpawnEvents:
        """The same people, some of them with other goals."""
        flow, wanted = self.areas.flow, self.scenario.flow(self.areas)
        goal_area, goal = events.goal_area.copy(), events.goal.copy()
        for k in np.flatnonzero(~np.isclose(flow, wanted).all(axis=1)).tolist():
            rng = chance.generator("goals", k)
            mine = np.flatnonzero((events.spawn_area == k) & (events.goal_area >= 0))
            now = goal_area[mine]
            keep = np.divide(wanted[k], flow[k], out=np.ones(len(flow[k])), where=flow[k] > 0)
            moved = mine[rng.random(len(mine)) >= keep[now]]
            more = np.maximum(0, wanted[k] - flow[k])
            if len(moved):
                goal_area[moved] = rng.choice(len(more), len(moved), p=more / more.sum())
                goal[moved] = self.areas.goal.draw(goal_area[moved], scene, rng)
        moved = goal_area != events.goal_area
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
        """The people of an added area: groups that are a Poisson process, with geometric sizes."""
        rng = chance.generator("add", k)
        clock = self._clock(addition.persons_per_min, 0.0, chance.horizon_s)
        groups = rng.poisson(clock.end_s / 60 / addition.group_size)
        time_s = clock.when(rng.random(groups) * clock.end_s)
        time_s = np.repeat(time_s, rng.geometric(1 / addition.group_size, groups))
        covariance = np.diag(np.square(addition.sd_m, dtype=np.float64))
        alone = replace(
            self.areas,
            spawn=Gaussians(np.array([addition.mean_m], dtype=np.float64), covariance[None]),
            flow=row(addition.goals, len(self.areas.goal))[None],
        )
        events = alone.draw(time_s, np.zeros(len(time_s), dtype=np.int64), scene, rng)
        return replace(events, spawn_area=events.spawn_area + np.int32(len(self.areas.spawn) + k))


@dataclass(frozen=True, eq=False)
class _Chance:
    """The unsteered sample of a model, further ones, and random numbers for all else."""

    model: SpawnModel
    horizon_s: float
    scene: Scene
    usual: SpawnEvents
    root: int

    def generator(self, purpose: str, k: int) -> Generator:
        """Random numbers that depend on neither the scenario nor each other."""
        return default_rng([self.root, _PURPOSES.index(purpose), k])

    def stretch(self, j: int) -> SpawnEvents:
        """What happens in [j, j + 1) horizons of an endless sample; stretch 0 is the usual one."""
        if j == 0:
            return self.usual
        rng = self.generator("more", j) if j > 0 else self.generator("earlier", -j)
        return self.model.sample(self.horizon_s, self.scene, rng).shifted(j * self.horizon_s)


def _retimed(area: int, clock: Clock, shift_s: Number, chance: _Chance) -> SpawnEvents:
    """An area's people, each when its clock reads when they would have come, and `shift_s`."""
    first = int(np.floor(-shift_s / chance.horizon_s))
    last = int(np.ceil((clock.end_s - shift_s) / chance.horizon_s))
    stretches: Sequence[SpawnEvents] = [chance.stretch(j) for j in range(first, last)]
    mine = joined([s[s.spawn_area == area] for s in stretches]).shifted(shift_s)
    mine = mine[(mine.time_s >= 0) & (mine.time_s < clock.end_s)]
    events = replace(mine, time_s=clock.when(mine.time_s))
    return events[events.time_s < chance.horizon_s]  # what rounding has put there
