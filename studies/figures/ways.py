"""Routes (`ways`): the people from one spawn area to one goal area, and their mean path.

People carry the labels of their areas, so that no trajectories have to be clustered.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.colours import COLOURS
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.report.plots import panels
from crowdbench.scene import Scene
from studies.figures.maps import maps

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PER_WAY = 12
"""Maximum number of people drawn per route; more would hide each other."""
LEAST_PEOPLE = 10
"""Minimum number of people in a mean path; fewer would be identifiable."""
FRACTIONS = np.linspace(0, 1, 21)
"""Fractions of the path length at which positions are compared."""
_ASTRAY = [OUTCOMES.index(how) for how in ("exit", "timeout")]


Numbers = dict[str, Any]
"""The numbers behind a figure, as written to JSON."""


@dataclass(frozen=True, eq=False)
class MeanWay:
    """The mean of several paths, each evaluated at `FRACTIONS` of its length."""

    people: int
    mean: Float[np.ndarray, "21 2"]
    """Positions, metres."""
    across_m: Float[np.ndarray, " 21"]
    """Standard deviation perpendicular to the mean path, metres."""

    def numbers(self) -> Numbers:
        """The mean path for JSON, rounded to centimetres."""
        return {"mean_m": self.mean.round(2).tolist(), "across_m": self.across_m.round(2).tolist()}


def whole(crowd: Trajectories) -> Bool[np.ndarray, " P"]:
    """Whether each person entered at a known spawn area and reached a known goal area."""
    known = (crowd.spawn_area >= 0) & (crowd.goal_area >= 0)
    return crowd.entered & crowd.left & known & ~np.isin(crowd.outcome, _ASTRAY)


def common_ways(crowd: Trajectories, ways: int) -> Int[np.ndarray, "w 2"]:
    """The `ways` most common pairs of spawn and goal area among complete trips."""
    known = whole(crowd)
    both = np.stack([crowd.spawn_area[known], crowd.goal_area[known]], axis=1)
    pairs, count = np.unique(both, axis=0, return_counts=True)
    return pairs[np.argsort(-count, kind="stable")[:ways]].astype(np.int64)


def walking(crowd: Trajectories, spawn: int, goal: int) -> Int[np.ndarray, " n"]:
    """Indices of the people with a complete trip from area `spawn` to area `goal`."""
    return np.flatnonzero(whole(crowd) & (crowd.spawn_area == spawn) & (crowd.goal_area == goal))


def entries(crowd: Trajectories) -> list[tuple[float, ...]]:
    """Requested time and place of each person's entry, which identify the person in every crowd.

    Indices differ between crowds: a person who has to wait for free space enters later.
    """
    return list(zip(crowd.requested_s.tolist(), *crowd.start.T.tolist(), strict=True))


def examples(crowd: Trajectories, ways: Int[np.ndarray, "w 2"]) -> list[list[int]]:
    """Indices of up to `PER_WAY` people of each route, spread over time."""
    found = []
    for spawn, goal in ways.tolist():
        who = walking(crowd, spawn, goal)
        chosen = np.linspace(0, len(who) - 1, min(PER_WAY, len(who))).round().astype(int)
        found.append(who[chosen].tolist())
    return found


def by_fraction(path: Float32[np.ndarray, "n 2"]) -> Float[np.ndarray, "21 2"]:
    """Positions of a path at `FRACTIONS` of its length, metres."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.r_[0.0, steps.cumsum(dtype=np.float64)]
    return np.stack([np.interp(FRACTIONS * along[-1], along, path[:, k]) for k in (0, 1)], axis=1)


def mean_way(paths: Sequence[Float32[np.ndarray, "_ 2"]]) -> MeanWay:
    """The mean of one or more paths.

    It may be impossible to walk: if people pass an obstacle on both sides, it leads through the
    obstacle.
    """
    each = np.stack([by_fraction(path) for path in paths])
    mean = each.mean(axis=0)
    return MeanWay(len(paths), mean, np.einsum("nfk,fk->nf", each - mean, sides(mean)).std(axis=0))


def sides(way: Float[np.ndarray, "21 2"]) -> Float[np.ndarray, "21 2"]:
    """Unit vectors to the left of a path; zero where it does not move."""
    ahead = np.gradient(way, axis=0)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    return np.divide(left, length, out=np.zeros_like(left), where=length > 0)


def draw_ways(
    scene: Scene, recording: Trajectories, walked: Sequence[tuple[str, Trajectories]]
) -> bytes:
    """Bytes of maps with the same people's recorded paths and the paths in `walked`, by title."""
    from matplotlib.lines import Line2D

    ways = common_ways(recording, len(COLOURS))
    people, known = examples(recording, ways), entries(recording)

    def draw(axis: "Axes", crowd: Trajectories) -> None:
        panels.place(axis, scene)
        index = {of: k for k, of in enumerate(entries(crowd))}
        for colour, of_way in zip(COLOURS, people, strict=False):
            for person in of_way:
                if (at := index.get(known[person])) is not None:
                    axis.plot(*crowd.path(at).T, color=colour, linewidth=0.8, alpha=0.7)

    shown = [
        (title, partial(draw, crowd=crowd)) for title, crowd in [("recorded", recording), *walked]
    ]
    handles = [
        Line2D(
            [],
            [],
            color=colour,
            label=f"spawn area {k} → goal area {g}: {len(walking(recording, k, g))} people",
        )
        for colour, (k, g) in zip(COLOURS, ways.tolist(), strict=False)
    ]
    return maps(scene, shown, width=2.8, columns=4, handles=handles, legend_columns=3)
