"""Figure `sheet`: who is there, who comes and how long people stay, all scenes on one sheet."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.sight import Curves, Sight
from crowdbench.report.plots.ways import Numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_CURVES = ("inter_spawn", "spawns_per_10_frames", "dwell")
_MOST_POINTS = 200
"""Of a curve in the numbers; the picture draws all."""


def draw_sheet(sights: Sequence[Sight]) -> tuple[bytes, Numbers]:
    """The picture and its numbers: a row per scene, whose crowds are all walked by one policy."""
    columns = 1 + len(_CURVES)

    def draw(axes: "list[Axes]") -> None:
        for k, sight in enumerate(sights):
            _row(axes[k * columns : (k + 1) * columns], sight)
        axes[0].figure.legend(handles=_key(sights[0]), loc="outside lower center", ncols=5)

    drawn = picture(
        draw, width=14.0, height=2.6 * len(sights) + 0.4, rows=len(sights), columns=columns,
        kind="small png", shared=False,
    )  # fmt: skip
    return drawn, {"scenes": [_numbers(sight) for sight in sights]}


def _row(axes: "list[Axes]", sight: Sight) -> None:
    over_time, *of_curves = axes
    panels.recorded_bands(over_time, sight)
    for group in sight.narrowed(rollouts=1).groups:
        panels.rollouts_over_time(over_time, sight, group)
    over_time.set_title(f"{sight.scene.title}, walked by {sight.groups[0].policy}")
    for axis, name in zip(of_curves, _CURVES, strict=True):
        panels.survival(
            axis, sight, sight.curves(name), unit=_unit(sight, name), what=_what(sight, name)
        )
    panels.patience(of_curves[-1], sight)


def _unit(sight: Sight, name: str) -> float:
    return {"inter_spawn": sight.scene.grid_s, "dwell": sight.scene.dt_s}.get(name, 1.0)


def _what(sight: Sight, name: str) -> str:
    return {
        "inter_spawn": "inter-spawn time (s)",
        "spawns_per_10_frames": f"people who enter in 10 frames ({10 * sight.scene.dt_s:.3g} s)",
        "dwell": "dwell time (s)",
    }[name]


def _key(sight: Sight) -> list[Any]:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    return [
        Line2D([], [], color="black", linewidth=2.0, label="recorded (over time: mean of a block)"),
        Patch(color=panels.BAND, label="over time: 90 % of a block; else 95 % of resampled blocks"),
        *(Line2D([], [], color=g.colour, linewidth=1.4, label=g.spawn) for g in sight.groups),
        Line2D([], [], color="0.45", linewidth=0.9, linestyle=":",
               label="simulated lives are cut off"),
    ]  # fmt: skip


def _numbers(sight: Sight) -> Numbers:
    return {
        "scene": sight.scene.id,
        "policy": sight.groups[0].policy,
        "rollouts": {group.spawn: len(group.crowds) for group in sight.groups},
        "agents_over_time": _over_time(sight),
    } | {name: _curves(sight, sight.curves(name), _unit(sight, name)) for name in _CURVES}


def _over_time(sight: Sight) -> Numbers:
    """By time block: the recording's mean and range, and means of the rollouts that are drawn."""
    blocks = sight.reference.blocks
    counts = sight.reference.statistics["agents_over_time"]["counts"]
    return {
        "block_s": (blocks.frames * blocks.dt_s).round(2).tolist(),
        "recorded_mean": panels.recorded_means(sight).round(3).tolist(),
        "recorded_range": [panels.recorded_range(of_block) for of_block in counts],
        "simulated_mean": {
            group.spawn: panels.block_means(sight, group.crowds[0]).round(3).tolist()
            for group in sight.groups
        },
    }


def _curves(sight: Sight, curves: Curves, unit: float) -> Numbers:
    """Shares of values above x."""
    length = int(np.searchsorted(curves.support, curves.longest(), side="right"))
    every = slice(0, length, max(1, -(-length // _MOST_POINTS)))

    def above(f: np.ndarray) -> list[float]:
        return (1 - f[0, every]).round(4).tolist()

    return {
        "x": (curves.support[every] * unit).round(3).tolist(),
        "recorded": above(curves.recorded),
        "band": [above(curves.band[1]), above(curves.band[0])],
        "simulated": {
            group.spawn: above(f) for group, f in zip(sight.groups, curves.groups, strict=True)
        },
    }
