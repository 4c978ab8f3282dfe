"""Fit a scene: its areas, its spawn models and its reference statistics, from its recording."""

import importlib.util
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from crowdbench.blocks import PARTS, TimeBlocks
from crowdbench.errors import SceneError, SettingError
from crowdbench.files import write_text
from crowdbench.reference import Reference, write_reference
from crowdbench.scene import Scene
from crowdbench.spawn import (
    Areas,
    NtppGMM,
    PoissonGMM,
    RenewalGMM,
    SpawnModel,
    arrivals_of,
    fit_areas,
)
from crowdbench.spawn.areas import write_areas
from crowdbench.trajectories import OUTCOMES, Trajectories

MODELS = ("poisson-gmm", "renewal-gmm", "ntpp-gmm")
Progress = Callable[[int, int], None]
"""Is called with the number of fits that are done, and of all."""


def fit_scene(
    scene: Scene,
    recording: Trajectories,
    *,
    clustering: str = "default",
    models: Sequence[str] = MODELS,
    out: Path | None = None,
    progress: Progress | None = None,
) -> dict[str, str]:
    """Fit everything that a scene ships and write it into its folder, or into `out`.

    Each spawn model is fitted for the whole recording and for each fold. Returns what was found,
    as text for a table.

    Raises:
        SettingError: the scene has no clustering of that name, there is no such model, or torch,
            which `ntpp-gmm` is fitted with, is not installed.
        SceneError: `scene.toml` contradicts the recording.
        OutputError: the folder cannot be written.
    """
    if clustering not in scene.clustering:
        raise SettingError(
            f"clustering of {scene.id}",
            got=repr(clustering),
            expected=f"one of {', '.join(scene.clustering)}",
        )
    _check_models(models)
    _check_against(scene, recording)
    areas, crowd = fit_areas(recording, scene, scene.clustering[clustering])
    reference = Reference.of(crowd, scene, areas)
    arrivals = arrivals_of(crowd, reference.blocks, len(areas.spawn))
    place = replace(scene, folder=out or scene.folder)
    if out is not None:  # a folder with a scene.toml is a scene of its own
        write_text(out / "scene.toml", (scene.folder / "scene.toml").read_text())
    write_areas(areas, place.folder / "areas.json")
    fitted = _fit_models(models, crowd, reference.blocks, areas, place, progress)
    write_reference(reference, place)
    return {
        "persons": f"{len(crowd)}, {len(arrivals.tick)} of them arrivals in the time blocks",
        "spawn areas": f"{len(areas.spawn)}, {areas.left_out[0]:.1%} of arrivals left out",
        "goal areas": f"{len(areas.goal)}, {areas.left_out[1]:.1%} of departures left out",
        "arrivals": f"{len(arrivals.tick) / arrivals.exposure_s() * 60:.2f} persons per minute",
        **{m.name: f"{m.log_likelihood(arrivals):.3f} nats per person" for m in fitted},
        "time blocks": f"{len(reference.blocks)}, {reference.blocks.exposure_s():.1f} s in all",
        "written to": str(place.folder),
    }


def _check_models(models: Sequence[str]) -> None:
    for name in models:
        if name not in MODELS:
            raise SettingError("models", got=repr(name), expected=f"some of {', '.join(MODELS)}")
    if "ntpp-gmm" in models and importlib.util.find_spec("torch") is None:
        raise SettingError(
            "ntpp-gmm",
            got="no torch to fit it with",
            expected="torch 2.4 or newer",
            mend="Install crowdbench[fit], or leave it out: --models poisson-gmm renewal-gmm.",
        )


def _fit_models(
    models: Sequence[str],
    crowd: Trajectories,
    blocks: TimeBlocks,
    areas: Areas,
    place: Scene,
    progress: Progress | None,
) -> list[SpawnModel]:
    """Fit and write the models; returns the first fit of each for the whole recording."""
    arrivals = {part: arrivals_of(crowd, blocks.training(part), len(areas.spawn)) for part in PARTS}
    tell = progress or (lambda done, total: None)
    neural = "ntpp-gmm" in models
    if neural:
        from crowdbench.spawn import ntpp_training

        settings = ntpp_training.SETTINGS
        total = len(PARTS) * ntpp_training.FITS
        tell(0, total)
    found: list[SpawnModel] = []
    if "poisson-gmm" in models:
        poisson = {part: [PoissonGMM.fit(a, areas)] for part, a in arrivals.items()}
        PoissonGMM.write(place.folder, poisson)
        found += poisson["full"]
    if "renewal-gmm" in models:
        renewal = {part: [RenewalGMM.fit(a, areas)] for part, a in arrivals.items()}
        RenewalGMM.write(place.folder, renewal)
        found += renewal["full"]
    if neural:
        ntpp: dict[str, list[NtppGMM]] = {part: [] for part in PARTS}
        for done in range(total):
            part, seed = PARTS[done // ntpp_training.FITS], done % ntpp_training.FITS
            ntpp[part].append(
                ntpp_training.fit(arrivals[part], areas, place, seed=seed, settings=settings)
            )
            tell(done + 1, total)
        NtppGMM.write(place.folder, ntpp, asdict(settings))
        found.append(ntpp["full"][0])
    return found


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
