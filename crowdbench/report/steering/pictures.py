"""Pictures of what a scenario changes: arrival rates, and maps of areas and density."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float

from crowdbench.colours import COLOURS
from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.registry import policy as find_policy
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import Draw, picture
from crowdbench.report.steering.changes import Steering, total
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene
from crowdbench.spawn import Areas, SpawnEvents
from crowdbench.spawn.areas import Gaussians
from crowdbench.spawn.steering.scenario import steps_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SPAWN, GOAL = "black", COLOURS[0]
USUAL, STEERED = "0.5", COLOURS[1]
_WIDTH = 4.2
_BINS_S = (10, 20, 30, 60, 120, 300, 600, 900, 1800, 3600)
_MOST_BINS = 50
_MOST_PANELS = 8
WALKED = 5
"""Number of seeds with rollouts, for the map; sampling alone takes little time."""


def draw_steering(
    found: Steering,
    out: Path,
    *,
    policy: str = "straight",
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> list[Path]:
    """Draw `<scenario>-rates.png` and `<scenario>-map.png` into `out` and return their paths.

    The map shows rollouts of the first seeds with `policy`. `progress(done, total)` is called
    before the first rollout and after each.

    Raises:
        SettingError, WeightsError: there is no such policy.
        OutputError: a picture cannot be written.
    """
    walker = find_policy(policy, found.scene)
    models = found.models[:WALKED]
    paths = [out / f"{found.scenario.name}-{what}.png" for what in ("rates", "map")]
    with replacing(paths[0]) as temporary:
        temporary.write_bytes(rates_picture(found))
    crowds = []
    progress(0, 2 * len(models))
    with replacing(paths[1]) as temporary:
        for seed, steered in enumerate(models):
            pair = (steered.model, steered)
            crowds += [rollout(found.scene, model, walker, seed=seed) for model in pair]
            progress(len(crowds), 2 * len(models))
        temporary.write_bytes(changes_picture(found, crowds[::2], crowds[1::2]))
    return paths


def rates_picture(found: Steering) -> bytes:
    """Bytes of a picture with a panel per changed or added spawn area, and one for all others."""
    touched = found.touched[:_MOST_PANELS]
    horizon_s = found.scene.horizon_s
    bin_s = next((b for b in _BINS_S if horizon_s / b <= _MOST_BINS), _BINS_S[-1])
    edges = np.append(np.arange(0, horizon_s, bin_s), horizon_s)

    def draw(axes: "list[Axes]") -> None:
        for axis, area in zip(axes, touched, strict=False):
            _panel(axis, found, [area], edges)
            _asked(axis, found, area)
            added = area >= len(found.areas.spawn)
            axis.set_title(f"spawn area {area}{' (added)' if added else ''}", fontsize=9)
        others = sorted(set(range(found.spawn_areas)) - set(touched))
        _panel(axes[-1], found, others, edges)
        axes[-1].set_title(f"the other {len(others)} spawn areas together", fontsize=9)
        axes[-1].set(xlabel=f"time (s), in steps of {bin_s} s", xlim=(0, horizon_s))
        figure = axes[0].figure
        figure.supylabel("persons per minute", fontsize=9)
        figure.suptitle(
            f"{found.scenario.name} on {found.scene.id}: mean of {len(found.models)} episodes",
            x=0.01, ha="left",
        )  # fmt: skip
        handles, labels = axes[0].get_legend_handles_labels()
        figure.legend(handles, labels, loc="outside lower center", ncols=3)

    rows = len(touched) + 1
    return picture(draw, width=7.0, height=1.45 * rows + 0.9, rows=rows, kind="small png")


def _panel(axis: "Axes", found: Steering, areas: list[int], edges: Float[np.ndarray, " b"]) -> None:
    usual, steered = (
        _per_minute(events, areas, edges) for events in (found.usual_events, found.steered_events)
    )
    axis.stairs(usual, edges, color=USUAL, fill=True, alpha=0.45, label="as fitted")
    axis.stairs(steered, edges, color=STEERED, linewidth=1.3, label="steered")
    top = 1.15 * max(0.1, *usual, *steered)
    axis.set_ylim(-0.03 * top, top)  # so that a line at 0 is visible


def _per_minute(
    events: list[SpawnEvents], areas: list[int], edges: Float[np.ndarray, " b"]
) -> Float[np.ndarray, " n"]:
    times = np.concatenate([e.time_s[np.isin(e.spawn_area, areas)] for e in events])
    return 60 * np.histogram(times, edges)[0] / len(events) / np.diff(edges)


def _asked(axis: "Axes", found: Steering, area: int) -> None:
    """Draw the requested rate: the mean fitted rate times the factor, or an added area's rate."""
    horizon_s, number = found.scene.horizon_s, len(found.areas.spawn)
    if area >= number:
        profile, before, unit = found.scenario.add[area - number].persons_per_min, 0.0, 1.0
    else:
        profile, before = next(c.factor for c in found.scenario.change if c.area == area), 1.0
        unit = float(_per_minute(found.usual_events, [area], np.array([0.0, horizon_s]))[0])
    times = (0.0, *(time_s for time_s, _ in steps_of(profile)), horizon_s)
    edges = np.unique([time_s for time_s in times if time_s <= horizon_s])
    ends = np.array([total(profile, before, float(t)) for t in edges[1:]])
    asked = unit * np.diff(ends, prepend=0.0) / np.diff(edges)
    axis.stairs(asked, edges, color="black", linestyle="--", linewidth=1.0, baseline=None,
                label="asked for")  # fmt: skip


