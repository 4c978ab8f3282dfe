"""Pictures for checking the areas, paths and time blocks of a new scene."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.data.table import Trajectories
from crowdbench.files import replacing
from crowdbench.report.plots import PlotData, draw_figure, picture
from crowdbench.scene import Scene
from crowdbench.scoring.reference import read_reference

if TYPE_CHECKING:
    from matplotlib.axes import Axes

PICTURES = ("place.png", "time.png")


def draw_place(scene: Scene, recording: Trajectories, out: Path) -> list[Path]:
    """Draw `place.png` (recorded paths, walls and areas) and `time.png` (persons over time).

    The persons of `recording` must have areas. Returns the paths of the pictures.

    Raises:
        WeightsError: the scene has no areas or reference statistics.
        OutputError: a picture cannot be written.
    """
    plot = PlotData.of(scene, read_reference(scene), {}, "full", recording)
    place = draw_figure("paths.png", plot, out, named=PICTURES[0])
    over_time = out / PICTURES[1]
    with replacing(over_time) as temporary:
        temporary.write_bytes(_over_time(plot, recording))
    return [place, over_time]


def _over_time(plot: PlotData, recording: Trajectories) -> bytes:
    """A plot of the recorded N(t) and the time blocks, as PNG."""

    def draw(axes: "list[Axes]") -> None:
        (axis,) = axes
        blocks, dt_s = plot.reference.blocks, recording.dt_s
        present = recording.present()
        axis.plot(np.arange(len(present)) * dt_s, present, color="black", linewidth=0.7)
        for k, (start, stop) in enumerate((blocks.frames * dt_s).tolist()):
            axis.axvspan(start, stop, color=("0.93", "0.85")[k % 2], linewidth=0)
        axis.set(xlim=(0, recording.duration_s), ylim=(0, 1.05 * present.max()))
        axis.set(xlabel="time (s); grey: time blocks, white: unobserved", ylabel="agents")
        axis.set_title(f"{plot.scene.title}: agents over time")

    return picture(draw, width=9.0, height=2.6, kind="small png")
