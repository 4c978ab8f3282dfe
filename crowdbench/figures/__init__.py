"""The pictures of an evaluation: what people can see of it, as files and in the report."""

from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.figures import panels
from crowdbench.figures.canvas import Draw, picture
from crowdbench.figures.sight import Crowds, Sight
from crowdbench.files import replacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

FIGURES = ("agents_over_time.png", "inter_spawn.png", "dwell.png", "paths.png")
"""What `draw_figures` writes."""


def draw_figures(sight: Sight, out: Path) -> list[Path]:
    """Draw `agents_over_time.png`, `inter_spawn.png`, `dwell.png` and `paths.png` into `out`.

    Raises:
        OutputError: a picture cannot be written.
    """
    return [
        _agents_over_time(sight, out / "agents_over_time.png"),
        _survival(sight, out / "inter_spawn.png", "inter_spawn"),
        _survival(sight, out / "dwell.png", "dwell"),
        _paths(sight, out / "paths.png"),
    ]


def _agents_over_time(sight: Sight, path: Path) -> Path:
    """Draw a panel per crowd: its rollouts' N(t) over the recording's N in each time block."""

    def draw(axes: "list[Axes]") -> None:
        for axis, group in zip(axes, sight.groups, strict=True):
            panels.agents_over_time(axis, sight, group)
            axis.plot([], [], color=group.colour,
                      label=f"{group.label}, {len(group.crowds)} rollouts")  # fmt: skip
            axis.set(xlabel="", ylim=(0, 1.2 * panels.most_agents(sight)))
            axis.legend(loc="upper right", ncols=3)
            if axis is not axes[0]:  # the recording is explained once
                axis.legend(handles=axis.get_lines()[-1:], loc="upper right")
        axes[-1].set_xlabel(
            "time (s); where only rollouts are drawn, the recording is not compared"
        )
        axes[0].set_title(f"{sight.scene.title}: agents over time")

    rows = len(sight.groups)
    return _save(path, picture(draw, width=9.0, height=2.3 * rows + 0.6, rows=rows, kind="png"))


def _survival(sight: Sight, path: Path, name: str) -> Path:
    title = {"inter_spawn": "inter-spawn time", "dwell": "dwell time"}[name]
    unit_s = {"inter_spawn": sight.scene.grid_s, "dwell": sight.scene.dt_s}[name]

    def draw(axes: "list[Axes]") -> None:
        (axis,) = axes
        panels.survival(axis, sight, sight.curves(name), unit=unit_s, what=f"{title} (s)")
        if name == "dwell":
            panels.patience(axis, sight)
        axis.legend()
        axis.set_title(f"{sight.scene.title}: {title}")

    return _save(path, picture(draw, width=6.5, height=4.6, kind="png"))


def _paths(sight: Sight, path: Path) -> Path:
    """Draw the paths of each crowd's first rollout over the scene's walls and areas."""
    from matplotlib.lines import Line2D

    b = sight.scene.bounds
    columns = min(2, len(sight.groups))
    rows = -(-len(sight.groups) // columns)
    height = 5.0 * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m) + 0.6

    def draw(axes: "list[Axes]") -> None:
        for axis in axes[len(sight.groups) :]:
            axis.set_visible(False)
        for k, (axis, group) in enumerate(zip(axes, sight.groups, strict=False)):
            panels.paths(axis, sight, group)
            axis.set_title(f"{group.label}, seed 0", fontsize=9)
            axis.set_ylabel("y (m)" if k % columns == 0 else "")
            below = k + columns < len(sight.groups)
            axis.set_xlabel("" if below else "x (m)")
            axis.tick_params(labelbottom=not below)  # also above an empty place
        handles = [
            Line2D([], [], color="black", linewidth=1.0, linestyle="--", label="spawn area, 2 σ"),
            Line2D([], [], color="0.4", linewidth=1.8, label="goal area, 2 σ, and paths to it"),
        ]
        axes[0].legend(handles=handles, loc="lower left", fontsize=7, framealpha=0.9, frameon=True)

    size = {"width": 5.0 * columns + 0.6, "height": height * rows}
    return _save(path, picture(draw, **size, rows=rows, columns=columns, kind="png"))


def _save(path: Path, png: bytes) -> Path:
    with replacing(path) as temporary:
        temporary.write_bytes(png)
    return path


__all__ = ["FIGURES", "Crowds", "Draw", "Sight", "draw_figures", "panels", "picture"]
