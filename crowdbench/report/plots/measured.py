"""Flow, density and speed of an evaluation's crowds and of the recording, at the same place."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from crowdbench.progress import steps
from crowdbench.registry import has_recording, recording_of
from crowdbench.report.flow import (
    Flow,
    SpeedDensity,
    flow_through,
    middle_area,
    middle_line,
    speed_density,
)
from crowdbench.report.plots.panels import linestyle
from crowdbench.report.plots.plot_data import PlotData

RECORDED = "recorded"
"""Label of the recording."""


@dataclass(frozen=True, eq=False)
class Measured:
    """What is measured of the recording, if it is imported, and of one rollout of each group."""

    area: shapely.Polygon
    line: Float[np.ndarray, "2 2"]
    clouds: dict[str, SpeedDensity]
    """By label: that of the group, or `RECORDED`."""
    flows: dict[str, Flow]
    styles: dict[str, dict[str, Any]]
    """Colours and dashes."""

    @classmethod
    def of(cls, plot: PlotData) -> "Measured":
        """Measure at `middle_area` and `middle_line`, in the frames of the time blocks.

        Raises:
            SettingError: PedPy is not installed, or the scene has no free place.
        """
        scene = plot.scene
        crowds = {group.label: group.crowds[0] for group in plot.groups}
        styles: dict[str, dict[str, Any]] = {
            group.label: {"color": group.colour, "linestyle": linestyle(group)}
            for group in plot.groups
        }
        if has_recording(scene):
            crowds = {RECORDED: recording_of(scene), **crowds}
            styles[RECORDED] = {"color": "black"}
        area, line = middle_area(scene), middle_line(scene)
        clouds, flows = {}, {}
        for label, crowd in steps("flow and density", list(crowds.items())):
            compared = crowd.observed_in(plot.reference.blocks.frames)
            clouds[label] = speed_density(compared, scene, area)
            flows[label] = flow_through(compared, line)
        return cls(area, line, clouds, flows, styles)

    @property
    def stride(self) -> int:
        """Every how many frames density and speed are measured."""
        return max(cloud.stride for cloud in self.clouds.values())