def areas_picture(scene: Scene, areas: Areas) -> bytes:
    """Bytes of maps with the numbered spawn areas and goal areas."""

    def draw(axes: "list[Axes]") -> None:
        for axis, gaussians, colour, title in (
            (axes[0], areas.spawn, SPAWN, "spawn areas"),
            (axes[1], areas.goal, GOAL, "goal areas"),
        ):
            panels.place(axis, scene)
            for k in range(len(gaussians)):
                at = _spot(gaussians, k, scene)
                _draw_area(axis, gaussians, k, colour, f"{k}", at, "center")
            axis.set_title(f"{scene.id}: {title}")
        axes[1].set_ylabel("")

    return _maps(draw, scene, "small png")


def changes_picture(
    found: Steering, usual: Sequence[Trajectories], steered: Sequence[Trajectories]
) -> bytes:
    """Bytes of maps: density as fitted, and its change under the scenario, with changed areas."""
    before, after = _density(found.scene, usual), _density(found.scene, steered)
    scenario, spawn = found.scenario, found.areas.spawn

    def draw(axes: "list[Axes]") -> None:
        _draw_density(axes[0], found.scene, before, "persons per 100 m²")
        axes[0].set_title("as fitted")
        _draw_density(axes[1], found.scene, after - before, "more or fewer per 100 m²", change=True)
        axes[1].set_title(f"what {scenario.name} changes")
        axes[1].set_ylabel("")
        for axis in axes:
            for change in scenario.change:
                _draw_area(axis, spawn, change.area, SPAWN, f"S{change.area}")
            for goal in scenario.closed_goals:
                _draw_area(axis, found.areas.goal, goal, GOAL, f"G{goal}", where="top")
            for k, addition in enumerate(scenario.add, len(spawn)):
                _draw_area(axis, addition.gaussian(), 0, SPAWN, f"S{k}")

    return _maps(draw, found.scene, "png", below=0.8)


def _maps(draw: Draw, scene: Scene, kind: Literal["png", "small png"], below: float = 0.0) -> bytes:
    """Bytes of two maps side by side, with `below` inches left free below them."""
    b = scene.bounds
    height = _WIDTH * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + 0.6 + below
    return picture(draw, width=2 * _WIDTH + 0.6, height=height, columns=2, kind=kind)


def _draw_area(
    axis: "Axes",
    gaussians: Gaussians,
    k: int,
    colour: str,
    name: str,
    at: Float[np.ndarray, " 2"] | None = None,
    where: str = "bottom",
) -> None:
    """Draw an area and its name, whose edge `where` is at the centre or at another point."""
    from matplotlib.patheffects import withStroke

    panels.ellipse(axis, gaussians, k, color=colour, linewidth=1.0)
    x, y = (gaussians.mean[k] if at is None else at).tolist()
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
    each = [panels.in_cells(crowd.xy, scene) / crowd.frames for crowd in crowds]
    density: np.ndarray = 100 / panels.CELL_M**2 * np.mean(each, axis=0)
    return density


def _draw_density(
    axis: "Axes", scene: Scene, density: Float[np.ndarray, "Y X"], what: str, change: bool = False
) -> None:
    """Draw a map with a colour bar; the scale of a change is symmetric, others begin at 0."""
    # A percentile, so that single cells with very high values do not darken all others.
    top = float(np.percentile(np.abs(density[density != 0]), 99)) if density.any() else 1.0
    low, colours, extend = (-top, "RdBu_r", "both") if change else (0.0, "viridis", "max")
    image = panels.draw_cells(axis, density, scene, cmap=colours, vmin=low, vmax=top)
    panels.place(axis, scene)
    bar = axis.figure.colorbar(
        image, ax=axis, location="bottom", aspect=40, pad=0.02, extend=extend
    )
    bar.set_label(what)
