"""Figure `flows`: density and mean paths to the goals of the people from each spawn area.

People are grouped by the spawn and goal areas that the simulation assigned to them.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from crowdbench.colours import COLOURS, goal_colour
from crowdbench.data.table import Trajectories
from crowdbench.report.plots import panels
from crowdbench.scene import Scene
from crowdbench.spawn.areas import Areas
from studies.figures.maps import maps
from studies.figures.ways import LEAST_PEOPLE, MeanWay, Numbers, mean_way, sides, walking

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MOST_AREAS = 6
"""Maximum number of maps: those of the busiest spawn areas are drawn."""
LEAST_SHARE = 0.03
"""Minimum share of a spawn area's people for a route to be drawn."""
DENSITY_PARTS = 100_000
"""Factor by which densities are multiplied in the JSON file, to be rounded to integers."""
_THINNEST, _WIDEST = 1.1, 5.0
_LABEL = (0.1, 0.045)
"""Width and height of a label, as fractions of the width of a map."""
_WALLS = "#e6ddcf"
"""Colour of walls, distinct from the greys of the density."""


@dataclass(frozen=True, eq=False)
class Outflow:
    """The flows of the people from one spawn area."""

    area: int
    people: Int[np.ndarray, " G"]
    """Number of people who enter, by goal area."""
    density: Float[np.ndarray, "Y X"]
    """Share of their time in each cell of `CELL_M`; the first cell is at the lowest x and y."""
    ways: dict[int, MeanWay]
    """Mean path of those who arrive, by goal area, if they are ten or more."""
    recorded: dict[int, MeanWay]
    """The same for the recording."""

    @classmethod
    def of(
        cls,
        area: int,
        crowds: Sequence[Trajectories],
        scene: Scene,
        goals: int,
        recording: Trajectories | None,
    ) -> "Outflow":
        """Compute the flows of one spawn area from all rollouts together."""
        people = np.zeros(goals, dtype=np.int64)
        for crowd in crowds:
            known = crowd.entered & (crowd.spawn_area == area) & (crowd.goal_area >= 0)
            people += np.bincount(crowd.goal_area[known], minlength=goals)
        recorded = {} if recording is None else _mean_ways([recording], area, goals)
        return cls(
            area, people, density(crowds, area, scene), _mean_ways(crowds, area, goals), recorded
        )

    @property
    def share(self) -> Float[np.ndarray, " G"]:
        """P(goal area | spawn area)."""
        return self.people / max(1, self.people.sum())

    @property
    def drawn(self) -> list[int]:
        """Goal areas whose mean paths are drawn."""
        return [g for g in self.ways if self.share[g] >= LEAST_SHARE]

    def numbers(self) -> Numbers:
        """The flows for JSON."""
        cells = (DENSITY_PARTS * self.density).round().astype(np.int64)
        return {
            "spawn_area": self.area,
            "people": int(self.people.sum()),
            "density": cells.tolist(),
            "flows": [
                {"goal_area": g, "people": int(n), "share": round(float(self.share[g]), 5)}
                | ({"simulated": self.ways[g].numbers()} if g in self.ways else {})
                | ({"recorded": self.recorded[g].numbers()} if g in self.recorded else {})
                for g, n in enumerate(self.people)
                if n
            ],
        }


def draw_flows(
    scene: Scene,
    areas: Areas,
    crowds: Sequence[Trajectories],
    recording: Trajectories | None,
    title: str,
) -> tuple[bytes, Numbers]:
    """The picture and its numbers, of all rollouts together; `title` names them.

    With a recording, its mean paths are shown for comparison.
    """
    spawns, goals = len(areas.spawn), len(areas.goal)
    entered = np.sum([np.bincount(c.spawn_area[c.entered], minlength=spawns) for c in crowds], 0)
    busiest = np.argsort(-entered, kind="stable")[:MOST_AREAS].tolist()
    found = [Outflow.of(k, crowds, scene, goals, recording) for k in busiest]
    shown = []
    for flow in found:
        head = f"spawn area {flow.area}: {_percent(entered[flow.area] / entered.sum())} of people"
        rest = 1 - flow.share[flow.drawn].sum()
        if rest >= 0.005:
            head += f"; {_percent(rest)} not drawn"
        shown.append((head, partial(_map, scene=scene, areas=areas, flow=flow)))
    left_out = spawns - len(busiest)
    their_share = 1 - float(entered[busiest].sum() / entered.sum())
    handles = [*_key(recording is not None), _words(f"{title}, {len(crowds)} rollouts")]
    if left_out:
        more = f"{left_out} more spawn areas" if left_out > 1 else "1 more spawn area"
        handles.append(_words(f"{more}, {_percent(their_share)} of people: not shown"))
    columns = 3 if len(shown) > 4 else 2
    picture = maps(
        scene, shown, width=3.3, columns=columns, handles=handles, legend_columns=columns
    )
    return picture, {
        "people": int(entered.sum()),
        "rollouts": len(crowds),
        "spawn_areas_left_out": left_out,
        "their_share_of_people": round(their_share, 4),
        "cell_m": panels.CELL_M,
        "density_parts": DENSITY_PARTS,
        "density_from_m": [scene.bounds.x_min_m, scene.bounds.y_min_m],
        "areas": [flow.numbers() for flow in found],
    }


