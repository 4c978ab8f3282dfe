"""Pictures for checking the areas, paths and time blocks of a new scene."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.report.plots import panels
from crowdbench.report.plots.canvas import picture
from crowdbench.report.plots.plot_data import PlotData
from crowdbench.scene import Scene
from crowdbench.scoring.reference import read_reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes


def draw_place(scene: Scene, recording: Trajectories, out: Path) -> None:
    """Draw `place.png` (recorded paths, walls and areas) and `time.png` (persons over time).

    The persons of `recording` must have areas. Paths have the colours of their goal areas.

    Raises:
        WeightsError: the scene has no areas or reference statistics.
        OutputError: a picture cannot be written.
    """
    plot = PlotData.of(scene, read_reference(scene), {}, "full")

    def place(axes: "list[Axes]") -> None:
        panels.paths(axes[0], plot, recording)
        axes[0].set_title("recorded; spawn areas (dashed) and goal areas, 2 σ")

    def over_time(axes: "list[Axes]") -> None:
        (axis,) = axes
        blocks, dt_s = plot.reference.blocks, recording.dt_s
        present = recording.present()
        axis.plot(np.arange(len(present)) * dt_s, present, color="black", linewidth=0.7)
        for k, (start, stop) in enumerate((blocks.frames * dt_s).tolist()):
            axis.axvspan(start, stop, color=("0.93", "0.85")[k % 2], linewidth=0)
        axis.set(xlim=(0, recording.duration_s), ylim=(0, 1.05 * present.max()))
        axis.set(xlabel="time (s); grey: time blocks, white: unobserved", ylabel="agents")
        axis.set_title(f"{scene.title}: agents over time")

    b, width = scene.bounds, 5.0
    height = width * (b.y_max_m - b.y_min_m) / (b.x_max_m - b.x_min_m)
    for name, draw, size in (
        ("place.png", place, (width + 0.6, height + 0.6)),
        ("time.png", over_time, (9.0, 2.6)),
    ):
        data = picture(draw, width=size[0], height=size[1], kind="small png")
        with replacing(out / name) as temporary:
            temporary.write_bytes(data)
