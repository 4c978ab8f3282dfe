"""The pictures of an evaluation: agents over time, inter-spawn times, dwell times."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.files import replacing
from crowdbench.metrics import METRICS, total
from crowdbench.reference import Reference
from crowdbench.scene import Scene
from crowdbench.simulation.simulation import TIMEOUT_DWELLS
from crowdbench.spawn.areas import Gaussians, read_areas
from crowdbench.trajectories import Trajectories

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Crowds = dict[tuple[str, str, int], Trajectories]
"""Rollouts by spawn model, policy and seed."""

# Okabe & Ito's colours, which colour-blind readers can tell apart; the recording is black.
_COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9")
_DASHES: tuple[Any, ...] = ("-", (0, (5, 3)), (0, (2, 2)))
_DPI = 150

FIGURES = ("agents_over_time.png", "inter_spawn.png", "dwell.png", "paths.png")
"""What `draw_figures` writes."""


def draw_figures(scene: Scene, reference: Reference, crowds: Crowds, out: Path) -> list[Path]:
    """Draw `agents_over_time.png`, `inter_spawn.png`, `dwell.png` and `paths.png` into `out`.

    Raises:
        OutputError: a picture cannot be written.
    """
    pairs = list(dict.fromkeys((spawn, policy) for spawn, policy, _ in crowds))
    groups = [
        (f"{spawn} × {policy}", [c for key, c in crowds.items() if key[:2] == (spawn, policy)])
        for spawn, policy in pairs
    ]
    return [
        _agents_over_time(scene, reference, groups, out / "agents_over_time.png"),
        _survival(scene, reference, groups, out / "inter_spawn.png", "inter_spawn"),
        _survival(scene, reference, groups, out / "dwell.png", "dwell"),
        _paths(scene, groups, out / "paths.png"),
    ]


def _agents_over_time(
    scene: Scene,
    reference: Reference,
    groups: list[tuple[str, list[Trajectories]]],
    path: Path,
) -> Path:
    """Draw a panel per crowd: its rollouts' N(t) over the recording's N in each time block."""

    def draw(axes: "list[Axes]") -> None:
        seconds = np.arange(scene.recording.frames) * scene.dt_s
        top = max(crowd.present().max() for _, crowds in groups for crowd in crowds)
        for k, (axis, (label, crowds)) in enumerate(zip(axes, groups, strict=True)):
            _recorded_bands(axis, reference)
            series = np.stack([crowd.present()[: len(seconds)] for crowd in crowds])
            colour = _COLOURS[k % len(_COLOURS)]
            axis.plot(seconds, series.T, color=colour, linewidth=0.6, alpha=0.45)
            axis.plot([], [], color=colour, label=f"{label}, {len(crowds)} rollouts")
            axis.set(ylabel="agents", xlim=(0, seconds[-1]), ylim=(0, top * 1.25))
            axis.legend(loc="upper right", ncols=3, fontsize=8, frameon=False)
            if k > 0:  # the recording is explained once
                axis.legend(
                    handles=axis.get_lines()[-1:], loc="upper right", fontsize=8, frameon=False
                )
        axes[-1].set_xlabel(
            "time (s); where only rollouts are drawn, the recording was not annotated"
        )
        axes[0].set_title(f"{scene.title}: agents over time", loc="left", fontsize=11)

    return _save(path, draw, rows=len(groups), height=2.3)


def _recorded_bands(axis: "Axes", reference: Reference) -> None:
    counts = reference.statistics["agents_over_time"]["counts"]
    for b, (start, stop) in enumerate(reference.blocks.frames * reference.blocks.dt_s):
        cumulative = counts[b].cumsum() / counts[b].sum()
        low, high = (np.searchsorted(cumulative, q) for q in (0.05, 0.95))
        mean = counts[b] @ np.arange(counts.shape[1]) / counts[b].sum()
        first = b == 0
        axis.fill_between(
            [start, stop], low - 0.2, high + 0.2, color="0.82", linewidth=0,
            label="recorded, 5–95 % of a block" if first else None,
        )  # fmt: skip
        axis.plot(
            [start, stop], [mean, mean], color="black", linewidth=1.6,
            label="recorded, mean of a block" if first else None,
        )  # fmt: skip


def _survival(
    scene: Scene,
    reference: Reference,
    groups: list[tuple[str, list[Trajectories]]],
    path: Path,
    name: str,
) -> Path:
    """Draw P(time > t) of the recording and each crowd, all rollouts of a crowd pooled.

    Survival curves need no bins, and show the tail that a histogram hides.
    """
    metric = next(m for m in METRICS if m.name == name)
    titles = {"inter_spawn": "inter-spawn time", "dwell": "dwell time"}
    unit_s = {"inter_spawn": scene.grid_s, "dwell": scene.dt_s}[name]

    def draw(axes: "list[Axes]") -> None:
        (axis,) = axes
        each = {label: [metric.summarise(c, reference.blocks, reference.place) for c in crowds]
                for label, crowds in groups}  # fmt: skip
        everyone = [reference.statistics[name], *(s for crowds in each.values() for s in crowds)]
        dense, support = metric.aligned(everyone, reference.blocks)
        sums = iter([total(s) for s in dense])
        pooled = {"recorded": next(sums)}
        for label, crowds in each.items():
            of_group = [next(sums) for _ in crowds]
            pooled[label] = {n: np.sum([s[n] for s in of_group], axis=0) for n in of_group[0]}
        curves = {label: metric.embed(s, support, reference.blocks) for label, s in pooled.items()}
        longest = support[max(int(np.searchsorted(f, 1 - 1e-4)) for f in curves.values())]
        for k, (label, f) in enumerate(curves.items()):
            style: dict[str, Any] = {
                "color": _COLOURS[(k - 1) % len(_COLOURS)],
                "linestyle": _DASHES[(k - 1) % len(_DASHES)],  # equal curves stay visible
                "linewidth": 1.5,
            }
            if k == 0:
                style = {"color": "black", "linewidth": 2.2}
            axis.step(support * unit_s, 1 - f, where="post", label=label, **style)
        axis.set_xlim(0, longest * unit_s)
        if name == "dwell":
            patience_s = TIMEOUT_DWELLS * scene.recording.dwell_p99_s
            axis.axvline(
                patience_s,
                color="0.5",
                linewidth=0.8,
                linestyle=":",
                label="simulated lives are cut off",
            )
        axis.set(xlabel=f"{titles[name]} t (s)", ylabel="share longer than t")
        axis.set_ylim(0, 1)
        axis.legend(fontsize=8, frameon=False)
        axis.set_title(f"{scene.title}: {titles[name]}", loc="left", fontsize=11)

    return _save(path, draw, height=4.0, width=6.5)


def _paths(scene: Scene, groups: list[tuple[str, list[Trajectories]]], path: Path) -> Path:
    """Draw the paths of each crowd's first rollout over the scene's walls and areas."""
    from matplotlib.lines import Line2D

    areas = read_areas(scene)
    b = scene.bounds
    width, height = b.x_max_m - b.x_min_m, b.y_max_m - b.y_min_m

    def draw(axes: "list[Axes]") -> None:
        for axis, (label, crowds) in zip(axes, groups, strict=True):
            crowd = crowds[0]
            for wall in scene.walls:
                axis.fill(*np.array(wall.corners_m).T, color="0.75", linewidth=0)
            for p in range(len(crowd)):
                colour = _COLOURS[crowd.goal_area[p] % len(_COLOURS)]
                axis.plot(*crowd.path(p).T, color=colour, linewidth=0.5, alpha=0.5)
            for k in range(len(areas.goal)):
                _ellipse(axis, areas.goal, k, color=_COLOURS[k % len(_COLOURS)], linewidth=1.8)
            for k in range(len(areas.spawn)):
                _ellipse(axis, areas.spawn, k, color="black", linewidth=1.0, linestyle="--")
            axis.set(aspect="equal", xlabel="x (m)")
            axis.set(xlim=(b.x_min_m, b.x_max_m), ylim=(b.y_min_m, b.y_max_m))
            axis.set_title(f"{label}, seed 0", loc="left", fontsize=9)
        axes[0].set_ylabel("y (m)")
        handles = [
            Line2D([], [], color="black", linewidth=1.0, linestyle="--", label="spawn area, 2 σ"),
            Line2D([], [], color="0.4", linewidth=1.8, label="goal area, 2 σ, and paths to it"),
        ]
        axes[0].legend(handles=handles, loc="lower left", fontsize=7, framealpha=0.9)

    columns = len(groups)
    return _save(
        path, draw, columns=columns, height=5.0 * height / width, width=5.0 * columns + 0.6
    )


def _ellipse(axis: "Axes", gaussians: Gaussians, k: int, **style: Any) -> None:
    root = np.linalg.cholesky(gaussians.covariance[k])
    angle = np.linspace(0, 2 * np.pi, 60)
    axis.plot(*(gaussians.mean[k][:, None] + 2 * root @ [np.cos(angle), np.sin(angle)]), **style)


def _save(
    path: Path,
    draw: "Callable[[list[Axes]], None]",
    *,
    rows: int = 1,
    columns: int = 1,
    height: float,
    width: float = 9.0,
) -> Path:
    # A figure of its own canvas: no window system and no global state of pyplot's is touched.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height * rows + 0.6), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(rows, columns, sharex=True, sharey=columns > 1, squeeze=False).ravel()
    for axis in axes:
        axis.spines[["top", "right"]].set_visible(False)
    draw(list(axes))
    with replacing(path) as temporary:
        figure.savefig(temporary, dpi=_DPI, format="png", metadata={"Software": None})
    return path