def density(crowds: Sequence[Trajectories], area: int, scene: Scene) -> Float[np.ndarray, "Y X"]:
    """Share of time that people from `area` spend in each cell of `CELL_M`; sums to 1."""
    theirs = [(c.entered & (c.spawn_area == area))[c.row_person()] for c in crowds]
    xy = np.concatenate([crowd.xy[rows] for crowd, rows in zip(crowds, theirs, strict=True)])
    found = panels.in_cells(xy, scene)
    return found / max(1.0, found.sum())


def _mean_ways(crowds: Sequence[Trajectories], area: int, goals: int) -> dict[int, MeanWay]:
    found = {}
    for g in range(goals):
        paths = [crowd.path(p) for crowd in crowds for p in walking(crowd, area, g).tolist()]
        if len(paths) >= LEAST_PEOPLE:
            found[g] = mean_way(paths)
    return found


def _map(axis: "Axes", scene: Scene, areas: Areas, flow: Outflow) -> None:
    from matplotlib.colors import PowerNorm
    from matplotlib.patheffects import withStroke

    norm = PowerNorm(0.4, vmin=0, vmax=flow.density.max())
    panels.draw_cells(axis, np.ma.masked_equal(flow.density, 0), scene, cmap="Greys", norm=norm)
    panels.place(axis, scene, fill=_WALLS)
    labels: list[np.ndarray] = []
    for g in sorted(flow.drawn, key=lambda g: -flow.share[g]):
        way, colour = flow.ways[g], goal_colour(g)
        aside = way.across_m[:, None] * sides(way.mean)
        axis.fill(*np.concatenate([way.mean + aside, (way.mean - aside)[::-1]]).T, color=colour,
                  alpha=0.25, linewidth=0)  # fmt: skip
        width = _THINNEST + (_WIDEST - _THINNEST) * float(flow.share[g])
        axis.plot(*way.mean.T, color=colour, linewidth=width, solid_capstyle="round",
                  path_effects=[withStroke(linewidth=width + 0.8, foreground="white")])  # fmt: skip
        if g in flow.recorded:
            axis.plot(*flow.recorded[g].mean.T, color="black", linewidth=0.9, linestyle="--")
        panels.ellipse(axis, areas.goal, g, color=colour, linewidth=1.0)
        labels.append(_free(way.mean, labels, scene))
        x, y = labels[-1]
        axis.text(x, y, _percent(flow.share[g]), fontsize=7, ha="center", va="center",
                  path_effects=[withStroke(linewidth=2.5, foreground="white")], clip_on=True,
                  zorder=4)  # fmt: skip
    panels.ellipse(axis, areas.spawn, flow.area, color="black", linewidth=1.2)


def _free(
    way: Float[np.ndarray, "n 2"], labels: Sequence[np.ndarray], scene: Scene
) -> Float[np.ndarray, " 2"]:
    """The point of a path closest to its end that overlaps no other label."""
    room = np.array([_LABEL[0], _LABEL[1]]) * (scene.bounds.x_max_m - scene.bounds.x_min_m)
    for place in way[::-1]:
        if all((np.abs(place - label) > room).any() for label in labels):
            return place
    return way[-1]


def _words(label: str) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle="", label=label)


def _key(with_recording: bool) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = [
        Line2D([], [], color="black", linewidth=1.2, label="spawn area, 2 σ"),
        Line2D([], [], color=COLOURS[0], linewidth=3.0, label="mean way, as wide as it is common"),
        Patch(color=COLOURS[0], alpha=0.25, linewidth=0, label="standard deviation to its sides"),
        Line2D([], [], color=COLOURS[0], linewidth=1.0, label="goal area, 2 σ"),
        Patch(color="0.5", linewidth=0, label="where people are (darker: more of the time)"),
    ]
    if with_recording:
        handles.append(
            Line2D([], [], color="black", linewidth=0.9, linestyle="--", label="mean way, recorded")
        )
    return handles


def _percent(share: float) -> str:
    return f"{100 * share:.0f} %"
