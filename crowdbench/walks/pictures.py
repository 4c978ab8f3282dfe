"""The page's pictures of a scene: ways by spawn and goal area, and dwell times."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from crowdbench.figures import draw_figure
from crowdbench.figures.sight import COLOURS, Crowds, Sight
from crowdbench.figures.ways import draw_ways
from crowdbench.files import replacing
from crowdbench.reference import Reference
from crowdbench.scene import Scene
from crowdbench.trajectories import Trajectories

LEFT_OUT = ("random",)
"""Whose ways are a tangle, and whose dwell times are the scene's patience."""


def draw_pictures(
    scene: Scene,
    reference: Reference,
    crowds: Crowds,
    names: Mapping[str, str],
    recording: Trajectories,
    folder: Path,
) -> None:
    """Draw `<scene>-paths.png` and `<scene>-dwell.png` into `folder`.

    Raises:
        OutputError: a picture cannot be written.
    """
    shown = {key: crowd for key, crowd in crowds.items() if key[1] not in LEFT_OUT}
    sight = Sight.of(scene, reference, shown, "full", recording)
    # One spawn model: the colour tells the policy.
    groups = [
        replace(group, label=names[group.policy], dashes=(),
                colour=COLOURS[k % len(COLOURS)])
        for k, group in enumerate(sight.groups)
    ]  # fmt: skip
    sight = replace(sight, groups=groups)
    draw_figure("dwell.png", sight, folder, named=f"{scene.id}-dwell.png")
    with replacing(folder / f"{scene.id}-paths.png") as temporary:
        walked = [(group.label, group.crowds[0]) for group in groups]
        temporary.write_bytes(draw_ways(scene, recording, walked))
