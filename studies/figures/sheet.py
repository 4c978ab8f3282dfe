"""Figure `sheet`: agents over time, arrivals and dwell times of all scenes."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.plot_data import Curves, PlotData
from studies.figures.ways import Numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CURVES = ("inter_spawn", "spawns_per_10_frames", "dwell")
_MOST_POINTS = 200
"""Maximum number of points per curve in the JSON file; the picture shows all."""


def draw_sheet(sights: Sequence[PlotData]) -> tuple[bytes, Numbers]:
    """The picture and its numbers, with a row per scene; all crowds of a scene have one policy."""
    columns = 1 + len(_CURVES)

    def draw(axes: "list[Axes]") -> None:
        for k, plot in enumerate(sights):
            _row(axes[k * columns : (k + 1) * columns], plot)
        axes[0].figure.legend(handles=_key(sights[0]), loc="outside lower center", ncols=5)

    drawn = picture(
        draw, width=14.0, height=2.6 * len(sights) + 0.4, rows=len(sights), columns=columns,
        kind="small png", shared=False,
    )  # fmt: skip
    return drawn, {"scenes": [_numbers(plot) for plot in sights]}


def _row(axes: "list[Axes]", plot: PlotData) -> None:
    over_time, *of_curves = axes
    panels.recorded_bands(over_time, plot)
    for group in plot.groups:
        panels.rollouts_over_time(over_time, plot, replace(group, crowds=group.crowds[:1]))
    over_time.set_title(f"{plot.scene.title}, walked by {plot.groups[0].policy}")
    for axis, name in zip(of_curves, _CURVES, strict=True):
        panels.survival(
            axis,
            plot,
            plot.curves(name),
            unit=_unit(plot, name),
            what=_what(plot, name),
        )
    panels.patience(of_curves[-1], plot)


def _unit(plot: PlotData, name: str) -> float:
    return {"inter_spawn": plot.scene.grid_s, "dwell": plot.scene.dt_s}.get(name, 1.0)


def _what(plot: PlotData, name: str) -> str:
    return {
        "inter_spawn": "inter-spawn time (s)",
        "spawns_per_10_frames": f"people who enter in 10 frames ({10 * plot.scene.dt_s:.3g} s)",
        "dwell": "dwell time (s)",
    }[name]


def _key(plot: PlotData) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], color="black", linewidth=2.0, label="recorded (over time: mean of a block)"),
        Patch(color=panels.BAND, label="over time: 90 % of a block; else 95 % of resampled blocks"),
        *(Line2D([], [], color=g.colour, linewidth=1.4, label=g.spawn) for g in plot.groups),
        Line2D([], [], color="0.45", linewidth=0.9, linestyle=":",
               label="simulated trips are cut off"),
    ]  # fmt: skip


def _numbers(plot: PlotData) -> Numbers:
    return {
        "scene": plot.scene.id,
        "policy": plot.groups[0].policy,
        "rollouts": {group.spawn: len(group.crowds) for group in plot.groups},
        "agents_over_time": _over_time(plot),
    } | {name: _curves(plot, plot.curves(name), _unit(plot, name)) for name in _CURVES}


def _over_time(plot: PlotData) -> Numbers:
    """Per time block: the recording's mean and range, and the means of the drawn rollouts."""
    blocks = plot.reference.blocks
    counts = plot.reference.statistics["agents_over_time"]["counts"]
    return {
        "block_s": (blocks.frames * blocks.dt_s).round(2).tolist(),
        "recorded_mean": panels.recorded_means(plot).round(3).tolist(),
        "recorded_range": [panels.recorded_range(of_block) for of_block in counts],
        "simulated_mean": {
            group.spawn: panels.block_means(plot, group.crowds[0]).round(3).tolist()
            for group in plot.groups
        },
    }


def _curves(plot: PlotData, curves: Curves, unit: float) -> Numbers:
    """Shares of values above x: of the recording, its band, and each spawn model."""
    length = int(np.searchsorted(curves.support, curves.longest(), side="right"))
    every = slice(0, length, max(1, -(-length // _MOST_POINTS)))

    def above(f: np.ndarray) -> list[float]:
        return (1 - f[0, every]).round(4).tolist()

    return {
        "x": (curves.support[every] * unit).round(3).tolist(),
        "recorded": above(curves.recorded),
        "band": [above(curves.band[1]), above(curves.band[0])],
        "simulated": {
            group.spawn: above(f) for group, f in zip(plot.groups, curves.groups, strict=True)
        },
    }
