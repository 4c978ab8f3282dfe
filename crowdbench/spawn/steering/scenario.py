"""Scenarios: changes of a scene's arrivals, as a small TOML file or as Python objects.

    schema = 1
    scene = "gc-v0"
    closed_goals = [7]                      # nobody walks to goal area 7

    [[change]]                              # change spawn area 3:
    area = 3
    factor = [[600, 3], [1200, 1]]          # three times the rate from 600 s to 1200 s
    goals = { 0 = 0.8, 2 = 0.2 }            # other goals

    [[add]]                                 # an additional spawn area
    mean_m = [20.0, 30.0]
    sd_m = [0.5, 1.0]
    persons_per_min = 12
    goals = { 0 = 1 }

`crowdbench spawn areas` prints the numbers of a scene's areas. Times are relative to the start of
the episode; the values at its start also apply during the warm-up before it.
"""

import math
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np
from jaxtyping import Float

from crowdbench.errors import SettingError
from crowdbench.files import read_struct
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas, Gaussians
from crowdbench.spawn.plans.planned import PlannedAreas

SCHEMA = 1
_LIMITS = {
    "factor": (0.0, 100.0),
    "shift_s": (-86_400.0, 86_400.0),
    "group_size": (1.0, 100.0),
    "stop": (0.0, 1.0),
    "wait_s": (4.0, 86_400.0),
    "sd_m": (0.01, 1_000.0),
    "persons_per_min": (0.0, 6_000.0),
}
"""Smallest and largest values of the numbers of changes and additions."""
MOST_ADDED = 100
"""Largest number of additional areas."""
_PROFILES = ("factor", "persons_per_min")
_HINT = "Compare with the scenarios in docs/steering.md."

Number = float | int
Steps = tuple[tuple[Number, Number], ...]
"""Pairs of a time in seconds and the value from that time on."""
Profile = Number | Steps
Goals = Mapping[int, Number]
"""P(goal area); goal areas that are not named have probability 0."""


