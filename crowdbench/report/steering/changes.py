"""Comparison of a spawn model's people with and without a scenario."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from crowdbench.errors import SettingError
from crowdbench.registry import spawn_model
from crowdbench.run.episode import arrivals, warm_up_s
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import Areas, Scenario, SpawnEvents, SpawnModel, Steered
from crowdbench.spawn.steering.scenario import Profile, row
from crowdbench.spawn.steering.steered import TimeChange

_ENTRY = ("time_s", "start", "spawn_area", "speed")
_ALL = (*_ENTRY, "goal", "goal_area", "velocity")


@dataclass(frozen=True, eq=False)
class Steering:
    """Events of a spawn model with and without a scenario, in episodes as long as the recording."""

    scene: Scene
    models: list[Steered]
    """The model under the scenario, by seed."""
    usual_events: list[SpawnEvents]
    """Events of the model as fitted by seed, without those of the warm-up."""
    steered_events: list[SpawnEvents]
    """Events of `models` by seed, without those of the warm-up."""

    @property
    def scenario(self) -> Scenario:
        """The scenario."""
        return self.models[0].scenario

    @property
    def areas(self) -> Areas:
        """Spawn and goal areas of the scene, without added ones."""
        return self.models[0].areas

    @property
    def touched(self) -> list[int]:
        """Spawn areas with a changed rate, and added spawn areas."""
        changed = sorted(c.area for c in self.scenario.change if c.retimes)
        return [*changed, *range(len(self.areas.spawn), self.spawn_areas)]

    @property
    def spawn_areas(self) -> int:
        """Number of spawn areas, including added ones."""
        return len(self.areas.spawn) + len(self.scenario.add)


@dataclass(frozen=True)
class AreaChange:
    """Numbers of people from one spawn area, or to one goal area, means per episode."""

    area: int
    centre_m: tuple[float, float]
    usual: float
    asked: float
    """Number that the scenario asks for: a multiple of `usual`, or the rate of an added area."""
    steered: float
    same_entry: float | None = None
    """Share of the usual people of a spawn area who also enter under the scenario, at exactly the
    same time and place and with the same preferred speed; None if there are no usual people."""
    same_goal: float | None = None
    """Share of the usual people who also have the same goal; None as for `same_entry`."""


def steering(
    scene: str | Path, scenario: Path, *, spawn: str = "ntpp-gmm", seeds: int | None = None
) -> Steering:
    """Sample a spawn model with and without a scenario.

    Seed k uses fit k modulo the number of fits. The number of seeds defaults to the number of
    rollouts in an evaluation.

    Raises:
        SceneError, WeightsError, RecordingError, SettingError: the scene, scenario or model does
            not exist or does not fit.
    """
    place = load_scene(scene)
    fits = place.protocol.fits
    seeds = fits * place.protocol.rollouts_per_fit if seeds is None else seeds
    if seeds < 1:
        raise SettingError("seeds", got=str(seeds), expected="1 or more")
    fitted = [spawn_model(f"{spawn}+{scenario}", place, fit=k) for k in range(min(fits, seeds))]
    steered = [model for model in fitted if isinstance(model, Steered)]
    models = [steered[seed % fits] for seed in range(seeds)]
    return Steering(
        place,
        models,
        [_episode(model.model, place, seed) for seed, model in enumerate(models)],
        [_episode(model, place, seed) for seed, model in enumerate(models)],
    )


def _episode(model: SpawnModel, scene: Scene, seed: int) -> SpawnEvents:
    warm_up, frames = scene.frames(warm_up_s(scene)), scene.frames(scene.horizon_s)
    events = arrivals(model, scene, seed=seed, world=0, warm_up=warm_up, frames=frames)
    return events[events.time_s >= 0]


def area_changes(found: Steering) -> list[AreaChange]:
    """For each spawn area, the numbers of people, and the shares of usual people who remain."""
    usual = _means([e.spawn_area for e in found.usual_events], found.spawn_areas)
    steered = _means([e.spawn_area for e in found.steered_events], found.spawn_areas)
    centres = [*found.areas.spawn.mean.tolist(), *(a.mean_m for a in found.scenario.add)]
    asked, entries, goals = _asked(found, usual), _remaining(found, _ENTRY), _remaining(found, _ALL)
    return [
        AreaChange(
            k, (float(x), float(y)), float(usual[k]), float(asked[k]), float(steered[k]),
            entries[k], goals[k],
        )
        for k, (x, y) in enumerate(centres)
    ]  # fmt: skip


def _remaining(found: Steering, columns: tuple[str, ...]) -> list[float | None]:
    """Share of each spawn area's people who are also among the steered, to the last bit."""
    kept = [
        before.spawn_area[np.isin(_bytes_of(before, columns), _bytes_of(after, columns))]
        for before, after in zip(found.usual_events, found.steered_events, strict=True)
    ]
    number = found.spawn_areas
    people = _means([e.spawn_area for e in found.usual_events], number)
    share = np.divide(_means(kept, number), people, out=np.zeros(number), where=people > 0)
    return [float(share[k]) if people[k] else None for k in range(number)]


def _bytes_of(events: SpawnEvents, columns: tuple[str, ...]) -> np.ndarray:
    table = np.column_stack([getattr(events, name) for name in columns]).astype(np.float64)
    return np.ascontiguousarray(table).view(f"V{8 * table.shape[1]}").ravel()


def goal_changes(found: Steering) -> list[AreaChange]:
    """For each goal area, the numbers of people who walk to it."""
    areas, number = found.areas, len(found.areas.goal)
    usual = _means([e.goal_area for e in found.usual_events], number)
    steered = _means([e.goal_area for e in found.steered_events], number)
    entered = _means([e.spawn_area for e in found.usual_events], found.spawn_areas)
    flow = np.concatenate(
        [found.scenario.flow(areas), *(row(a.goals, number)[None] for a in found.scenario.add)]
    )
    moved = set(np.flatnonzero((flow[: len(areas.flow)] != areas.flow).any(axis=1)).tolist())
    changed = sorted(moved.union(found.touched))
    # In areas without changes, the people are the same as without the scenario.
    others = [e[~np.isin(e.spawn_area, changed)].goal_area for e in found.usual_events]
    asked = _means(others, number) + _asked(found, entered)[changed] @ flow[changed]
    return [
        AreaChange(g, (x, y), float(usual[g]), float(asked[g]), float(steered[g]))
        for g, (x, y) in enumerate(areas.goal.mean.tolist())
    ]


def _means(areas: list[np.ndarray], number: int) -> Float[np.ndarray, " n"]:
    known = np.concatenate(areas)
    return np.bincount(known[known >= 0], minlength=number) / len(areas)


def _asked(found: Steering, usual: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Number of people of each spawn area that the scenario asks for."""
    asked = usual.copy()
    horizon_s = found.scene.horizon_s
    for change in found.scenario.change:
        asked[change.area] *= total(change.factor, 1.0, horizon_s) / horizon_s
    for k, addition in enumerate(found.scenario.add, len(found.areas.spawn)):
        asked[k] = total(addition.persons_per_min, 0.0, horizon_s) / 60
    return asked


def total(profile: Profile, before: float, horizon_s: float) -> float:
    """The integral of a profile over an episode; its value is `before` until its first step."""
    return TimeChange.of(profile, before, horizon_s).end_s
