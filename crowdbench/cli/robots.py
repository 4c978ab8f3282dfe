"""`crowdbench robots`: compare controllers of robots among people."""

from collections.abc import Sequence
from typing import Any, Literal

from crowdbench.cli.options import Json, SceneName, Workers
from crowdbench.cli.printing import json_written, progress_bar
from crowdbench.cli.running import find_own_code
from crowdbench.report.text.terminal import print_note, print_table

Task = Literal["cross", "patrol", "follow", "stand-aside"]
"""Those of `crowdbench.robot.config`, which is imported when the command runs."""


def robots(
    *,
    scene: SceneName = "eth-v0",
    robot: str = "delivery",
    walkers: str = "social-force",
    controllers: Sequence[str] = ("straight", "orca", "dwa"),
    episodes: int = 500,
    seed: int = 0,
    spawn: str | None = None,
    task: Task = "cross",
    period_s: float | None = None,
    time_limit_s: float | None = None,
    invisible: bool = False,
    costs: bool = False,
    workers: Workers = None,
    json: Json = None,
) -> None:
    """Drive robots among people and compare their controllers.

    All controllers drive the same episodes: the same start, goal and arrivals of people.

    Args:
        robot: a preset: delivery, wheelchair, telepresence or holonomic
        walkers: how people walk: a policy by name, FILE.onnx or pkg.module:Class; or replay, by
            which they walk as they were recorded and cannot react
        controllers: straight, social-force, orca, dwa, a network that ships with the scene,
            FILE.onnx or pkg.module:Class
        episodes: number of episodes of each controller
        seed: seed of the first episode; the others follow
        spawn: spawn model by name (default: ntpp-gmm)
        task: cross the place, patrol between several points, follow a person, or stand aside for
            one who enters
        period_s: time between two actions, a divisor of the scene's frame (default: the frame)
        time_limit_s: time after which an episode ends, in seconds (default: 60)
        invisible: people do not see the robot
        costs: also measure what the robot costs people, in the same worlds without it
    """
    from crowdbench.robot.comparison import compare, printed

    find_own_code()
    given = {"spawn": spawn, "period_s": period_s, "time_limit_s": time_limit_s}
    settings: dict[str, Any] = {name: value for name, value in given.items() if value is not None}
    with json_written(json) as write:
        with progress_bar("episodes"):
            found = compare(
                scene, controllers, robot=robot, walkers=walkers, episodes=episodes, seed=seed,
                workers=workers, task=task, visible=not invisible, costs=costs, **settings,
            )  # fmt: skip
        columns, rows, note = printed(found)
        print_table(*columns, rows=rows)
        print_note(note)
        write(found)
