"""`write_crossing`: a typical crossing of a recording, beside the same people by other models."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from crowdbench.data.blocks import SPLITS
from crowdbench.data.companions import with_companions
from crowdbench.errors import RecordingError
from crowdbench.files import replacing
from crowdbench.policies import Policy
from crowdbench.registry import recording_of
from crowdbench.report.plots.canvas import picture
from crowdbench.run.references import reference_of
from crowdbench.scene import load_scene
from crowdbench.spawn.replay import Replay
from studies.encounters import recorded_paths, walked_paths
from studies.encounters.drawing import HALF_M, Paths, Shown, draw_map
from studies.encounters.typical import typical_encounters

if TYPE_CHECKING:
    from matplotlib.axes import Axes

KIND = "crossing"
Walkers = Mapping[str, Callable[[str], Policy]]
"""Functions that make a policy for a split, by the name that is shown."""


def write_crossing(scene: str, walkers: Walkers, out: Path) -> dict[str, float | None]:
    """Draw the typical crossing of a scene: as recorded, and by each policy from the same moment.

    Returns the closest distances, by name. Each policy is that of the fold in which the crossing
    is held out.

    Raises:
        RecordingError: the recording has not been imported, or nobody crosses another's way.
    """
    place = load_scene(scene)
    crowd = with_companions(recording_of(place))
    blocks = reference_of(place).blocks
    found = [of for of in typical_encounters(place, crowd, blocks) if of.kind == KIND]
    if not found:
        raise RecordingError(place.id, got=f"no {KIND}", expected="people who cross")
    (encounter,) = found
    (block,) = np.flatnonzero(
        (blocks.frames[:, 0] <= encounter.frame) & (encounter.frame < blocks.frames[:, 1])
    )
    split = SPLITS[1 + block % (len(SPLITS) - 1)]
    events = Replay(crowd).sample(np.inf, place, np.random.default_rng(0))
    recorded = recorded_paths(crowd, encounter)
    paths: dict[str, Paths] = {"recorded": recorded}
    for name, make in walkers.items():
        paths[name] = walked_paths(place, crowd, events, encounter, make(split), seed=0)
    closest = {name: encounter.measure(of, crowd.dt_s) for name, of in paths.items()}
    shown = [Shown(place, encounter, recorded, of, None, None) for of in paths.values()]
    content = picture(
        partial(_draw, shown=shown, closest=closest),
        width=2.1 * len(shown) + 0.2,
        height=2.8,
        rows=1,
        columns=len(shown),
        shared=False,
        kind="small png",
    )
    with replacing(out) as temporary:
        temporary.write_bytes(content)
    return closest


def _draw(axes: "list[Axes]", *, shown: list[Shown], closest: dict[str, float | None]) -> None:
    for axis, each, (name, gap) in zip(axes, shown, closest.items(), strict=True):
        at = each.encounter.frame - each.encounter.first
        centre = np.mean([each.recorded[p][at] for p in each.encounter.people], axis=0)
        draw_map(axis, each, each.simulated, at, None)
        axis.set_xlim(centre[0] - HALF_M, centre[0] + HALF_M)
        axis.set_ylim(centre[1] - HALF_M, centre[1] + HALF_M)
        told = "" if gap is None else f"\nclosest {gap:.1f} m"
        axis.set_title(f"{name}{told}", fontsize=8)
