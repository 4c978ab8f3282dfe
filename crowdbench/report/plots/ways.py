"""Ways: who walks from which spawn area to which goal area, and how they walk there in the mean.

A way is a pair of areas that people carry as labels, so that no trajectory has to be clustered.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Bool, Float, Float32, Int

from crowdbench.colours import COLOURS
from crowdbench.report.plots import panels
from crowdbench.report.plots.maps import maps
from crowdbench.scene import Scene
from crowdbench.trajectories.table import OUTCOMES, Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PER_WAY = 12
"""People drawn of each way: more would hide each other."""
LEAST_PEOPLE = 10
"""In a mean: that of fewer says more of them than of the way."""
FRACTIONS = np.linspace(0, 1, 21)
"""Where, along their ways, people are compared."""
_ASTRAY = [OUTCOMES.index(how) for how in ("exit", "timeout")]


Numbers = dict[str, Any]
"""What a figure was drawn from, as JSON holds it."""


@dataclass(frozen=True, eq=False)
class MeanWay:
    """The mean of some people's paths, each taken at `FRACTIONS` of its length."""

    people: int
    mean: Float[np.ndarray, "21 2"]
    """Metres."""
    across_m: Float[np.ndarray, " 21"]
    """Standard deviation of the people to the sides of their mean."""

    def numbers(self) -> Numbers:
        """As JSON holds it, to the centimetre."""
        return {"mean_m": self.mean.round(2).tolist(), "across_m": self.across_m.round(2).tolist()}


def whole(crowd: Trajectories) -> Bool[np.ndarray, " P"]:
    """Who was seen to enter at a known area and to get to one, by the labels they carry."""
    known = (crowd.spawn_area >= 0) & (crowd.goal_area >= 0)
    return crowd.entered & crowd.left & known & ~np.isin(crowd.outcome, _ASTRAY)


def common_ways(crowd: Trajectories, ways: int) -> Int[np.ndarray, "w 2"]:
    """The commonest pairs of spawn and goal area among those who entered and left."""
    known = whole(crowd)
    both = np.stack([crowd.spawn_area[known], crowd.goal_area[known]], axis=1)
    pairs, count = np.unique(both, axis=0, return_counts=True)
    return pairs[np.argsort(-count, kind="stable")[:ways]].astype(np.int64)


def walking(crowd: Trajectories, spawn: int, goal: int) -> Int[np.ndarray, " n"]:
    """Indices of those who were seen to walk all of a way."""
    return np.flatnonzero(whole(crowd) & (crowd.spawn_area == spawn) & (crowd.goal_area == goal))


def entries(crowd: Trajectories) -> list[tuple[float, ...]]:
    """When and where each person was to enter, by which it is known in every crowd.

    Their order differs: who waits for free space comes later.
    """
    return list(zip(crowd.requested_s.tolist(), *crowd.start.T.tolist(), strict=True))


def examples(crowd: Trajectories, ways: Int[np.ndarray, "w 2"]) -> list[list[int]]:
    """Some people of each way, spread over the crowd's time."""
    found = []
    for spawn, goal in ways.tolist():
        who = walking(crowd, spawn, goal)
        chosen = np.linspace(0, len(who) - 1, min(PER_WAY, len(who))).round().astype(int)
        found.append(who[chosen].tolist())
    return found


def by_fraction(path: Float32[np.ndarray, "n 2"]) -> Float[np.ndarray, "21 2"]:
    """Where a path is at `FRACTIONS` of its length, metres."""
    steps = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.r_[0.0, steps.cumsum(dtype=np.float64)]
    return np.stack([np.interp(FRACTIONS * along[-1], along, path[:, k]) for k in (0, 1)], axis=1)


def mean_way(paths: Sequence[Float32[np.ndarray, "_ 2"]]) -> MeanWay:
    """The mean of one path or more.

    It need not be walkable: of people who pass an obstacle on both sides it leads through it.
    """
    each = np.stack([by_fraction(path) for path in paths])
    mean = each.mean(axis=0)
    return MeanWay(len(paths), mean, np.einsum("nfk,fk->nf", each - mean, sides(mean)).std(axis=0))


def sides(way: Float[np.ndarray, "21 2"]) -> Float[np.ndarray, "21 2"]:
    """Unit vectors to the left of a way; zeros where it stands still."""
    ahead = np.gradient(way, axis=0)
    length = np.linalg.norm(ahead, axis=1, keepdims=True)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1)
    return np.divide(left, length, out=np.zeros_like(left), where=length > 0)


def draw_ways(
    scene: Scene, recording: Trajectories, walked: Sequence[tuple[str, Trajectories]]
) -> bytes:
    """The same people of the commonest ways, as recorded and as they were walked, by title."""
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
