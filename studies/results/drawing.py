"""The pictures of an evaluation's crowds, as files."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.metrics.presence import lagged
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.plot_data import PlotData
from studies.figures.maps import maps

if TYPE_CHECKING:
    from matplotlib.axes import Axes


@dataclass(frozen=True, eq=False)
class WithRecording(PlotData):
    """Crowds beside the recording itself, for what the reference statistics do not contain."""

    recording: Trajectories | None = None


def with_recording(plot: PlotData, recording: Trajectories | None) -> WithRecording:
    """The same crowds beside the recording itself."""
    return WithRecording(plot.scene, plot.reference, plot.split, plot.groups, recording)


def recording_in(plot: PlotData) -> Trajectories | None:
    """The recording, of which the paths and the autocorrelation at all lags can be drawn."""
    return plot.recording if isinstance(plot, WithRecording) else None


def draw_figure(name: str, plot: PlotData, out: Path, *, named: str = "") -> Path:
    """Draw one of `FIGURES` into the folder `out`, as file `name` or `named`; return its path.

    Raises:
        OutputError: the picture cannot be written.
    """
    path = out / (named or name)
    with replacing(path) as temporary:
        temporary.write_bytes(_DRAWN[name](plot))
    return path


def narrowed(plot: PlotData, *, policy: str | None = None, rollouts: int | None = None) -> PlotData:
    """A copy with only the groups of `policy` and the first `rollouts` of each; None keeps all.

    The groups of a single policy are drawn without dashes.
    """
    groups = [
        replace(
            group, dashes=group.dashes if policy is None else (), crowds=group.crowds[:rollouts]
        )
        for group in plot.groups
        if policy in (None, group.policy)
    ]
    return replace(plot, groups=groups)


def _agents_over_time(plot: PlotData) -> bytes:
    """Picture with a panel per crowd: N(t) of its rollouts and of the recording's time blocks."""

    def draw(axes: "list[Axes]") -> None:
        for axis, group in zip(axes, plot.groups, strict=True):
            panels.agents_over_time(axis, plot, group)
            axis.plot([], [], color=group.colour,
                      label=f"{group.label}, {len(group.crowds)} rollouts")  # fmt: skip
            axis.set(xlabel="", ylim=(0, 1.2 * panels.most_agents(plot)))
            axis.legend(loc="upper right", ncols=3)
            if axis is not axes[0]:  # only the first legend explains the recording
                axis.legend(handles=axis.get_lines()[-1:], loc="upper right")
        axes[-1].set_xlabel(
            "time (s); where only rollouts are drawn, the recording is not compared"
        )
        axes[0].set_title(f"{plot.scene.title}: agents over time")

    rows = len(plot.groups)
    return picture(draw, width=9.0, height=2.3 * rows + 0.6, rows=rows, kind="small png")


def _survival(plot: PlotData, name: str, title: str, what: str) -> bytes:
    unit = {"inter_spawn": plot.scene.grid_s, "dwell": plot.scene.dt_s}.get(name, 1.0)

    def draw(axes: "list[Axes]") -> None:
        (axis,) = axes
        what_exactly = what.format(ten_frames=f"{10 * plot.scene.dt_s:.3g} s")
        panels.survival(axis, plot, plot.curves(name), unit=unit, what=what_exactly)
        if name == "dwell":
            panels.patience(axis, plot)
        axis.legend()
        axis.set_title(f"{plot.scene.title}: {title}")

    return picture(draw, width=6.5, height=4.6, kind="small png")


def _autocorrelation(plot: PlotData) -> bytes:
    def draw(axes: "list[Axes]") -> None:
        (axis,) = axes
        if (recording := recording_in(plot)) is not None:
            lags_s = plot.lags_s.tolist()
            of = plot.correlations(lags_s, lagged(recording, plot.reference.blocks, lags_s))
            axis.fill_between(of.lag_s, of.low, of.high, color=panels.BAND, linewidth=0)
            axis.plot(of.lag_s, of.value, color="black", linewidth=2.2, label="recorded")
        panels.autocorrelation(axis, plot)
        # The legend is below the picture, because the curves may cover all of it.
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14), ncols=3)
        axis.set_title(f"{plot.scene.title}: autocorrelation of agents over time")

    return picture(draw, width=6.5, height=5.2, kind="small png")


_TALL = 1.3
"""Scenes with a larger ratio of height to width are drawn four in a row instead of two."""


def _paths(plot: PlotData) -> bytes:
    """Picture of the paths in each crowd's first rollout, with the scene's walls and areas."""
    from matplotlib.lines import Line2D

    shown = [(f"{group.label}, seed 0", group.crowds[0]) for group in plot.groups]
    if (recording := recording_in(plot)) is not None:
        shown.insert(0, ("recorded", recording))
    b = plot.scene.bounds
    steep = (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)
    columns, width = (4, 2.7) if steep > _TALL else (2, 4.0)
    handles = [
        Line2D([], [], color="black", linewidth=1.0, linestyle="--", label="spawn area, 2 σ"),
        Line2D([], [], color="0.4", linewidth=1.8, label="goal area, 2 σ, and paths to it"),
    ]
    drawn = [(title, partial(panels.paths, plot=plot, crowd=crowd)) for title, crowd in shown]
    return maps(plot.scene, drawn, width=width, columns=columns, handles=handles)


_DRAWN: dict[str, Callable[[PlotData], bytes]] = {
    "agents_over_time.png": _agents_over_time,
    "autocorrelation.png": _autocorrelation,
    "inter_spawn.png": partial(
        _survival, name="inter_spawn", title="inter-spawn time", what="inter-spawn time (s)"
    ),
    "spawns_per_10_frames.png": partial(
        _survival,
        name="spawns_per_10_frames",
        title="spawns per 10 frames",
        what="people who enter in {ten_frames}",
    ),
    "dwell.png": partial(_survival, name="dwell", title="dwell time", what="dwell time (s)"),
    "paths.png": _paths,
}
FIGURES = tuple(_DRAWN)
"""File names of the pictures that `draw_figure` writes."""
