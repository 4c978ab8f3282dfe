"""Maps of a scene's numbered areas, and of the density that a scenario changes."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from crowdbench.colours import COLOURS
from crowdbench.data.table import Trajectories
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import Draw, picture
from crowdbench.report.plots.cells import CELL_M, draw_cells, in_cells
from crowdbench.report.steering.changes import Steering
from crowdbench.scene import Scene
from crowdbench.spawn import Areas
from crowdbench.spawn.areas import Gaussians

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_WIDTH = 4.2
SPAWN, GOAL = "black", COLOURS[0]


def areas_picture(scene: Scene, areas: Areas) -> bytes:
    """Bytes of maps with the numbered spawn areas and goal areas."""

    def draw(axes: "list[Axes]") -> None:
        for axis, gaussians, colour, title in (
            (axes[0], areas.spawn, SPAWN, "spawn areas"),
            (axes[1], areas.goal, GOAL, "goal areas"),
        ):
            panels.place(axis, scene)
            for k in range(len(gaussians)):
                panels.ellipse(axis, gaussians, k, color=colour, linewidth=1.0)
                _write(axis, _spot(gaussians, k, scene), f"{k}", colour)
            axis.set_title(f"{scene.id}: {title}")
        axes[1].set_ylabel("")

    return _maps(draw, scene, "small png")


def changes_picture(
    found: Steering, usual: Sequence[Trajectories], steered: Sequence[Trajectories]
) -> bytes:
    """Bytes of maps: density as fitted, and its change under the scenario, with changed areas."""
    before, after = _density(found.scene, usual), _density(found.scene, steered)
    scenario = found.scenario
    added = [
        Gaussians(
            np.array([a.mean_m], dtype=np.float64),
            np.diag(np.square(a.sd_m, dtype=np.float64))[None],
        )
        for a in scenario.add
    ]

    def draw(axes: "list[Axes]") -> None:
        _shown(axes[0], found.scene, before, "viridis", 0.0, "persons per 100 m²")
        axes[0].set_title("as fitted")
        _shown(axes[1], found.scene, after - before, "RdBu_r", None, "more or fewer per 100 m²")
        axes[1].set_title(f"what {scenario.name} changes")
        axes[1].set_ylabel("")
        for axis in axes:
            for change in scenario.change:
                _named(axis, found.areas.spawn, change.area, SPAWN, f"S{change.area}")
            for goal in scenario.closed_goals:
                _named(axis, found.areas.goal, goal, GOAL, f"G{goal}", below=True)
            for k, gaussians in enumerate(added, len(found.areas.spawn)):
                _named(axis, gaussians, 0, SPAWN, f"S{k}")

    return _maps(draw, found.scene, "png", below=0.8)


def _maps(draw: Draw, scene: Scene, kind: Literal["png", "small png"], below: float = 0.0) -> bytes:
    """Bytes of two maps side by side, with `below` inches left free below them."""
    b = scene.bounds
    height = _WIDTH * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + 0.6 + below
    return picture(draw, width=2 * _WIDTH + 0.6, height=height, columns=2, kind=kind)


def _named(
    axis: "Axes", gaussians: Gaussians, k: int, colour: str, name: str, below: bool = False
) -> None:
    """Draw an area with its name above its centre, or below it."""
    panels.ellipse(axis, gaussians, k, color=colour, linewidth=1.0)
    _write(axis, gaussians.mean[k], name, colour, "top" if below else "bottom")


def _write(
    axis: "Axes", at: Float[np.ndarray, " 2"], name: str, colour: str, where: str = "center"
) -> None:
    from matplotlib.patheffects import withStroke

    x, y = at.tolist()
    axis.text(
        x, y, name,
        ha="center", va=where, fontsize=9, fontweight="bold", color=colour, clip_on=True,
        path_effects=[withStroke(linewidth=2.5, foreground="white")],
    )  # fmt: skip


def _spot(gaussians: Gaussians, k: int, scene: Scene) -> Float[np.ndarray, " 2"]:
    """Position of an area's number: its centre, or its top if a smaller area is at its centre."""
    apart = np.linalg.norm(gaussians.mean - gaussians.mean[k], axis=1)
    size = np.linalg.det(gaussians.covariance)
    beside = (scene.bounds.x_max_m - scene.bounds.x_min_m) / 40  # a number's height
    hidden = (apart < beside) & (size < size[k])
    of_y = gaussians.covariance[k, 1]
    return gaussians.mean[k] + (2 * of_y / np.sqrt(of_y[1]) if hidden.any() else 0)


def _density(scene: Scene, crowds: Sequence[Trajectories]) -> Float[np.ndarray, "Y X"]:
    """Mean number of persons in each cell, per 100 m²."""
    each = [in_cells(crowd.xy, scene) / crowd.frames for crowd in crowds]
    density: np.ndarray = 100 / CELL_M**2 * np.mean(each, axis=0)
    return density


def _shown(
    axis: "Axes",
    scene: Scene,
    density: Float[np.ndarray, "Y X"],
    colours: str,
    least: float | None,
    what: str,
) -> None:
    """Draw a map with a colour bar; the scale begins at `least`, or is symmetric if it is None."""
    # A percentile, so that single cells with very high values do not darken all others.
    top = float(np.percentile(np.abs(density[density != 0]), 99)) if density.any() else 1.0
    low = -top if least is None else least
    image = draw_cells(axis, density, scene, cmap=colours, vmin=low, vmax=top)
    panels.place(axis, scene)
    bar = axis.figure.colorbar(
        image, ax=axis, location="bottom", aspect=40, pad=0.02,
        extend="both" if least is None else "max",
    )  # fmt: skip
    bar.set_label(what)
