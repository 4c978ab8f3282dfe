"""Comparison of controllers: the same episodes for each, intervals, and ranks with ties.

Episode e of all controllers has the seed `seed` + e: the same arrivals, start and goal. Each begins
with a crowd of its own. Afterwards the crowds differ as far as people react to the robot.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import msgspec
import numpy as np

from crowdbench import __version__
from crowdbench.errors import OwnCodeError, SettingError
from crowdbench.plugins import blaming
from crowdbench.progress import tell
from crowdbench.robot.config import RobotConfig
from crowdbench.robot.controllers import Controller, controller
from crowdbench.robot.robots import robot_of
from crowdbench.robot.statistics import Estimate, mean, resamples, score, share
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.run.executor import call_each, checked_workers
from crowdbench.scene import Scene, load_scene
from crowdbench.scoring.score import ranks

SCHEMA = 1
BATCH = 100
"""Number of episodes that are driven side by side."""
SHARES = ("success", "collision", "collision_person", "collision_wall", "timeout")
"""Measures that are shown as shares of episodes: of those in which it happened at all."""
OF_SUCCESS = ("time_s", "path_length_m")
"""Measures that are averaged over the episodes in which the robot reached its goal."""
Episodes = dict[str, np.ndarray]
"""The measures of E episodes, each (E,), see `crowdbench.robot.measures.MEASURES`."""


class ControllerResult(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """What a controller achieved."""

    controller: str
    rank: int
    """1 + the number of controllers with a significantly higher share of success."""
    measures: dict[str, Estimate]


class Comparison(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """The results of several controllers in the same episodes."""

    schema: int = SCHEMA
    crowdbench: str
    scene: str
    robot: str
    walkers: str
    spawn: str
    task: str
    visible: bool
    period_s: float
    episodes: int
    seed: int
    """Seed of the first episode."""
    results: tuple[ControllerResult, ...]


def compare(
    scene: str | Path | Scene,
    controllers: Sequence[str | Controller],
    *,
    episodes: int = 500,
    seed: int = 0,
    workers: int | None = None,
    config: RobotConfig | None = None,
    **settings: Any,
) -> Comparison:
    """Let controllers drive the same episodes.

    Args:
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        controllers: names, see `crowdbench.robot.controllers`, or controllers.
        episodes: number of episodes of each.
        seed: seed of the first episode; the others follow.
        workers: number of processes, by default one per core.
        config: settings of the worlds, by default those of `RobotConfig()`.
        settings: fields of `RobotConfig`, which replace those of `config`.

    Returns:
        The results in the order of `controllers`. Shares have Wilson's intervals, means have
        bootstrap intervals over episodes. The ranks compare the shares of success by paired
        differences, at 5 % over all pairs (Holm 1979).

    Raises:
        SceneError, SettingError, WeightsError, RecordingError: a scene, controller, policy, model
            or recording does not exist or does not fit.
        OwnCodeError: a controller of one's own raised an exception, or returned something else
            than finite actions.
    """
    place, chosen = load_scene(scene), RobotConfig.of(config, **settings)
    _check_count("episodes", episodes, 2)
    _check_count("seed", seed, 0)
    names = _checked(controllers, place)
    probe = RobotWorlds(place, 1, chosen)  # reports wrong settings before minutes of driving
    for name in controllers:
        controller(name, place).reset(place, probe.robot, 1, probe.period_s)
    starts = range(0, episodes, BATCH)
    tasks = [
        (one, seed + first, min(BATCH, episodes - first)) for one in controllers for first in starts
    ]
    found: dict[int, Episodes] = {}
    tell("episodes", 0, len(tasks) * BATCH)
    driven = call_each(
        drive, tasks, checked_workers(workers), common=(place, chosen),
        name=lambda one, first, count: f"episodes {first} to {first + count - 1} of {one}",
    )  # fmt: skip
    for done, (index, result) in enumerate(driven, 1):
        found[index] = result
        tell("episodes", done * BATCH, len(tasks) * BATCH)
    each = [
        _joined([found[k * len(starts) + j] for j in range(len(starts))]) for k in range(len(names))
    ]
    return Comparison(
        crowdbench=__version__,
        scene=place.id,
        robot=robot_of(chosen.robot).name,
        walkers=_named(chosen.walkers),
        spawn=probe.crowds.spawn.name,
        task=chosen.task,
        visible=chosen.visible,
        period_s=probe.period_s,
        episodes=episodes,
        seed=seed,
        results=tuple(summarised(names, each, seed)),
    )


def drive(
    named: str | Controller, first: int, count: int, scene: Scene, config: RobotConfig
) -> Episodes:
    """The measures of the episodes with the seeds `first` to `first` + `count` − 1.

    Raises:
        OwnCodeError: a controller of one's own failed.
    """
    driver = controller(named, scene)
    worlds = RobotWorlds(scene, count, config)
    worlds.begin(np.arange(first, first + count))
    driver.reset(scene, worlds.robot, count, worlds.period_s)
    driving, found = np.ones(count, bool), dict[str, np.ndarray]()
    while driving.any():
        step = worlds.step(_actions(driver, worlds))
        over = np.flatnonzero((step.terminated | step.truncated) & driving)
        if len(over):
            for name, values in worlds.results(over).items():
                found.setdefault(name, np.full(count, np.nan))[over] = values
            driving[over] = False
    return found


def summarised(names: Sequence[str], each: Sequence[Episodes], seed: int) -> list[ControllerResult]:
    """The results of controllers whose episodes have the same seeds."""
    drawn = resamples(len(each[0]["success"]), seed)
    placed = ranks([score(of["success"], drawn) for of in each])
    return [
        ControllerResult(controller=name, rank=rank, measures=_estimates(of, drawn))
        for name, rank, of in zip(names, placed, each, strict=True)
    ]


def printed(found: Comparison) -> tuple[list[str], list[list[str]], str]:
    """Columns and rows of the table of a comparison, and the note below it."""
    shown = {name: title for name, title in COLUMNS.items() if name in found.results[0].measures}
    rows = [
        [of.controller, str(of.rank), *(_cell(of.measures[name], name) for name in shown)]
        for of in found.results
    ]
    note = (
        f"{found.episodes} episodes of the robot {found.robot} in {found.scene}, among people who "
        f"walk by {found.walkers}. Intervals are of 95 %. Controllers share a rank unless their "
        "shares of success differ significantly. Times are those of episodes in which the robot "
        "reached its goal."
    )
    return ["controller", "rank", *shown.values()], rows, note


COLUMNS = {
    "success": "success",
    "collision_person": "hits person",
    "collision_wall": "hits wall",
    "timeout": "timeout",
    "time_s": "time, s",
    "spl": "SPL",
    "min_distance_m": "nearest, m",
    "intimate_space_share": "< 0.45 m",
    "personal_space_share": "< 1.2 m",
    "extra_time_s": "people's time, s",
    "extra_path_m": "their path, m",
    "extra_acceleration_mps2": "their acceleration, m/s²",
}
"""The measures that tables show, and their titles there."""
WITH_INTERVAL = ("success", "spl")


def _cell(estimate: Estimate, name: str) -> str:
    if estimate.value is None:
        return "–"
    digits = 1 if name == "time_s" else 2
    text = f"{estimate.value:.{digits}f}"
    if name in WITH_INTERVAL:
        text += f" [{estimate.low:.{digits}f}, {estimate.high:.{digits}f}]"
    return text


def _estimates(of: Episodes, drawn: np.ndarray) -> dict[str, Estimate]:
    arrived = of["success"] > 0
    found = {}
    for name, values in of.items():
        if name in SHARES:
            found[name] = share(int((values > 0).sum()), len(values))
        else:
            counted = np.where(arrived, values, np.nan) if name in OF_SUCCESS else values
            found[name] = mean(counted, drawn)
    return found


def _actions(driver: Controller, worlds: RobotWorlds) -> np.ndarray:
    where = f"controller {driver.name}"
    with blaming(where):
        actions = driver.act(worlds.view)
    expected = f"finite actions of shape ({worlds.worlds}, 2)"
    if np.shape(actions) != (worlds.worlds, 2):
        got = f"an array of shape {np.shape(actions)}"
        raise OwnCodeError(where, got=got, expected=expected)
    if not np.isfinite(actions).all():
        raise OwnCodeError(where, got="actions that are not finite", expected=expected)
    return actions


def _joined(parts: Sequence[Episodes]) -> Episodes:
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _checked(controllers: Sequence[str | Controller], place: Scene) -> list[str]:
    """The names of controllers in tables."""
    if not controllers:
        raise SettingError("controllers", got="none", expected="one or more")
    names = [one if isinstance(one, str) else one.name for one in controllers]
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise SettingError("controllers", got=f"{', '.join(twice)} twice", expected="each once")
    return names


def _check_count(name: str, value: int, least: int) -> None:
    if value < least:
        raise SettingError(name, got=str(value), expected=f"{least} or more")


def _named(walkers: Any) -> str:
    return walkers if isinstance(walkers, str) else walkers.name
