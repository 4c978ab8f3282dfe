"""Pictures of the page on controllers of robots."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.colours import COLOURS
from crowdbench.files import replacing
from crowdbench.report.plots.canvas import picture
from crowdbench.robot.comparison import Comparison
from crowdbench.robot.controllers import controller
from crowdbench.robot.drawing import RobotPictures
from crowdbench.robot.record import EpisodeRecorder, RobotEpisode
from crowdbench.robot.worlds import RobotWorlds
from crowdbench.scene import Scene

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SEEDS = range(50)
"""Seeds among which the episode that is drawn is chosen."""
Driven = tuple[RobotEpisode, Mapping[str, float]]


def write_pictures(
    folder: Path, found: Mapping[str, Comparison], people: Mapping[str, str], scene: Scene
) -> None:
    """Write `success.png` and `episode.png`.

    `found` maps kinds of people to comparisons, and `people` to what they are called.
    """
    names = [of.controller for of in next(iter(found.values())).results]
    drawn = {"success.png": success(found, people), "episode.png": episode(scene, names)}
    for name, data in drawn.items():
        with replacing(folder / name) as temporary:
            temporary.write_bytes(data)


def success(found: Mapping[str, Comparison], people: Mapping[str, str]) -> bytes:
    """Shares of success by kind of people, a colour for each controller."""

    def draw(axes: "list[Axes]") -> None:
        for k, of in enumerate(next(iter(found.values())).results):
            shares = [one.results[k].measures["success"] for one in found.values()]
            value, low, high = np.array([[s.value, s.low, s.high] for s in shares], float).T
            x = np.arange(len(value)) + 0.12 * (k - 2)
            error = [value - low, high - value]
            colour = COLOURS[k % len(COLOURS)]
            axes[0].errorbar(x, value, error, fmt="o-", color=colour, lw=1, label=of.controller)
        axes[0].set_xticks(range(len(found)), [_label(people[name]) for name in found])
        axes[0].set_ylabel("share of episodes with success")
        axes[0].legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=5)

    return picture(draw, width=7.0, height=3.6, kind="small png")


def episode(scene: Scene, names: Sequence[str]) -> bytes:
    """The same episode by each controller, at its end.

    It is the first one in which `straight` fails and all others succeed, or else `straight` fails.
    """
    driven = None
    for seed in SEEDS:
        tried = {"straight": _driven(scene, "straight", seed)}
        if tried["straight"][1]["success"]:
            continue
        tried |= {name: _driven(scene, name, seed) for name in names if name != "straight"}
        driven = driven or tried
        if sum(result["success"] for _, result in tried.values()) == len(tried) - 1:
            driven = tried
            break
    shown = {} if driven is None else driven
    pictures = RobotPictures(scene)

    def draw(axes: "list[Axes]") -> None:
        for ax in axes:
            ax.set_axis_off()
        for ax, (name, (recorded, result)) in zip(axes, shown.items(), strict=False):
            ax.imshow(pictures.draw(recorded))
            ax.set_title(f"{name}: {_end(result)} after {result['time_s']:.1f} s")

    return picture(
        draw, width=9.0, height=6.0, rows=2, columns=-(-len(shown) // 2), kind="small png"
    )


def _label(people: str) -> str:
    return f"people\n{people.replace('`', '')}"


def _driven(scene: Scene, name: str, seed: int) -> Driven:
    """An episode among people driven by social forces, and its measures."""
    worlds, driver = RobotWorlds(scene, 1), controller(name, scene)
    recorder = EpisodeRecorder(worlds)
    worlds.begin(np.array([seed]))
    driver.reset(scene, worlds.robot, 1, worlds.period_s)
    recorder.begin()
    over = False
    while not over:
        step = worlds.step(driver.act(worlds.view))
        recorder.write()
        over = bool(step.terminated[0] or step.truncated[0])
    results = worlds.results(np.array([0]))
    return recorder.episode(), {key: float(values[0]) for key, values in results.items()}


def _end(result: Mapping[str, float]) -> str:
    if result["success"]:
        return "at its goal"
    if result["collision_person"]:
        return "touches a person"
    return "touches a wall" if result["collision_wall"] else "time is up"
