"""Fit a scene: its areas, its spawn models and its reference statistics, from its recording."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from crowdbench.errors import SceneError, SettingError
from crowdbench.files import write_text
from crowdbench.reference import Reference, write_reference
from crowdbench.scene import Scene
from crowdbench.spawn import PoissonGMM, arrivals_of, fit_areas
from crowdbench.spawn.areas import write_areas
from crowdbench.trajectories import OUTCOMES, Trajectories


def fit_scene(
    scene: Scene, recording: Trajectories, *, clustering: str = "default", out: Path | None = None
) -> dict[str, str]:
    """Fit everything that a scene ships and write it into its folder, or into `out`.

    Returns what was found, as text for a table.

    Raises:
        SettingError: the scene has no clustering of that name.
        SceneError: `scene.toml` contradicts the recording.
        OutputError: the folder cannot be written.
    """
    if clustering not in scene.clustering:
        raise SettingError(
            f"clustering of {scene.id}",
            got=repr(clustering),
            expected=f"one of {', '.join(scene.clustering)}",
        )
    _check_against(scene, recording)
    areas, crowd = fit_areas(recording, scene, scene.clustering[clustering])
    reference = Reference.of(crowd, scene, areas)
    arrivals = arrivals_of(crowd, reference.blocks, len(areas.spawn))
    model = PoissonGMM.fit(arrivals, areas)
    place = replace(scene, folder=out or scene.folder)
    if out is not None:  # a folder with a scene.toml is a scene of its own
        write_text(out / "scene.toml", (scene.folder / "scene.toml").read_text())
    write_areas(areas, place.folder / "areas.json")
    model.write(place.folder)
    write_reference(reference, place)
    return {
        "persons": f"{len(crowd)}, {len(arrivals.tick)} of them arrivals in the time blocks",
        "spawn areas": f"{len(areas.spawn)}, {areas.left_out[0]:.1%} of arrivals left out",
        "goal areas": f"{len(areas.goal)}, {areas.left_out[1]:.1%} of departures left out",
        "poisson-gmm": f"{model.rate.sum() * 60:.2f} persons per minute, "
        f"{model.log_likelihood(arrivals):.3f} nats per person",
        "time blocks": f"{len(reference.blocks)}, {reference.blocks.exposure_s():.1f} s in all",
        "written to": str(place.folder),
    }


def _check_against(scene: Scene, recording: Trajectories) -> None:
    """The facts that `scene.toml` states of its recording must be the recording's."""
    whole = recording.entered & recording.left
    cut_off = recording.outcome == OUTCOMES.index("timeout")  # says how patient the rule is
    dwell = (recording.last - recording.first)[whole & ~cut_off] * recording.dt_s
    p99_s = float(np.percentile(dwell, 99))
    facts = (
        ("dt_s", scene.dt_s, recording.dt_s),
        ("recording.frames", scene.recording.frames, recording.frames),
        ("recording.dwell_p99_s", scene.recording.dwell_p99_s, p99_s),
    )
    for name, stated, found in facts:
        if not np.isclose(stated, found, rtol=1e-3):
            raise SceneError(
                scene.folder / "scene.toml",
                got=f"{name} = {stated}",
                expected=f"{found:.2f}, as in the recording {recording.scene}",
                mend="Correct it, or fit with the recording that the scene is made from.",
            )
    outside = ~scene.walkable(recording.xy.astype(np.float64))
    ends = np.zeros(len(recording.xy), dtype=bool)
    ends[recording.offsets[1:] - 1] = True  # a simulated person's last step may lead outside
    if (outside & ~ends).any():
        row = int(np.flatnonzero(outside & ~ends)[0])
        raise SceneError(
            scene.folder / "scene.toml",
            got=f"{int((outside & ~ends).sum())} recorded positions outside the bounds or in a "
            f"wall, the first at {recording.xy[row].round(2).tolist()} m",
            expected="bounds and walls that hold every recorded position",
        )
