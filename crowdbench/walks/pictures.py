"""The page's pictures of a scene: ways by spawn and goal area, and dwell times."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Int

from crowdbench.figures import draw_figure, panels
from crowdbench.figures.canvas import picture
from crowdbench.figures.sight import COLOURS, Crowds, Sight
from crowdbench.files import replacing
from crowdbench.reference import Reference
from crowdbench.scene import Scene
from crowdbench.trajectories import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LEFT_OUT = ("random",)
"""Whose ways are a tangle, and whose dwell times are the scene's patience."""
PER_WAY = 12
"""People drawn of each way: more would hide each other."""
COLUMNS = 4


def draw_pictures(
    scene: Scene,
    reference: Reference,
    crowds: Crowds,
    names: Mapping[str, str],
    recording: Trajectories,
    folder: Path,
) -> None:
    """Draw `<scene>-paths.png` and `<scene>-dwell.png` into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    shown = {key: crowd for key, crowd in crowds.items() if key[1] not in LEFT_OUT}
    sight = Sight.of(scene, reference, shown, "full", recording)
    # One spawn model: the colour tells the policy.
    groups = [
        replace(group, spawn="", policy=names[group.policy], dashes=(),
                colour=COLOURS[k % len(COLOURS)])
        for k, group in enumerate(sight.groups)
    ]  # fmt: skip
    sight = replace(sight, groups=groups)
    draw_figure("dwell.png", sight, folder, named=f"{scene.id}-dwell.png")
    with replacing(folder / f"{scene.id}-paths.png") as temporary:
        temporary.write_bytes(_ways(sight))


def common_ways(crowd: Trajectories, ways: int) -> Int[np.ndarray, "w 2"]:
    """The commonest pairs of spawn and goal area among those who entered and left."""
    known = crowd.entered & crowd.left & (crowd.spawn_area >= 0) & (crowd.goal_area >= 0)
    both = np.stack([crowd.spawn_area[known], crowd.goal_area[known]], axis=1)
    pairs, count = np.unique(both, axis=0, return_counts=True)
    return pairs[np.argsort(-count, kind="stable")[:ways]].astype(np.int64)


def _ways(sight: Sight) -> bytes:
    assert sight.recording is not None
    ways = common_ways(sight.recording, len(COLOURS))
    people, entries = _people(sight.recording, ways), _entries(sight.recording)
    shown = [("recorded", sight.recording), *((g.policy, g.crowds[0]) for g in sight.groups)]
    b = sight.scene.bounds
    columns = min(COLUMNS, len(shown))
    rows = -(-len(shown) // columns)
    width = 2.8
    height = width * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + 0.5

    def draw(axes: "list[Axes]") -> None:
        for axis in axes[len(shown) :]:
            axis.set_visible(False)
        for k, (axis, (label, crowd)) in enumerate(zip(axes, shown, strict=False)):
            panels.place(axis, sight.scene)
            index = {of: k for k, of in enumerate(_entries(crowd))}
            for colour, of_way in zip(COLOURS, people, strict=False):
                for person in of_way:
                    if (at := index.get(entries[person])) is not None:
                        axis.plot(*crowd.path(at).T, color=colour, linewidth=0.8, alpha=0.7)
            axis.set_title(label, fontsize=9)
            axis.set_ylabel("y (m)" if k % columns == 0 else "")
            below = k + columns < len(shown)
            axis.set_xlabel("" if below else "x (m)")
            axis.tick_params(labelbottom=not below)

    size = {"width": width * columns + 0.6, "height": height * rows + 0.3}
    return picture(draw, **size, rows=rows, columns=columns, kind="small png")


def _entries(crowd: Trajectories) -> list[tuple[float, ...]]:
    """When and where each person was to enter, by which it is known in every crowd.

    Their order differs: who waits for free space comes later.
    """
    return list(zip(crowd.requested_s.tolist(), *crowd.start.T.tolist(), strict=True))


def _people(crowd: Trajectories, ways: Int[np.ndarray, "w 2"]) -> list[list[int]]:
    """Some people of each way, spread over the recording."""
    found = []
    for spawn, goal in ways.tolist():
        there = (crowd.spawn_area == spawn) & (crowd.goal_area == goal)
        who = np.flatnonzero(there & crowd.entered & crowd.left)
        chosen = np.linspace(0, len(who) - 1, min(PER_WAY, len(who))).round().astype(int)
        found.append(who[chosen].tolist())
    return found
