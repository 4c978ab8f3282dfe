"""The picture of dwell times of a scene. Paths are among the figures of the scene."""

from collections.abc import Mapping
from dataclasses import replace
from itertools import cycle
from pathlib import Path

from crowdbench.colours import COLOURS
from crowdbench.report.plots.plot_data import DASHES, Crowds, PlotData
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference
from studies.results.drawing import draw_figure

LEFT_OUT = ("random",)
"""Policies that are not drawn, as most of their trips end at the time limit."""


def draw_dwell(
    scene: Scene,
    reference: Reference,
    crowds: Crowds,
    names: Mapping[str, str],
    folder: Path,
) -> None:
    """Draw `<scene>-dwell.png` into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    shown = {key: crowd for key, crowd in crowds.items() if key[1] not in LEFT_OUT}
    plot = PlotData.of(scene, reference, shown, "full")
    # There is only one spawn model, so colours distinguish policies; further ones are dashed.
    styles = [(colour, dashes) for dashes in DASHES for colour in COLOURS]
    groups = [
        replace(group, label=names[group.policy], colour=colour, dashes=dashes)
        for group, (colour, dashes) in zip(plot.groups, cycle(styles), strict=False)
    ]
    plot = replace(plot, groups=groups)
    draw_figure("dwell.png", plot, folder, named=f"{scene.id}-dwell.png")
