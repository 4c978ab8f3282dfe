"""The picture of dwell times of a scene. Paths are among the figures of the scene."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from crowdbench.colours import COLOURS
from crowdbench.report.plots import draw_figure
from crowdbench.report.plots.plot_data import Crowds, PlotData
from crowdbench.scene import Scene
from crowdbench.scoring.reference import Reference

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
    # There is only one spawn model, so colours distinguish policies.
    groups = [
        replace(group, label=names[group.policy], dashes=(),
                colour=COLOURS[k % len(COLOURS)])
        for k, group in enumerate(plot.groups)
    ]  # fmt: skip
    plot = replace(plot, groups=groups)
    draw_figure("dwell.png", plot, folder, named=f"{scene.id}-dwell.png")
