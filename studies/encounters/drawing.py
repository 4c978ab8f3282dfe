"""Pictures of encounters: recorded above, simulated below."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from crowdbench.colours import COLOURS
from crowdbench.report.plots.canvas import picture
from crowdbench.scene import Scene
from studies.encounters.typical import Encounter

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Paths = Mapping[int, Float[np.ndarray, "_ 2"]]
"""Positions of people in all frames of a window, metres; NaN in frames without the person. People
have their index in the recording."""

HALF_M = 6.0
"""Half the width of a map."""
_WIDTH_IN = 2.1
_OTHERS = "0.6"


@dataclass(frozen=True, eq=False)
class Shown:
    """An encounter as recorded and as simulated."""

    scene: Scene
    encounter: Encounter
    recorded: Paths
    simulated: Paths
    recorded_measure: float | None
    simulated_measure: float | None


def still(shown: Sequence[Shown], policy: str) -> bytes:
    """A png of the paths; the circles are where people are at the encounter."""
    return picture(
        partial(_draw, shown=shown, policy=policy, until=None), **_size(shown), kind="small png"
    )


def animation(shown: Sequence[Shown], policy: str) -> bytes:
    """A gif of the same windows of time, at twice the recorded speed."""
    from PIL import Image

    frames = min(s.encounter.stop - s.encounter.first for s in shown)
    images = []
    for until in range(frames):
        content = picture(
            partial(_draw, shown=shown, policy=policy, until=until),
            **_size(shown),
            kind="small png",
        )
        with Image.open(BytesIO(content)) as image:
            images.append(image.convert("RGB").resize((image.width // 2, image.height // 2)))
    palette = images[-1].quantize(64)
    few = [image.quantize(palette=palette, dither=Image.Dither.NONE) for image in images]
    buffer = BytesIO()
    few[0].save(
        buffer,
        format="gif",
        save_all=True,
        append_images=few[1:],
        duration=round(1000 * shown[0].scene.dt_s / 2),
        loop=0,
        optimize=False,
    )
    return buffer.getvalue()


def _size(shown: Sequence[Shown]) -> dict[str, Any]:
    return {
        "width": _WIDTH_IN * len(shown) + 0.4,
        "height": 2 * _WIDTH_IN + 1.0,
        "rows": 2,
        "columns": len(shown),
        "shared": False,
    }


def _draw(axes: "list[Axes]", *, shown: Sequence[Shown], policy: str, until: int | None) -> None:
    for k, each in enumerate(shown):
        encounter = each.encounter
        at = encounter.frame - encounter.first
        centre = np.mean([each.recorded[p][at] for p in encounter.people], axis=0)
        for axis, paths in ((axes[k], each.recorded), (axes[k + len(shown)], each.simulated)):
            draw_map(axis, each, paths, at if until is None else until, until)
            axis.set_xlim(centre[0] - HALF_M, centre[0] + HALF_M)
            axis.set_ylim(centre[1] - HALF_M, centre[1] + HALF_M)
        unit = encounter.unit.rpartition(", ")[2]
        what = encounter.unit.rpartition(", ")[0]
        axes[k].set_title(
            f"{encounter.kind} (1 of {encounter.chosen_from:,})\n"
            f"{what}: {_value(each.recorded_measure, unit)}",
            fontsize=8,
        )
        axes[k + len(shown)].set_title(f"{_value(each.simulated_measure, unit)}", fontsize=8)
    axes[0].set_ylabel("recorded")
    axes[len(shown)].set_ylabel(policy)


def _value(value: float | None, unit: str) -> str:
    return "–" if value is None else f"{value:.1f} {unit}"


def draw_map(axis: "Axes", each: Shown, paths: Paths, at: int, until: int | None) -> None:
    """Draw the walls, paths up to a frame (None: all), and people at the frame `at`."""
    from matplotlib.patches import Circle, Polygon

    for wall in each.scene.walls:
        axis.add_patch(Polygon(wall.corners_m, facecolor="0.85", edgecolor="0.5", linewidth=0.5))
    radius = each.scene.motion.person_radius_m
    chosen = each.encounter.people
    for person, path in paths.items():
        own = person in chosen
        colour = COLOURS[chosen.index(person)] if own else _OTHERS
        stop = len(path) if until is None else until + 1
        axis.plot(
            *path[:stop].T, color=colour, linewidth=1.6 if own else 0.7, zorder=3 if own else 2
        )
        if not np.isnan(path[at]).any():
            axis.add_patch(Circle(tuple(path[at]), radius, color=colour, zorder=5 if own else 4))
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