class Change(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A change of one of the scene's spawn areas."""

    area: int
    factor: Profile = 1.0
    """Factor of the area's rate; 1 before the first step, 0 closes the area."""
    shift_s: Number = 0.0
    """Delay of the area's arrivals in seconds, applied before `factor`; negative means earlier."""
    goals: dict[int, Number] | None = None
    """P(goal | this area), with sum 1; None keeps the scene's probabilities."""
    group_size: Number | None = None
    """Mean size of groups, counting people who are alone as one."""
    stop: Number | None = None
    """P(a person stops on its way)."""
    wait_s: Number | None = None
    """Mean wait of those who stop, seconds."""

    @property
    def retimes(self) -> bool:
        """Whether it changes when people enter."""
        return self.factor != 1 or self.shift_s != 0

    @property
    def of_plans(self) -> list[str]:
        """Names of the changes that only models of plans understand."""
        names = ("group_size", "stop", "wait_s")
        return [name for name in names if getattr(self, name) is not None]


class Addition(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """An additional spawn area, with Poisson arrivals of groups and the scene's speeds."""

    mean_m: tuple[Number, Number]
    """Mean of the starts (x, y), metres."""
    sd_m: tuple[Number, Number]
    """Standard deviations of the starts in x and y, metres."""
    persons_per_min: Profile
    """Expected persons per minute; 0 before the first step."""
    group_size: Number = 1.0
    """Mean group size; sizes are geometric."""
    goals: dict[int, Number]
    """P(goal | this area), with sum 1."""

    def gaussian(self) -> Gaussians:
        """The area."""
        covariance = np.diag(np.square(self.sd_m, dtype=np.float64))
        return Gaussians(np.array([self.mean_m], dtype=np.float64), covariance[None])


class _Changes(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    scene: str
    closed_goals: tuple[int, ...] = ()
    """Goal areas that nobody walks to. Their probability is distributed proportionally over the
    other goals of each spawn area."""
    change: tuple[Change, ...] = ()
    add: tuple[Addition, ...] = ()


class _File(_Changes, frozen=True, kw_only=True):
    schema: int


class Scenario(_Changes, frozen=True, kw_only=True):
    """Changes of a scene's arrivals, applied to a model by `spawn_model(…, scenario=…)`.

    Added areas get the numbers after the scene's last spawn area.
    """

    name: str

    def flow(self, areas: Areas) -> Float[np.ndarray, "K G"]:
        """P(goal area | spawn area) for the scene's spawn areas under this scenario."""
        flow = areas.flow.copy()
        for change in self.change:
            if change.goals is not None:
                flow[change.area] = row(change.goals, len(areas.goal))
        closed = flow[:, list(self.closed_goals)].sum(axis=1) > 0
        flow[:, list(self.closed_goals)] = 0
        flow[closed] /= flow[closed].sum(axis=1, keepdims=True)
        return flow


def steps_of(profile: Profile) -> Steps:
    """The steps of a profile; a constant is one step at 0 s."""
    return ((0.0, profile),) if isinstance(profile, Number) else profile


def row(goals: Goals, number: int) -> Float[np.ndarray, " G"]:
    """The probabilities of all goal areas as an array, normalised to sum 1."""
    found = np.zeros(number)
    found[list(goals)] = list(goals.values())
    return found / found.sum()


def split_scenario(named: str) -> tuple[str, Path | None]:
    """Split MODEL+FILE.toml into the name of the spawn model and the scenario's file.

    The file is None if there is no scenario. The name of an existing folder is not split, even if
    it contains a plus sign.
    """
    if Path(named).is_dir():
        return named, None
    model, plus, file = named.partition("+")
    return model, Path(file) if plus else None


def read_scenario(path: Path, scene: Scene, areas: Areas) -> Scenario:
    """Read a scenario from a file and check it; its name is that of the file without suffix.

    Raises:
        SettingError: the file is missing or broken, has another schema, or does not fit the scene.
    """
    file = read_struct(path, _File, SettingError, _HINT)
    if file.schema != SCHEMA:
        raise SettingError(
            path, got=f"schema = {file.schema}", expected=f"schema = {SCHEMA}", hint=_HINT
        )
    changes = {name: getattr(file, name) for name in _Changes.__struct_fields__}
    scenario = Scenario(name=path.stem, **changes)
    check_scenario(scenario, scene, areas, str(path))
    return scenario


def check_scenario(scenario: Scenario, scene: Scene, areas: Areas, where: str) -> None:
    """Check that a scenario fits a scene and is consistent; `where` names its source in messages.

    Raises:
        SettingError: it names another scene, an area that does not exist, or an area twice; a
            factor, rate, size or probability is out of range; or it leaves people without a goal.
    """
    if scenario.scene != scene.id:
        got = repr(scenario.scene)
        hint = "The numbers of areas differ between scenes."
        raise SettingError(f"{where}, scene", got=got, expected=repr(scene.id), hint=hint)
    for goal in scenario.closed_goals:
        _check_area(goal, len(areas.goal), "goal", f"{where}, closed_goals", scene)
    for k, change in enumerate(scenario.change, 1):
        at = f"{where}, change {k}"
        _check_area(change.area, len(areas.spawn), "spawn", f"{at}, area", scene)
        if change.area in [c.area for c in scenario.change[: k - 1]]:
            got = f"spawn area {change.area} a second time"
            expected = "at most one [[change]] per area"
            hint = "Combine them into one."
            raise SettingError(f"{at}, area", got=got, expected=expected, hint=hint)
        at = f"{at} (area {change.area})"
        _check_numbers(change, at)
        if change.goals is not None:
            _check_goals(change.goals, scenario, areas, f"{at}, goals", scene)
        if change.of_plans and not isinstance(areas, PlannedAreas):
            got = "a model of people who come alone and do not stop"
            expected = "a model of plans, such as ntpp-plans or cox-plans"
            raise SettingError(f"{at}, {change.of_plans[0]}", got=got, expected=expected)
        stops = {"stop", "wait_s"} & set(change.of_plans)
        if stops and isinstance(areas, PlannedAreas) and len(areas.ways.stop_mean) == 0:
            got = f"a change of stops on {areas.scene}, where too few recorded people stop"
            expected = "a scene whose model knows places of stops"
            raise SettingError(f"{at}, stop", got=got, expected=expected)
    if len(scenario.add) > MOST_ADDED:
        got = f"{len(scenario.add)} additional areas"
        raise SettingError(f"{where}, add", got=got, expected=f"at most {MOST_ADDED}")
    for k, addition in enumerate(scenario.add, 1):
        at = f"{where}, add {k}"
        if not scene.walkable(np.array([addition.mean_m], dtype=np.float64))[0]:
            b = scene.bounds
            raise SettingError(
                f"{at}, mean_m",
                got=f"{list(addition.mean_m)}, outside the bounds of {scene.id} or in a wall",
                expected=f"a place where people can walk, x from {b.x_min_m:g} to {b.x_max_m:g} "
                f"and y from {b.y_min_m:g} to {b.y_max_m:g}",
            )
        _check_numbers(addition, at)
        _check_goals(addition.goals, scenario, areas, f"{at}, goals", scene)
    named = [change.area for change in scenario.change if change.goals is not None]
    others = np.delete(areas.flow, list(set(scenario.closed_goals)), axis=1).sum(axis=1)
    stuck = [k for k in np.flatnonzero(others <= 0).tolist() if k not in named]
    if stuck:
        got = f"all goals of spawn area {', '.join(map(str, stuck))}"
        expected = "at least one open goal for each spawn area"
        hint = "Define `goals` for these areas in a [[change]]."
        raise SettingError(f"{where}, closed_goals", got=got, expected=expected, hint=hint)


def _check_area(area: int, number: int, kind: str, where: str, scene: Scene) -> None:
    if not 0 <= area < number:
        expected = f"one of the {number} {kind} areas of {scene.id}, 0 to {number - 1}"
        hint = f"See `crowdbench spawn areas {scene.asked}`."
        raise SettingError(where, got=f"{kind} area {area}", expected=expected, hint=hint)


def _check_numbers(of: Change | Addition, where: str) -> None:
    for name in (name for name in _LIMITS if getattr(of, name, None) is not None):
        value, at = getattr(of, name), f"{where}, {name}"
        numbers = [value] if isinstance(value, Number) else value
        if name in _PROFILES:
            steps = steps_of(value)
            times, numbers = [time_s for time_s, _ in steps], [number for _, number in steps]
            finite = all(math.isfinite(time_s) and time_s >= 0 for time_s in times)
            ascending = all(a < b for a, b in pairwise(times))
            if not (times and finite and ascending):
                got = f"times {times}" if times else "no steps"
                expected = "pairs [time_s, number] with ascending times ≥ 0 s"
                raise SettingError(at, got=got, expected=expected)
        for number in numbers:
            _check_range(number, *_LIMITS[name], at)


def _check_range(value: Number, least: float, most: float, where: str) -> None:
    if not (math.isfinite(value) and least <= value <= most):
        raise SettingError(where, got=f"{value:g}", expected=f"{least:g} to {most:g}")


def _check_goals(goals: Goals, scenario: Scenario, areas: Areas, where: str, scene: Scene) -> None:
    for goal, share in goals.items():
        _check_area(goal, len(areas.goal), "goal", where, scene)
        _check_range(share, 0.0, 1.0, f"{where}, {goal}")
        if share > 0 and goal in scenario.closed_goals:
            got = f"probability {share:g} for a goal in closed_goals"
            expected = "positive probabilities for open goals only"
            raise SettingError(f"{where}, {goal}", got=got, expected=expected)
    total = math.fsum(goals.values())
    if abs(total - 1) > 1e-6:
        got = f"probabilities that sum to {total:g}"
        hint = "Goals that are not listed have probability 0."
        raise SettingError(where, got=got, expected="a sum of 1", hint=hint)
