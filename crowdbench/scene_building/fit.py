"""Fit a scene: its areas, its spawn models and its reference statistics, from its recording."""

import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from crowdbench.errors import SceneError, SettingError
from crowdbench.evaluation.parallel import call_each, checked_workers
from crowdbench.files import unwritable, write_text
from crowdbench.registry import FITTED
from crowdbench.scene import Scene
from crowdbench.scene_building.toml import with_default_clustering
from crowdbench.scoring.reference import Reference, write_reference
from crowdbench.spawn import (
    Areas,
    Arrivals,
    PoissonGMM,
    PoissonGroups,
    RenewalGMM,
    SpawnModel,
    arrivals_of,
    fit_areas,
)
from crowdbench.spawn.areas import write_areas
from crowdbench.trajectories.blocks import SPLITS
from crowdbench.trajectories.stops import standing
from crowdbench.trajectories.table import OUTCOMES, Trajectories

MODELS = tuple(FITTED)
ASTRAY = 0.03
"""Maximum share of the recorded positions outside the bounds or in a wall. Some are unavoidable: if
a person was not seen for minutes, the interpolated path may pass through a wall."""
Progress = Callable[[int, int], None]
"""Called with the number of finished fits and the number of all fits."""


def fit_scene(
    scene: Scene,
    recording: Trajectories,
    *,
    clustering: str = "default",
    models: Sequence[str] = MODELS,
    out: Path | None = None,
    workers: int | None = None,
    progress: Progress | None = None,
) -> dict[str, str]:
    """Fit the areas, spawn models and statistics of a scene and write them to its folder or `out`.

    Each spawn model is fitted to the whole recording and for each fold. `workers` is the number of
    processes, by default one per core. Returns results by name, as text for a table.

    Raises:
        SettingError: the scene has no clustering of that name, a model does not exist, or torch,
            which is required to fit `ntpp-gmm`, is not installed.
        SceneError: `scene.toml` contradicts the recording.
        OutputError: the folder cannot be written.
    """
    if clustering not in scene.clustering:
        raise SettingError(
            f"clustering of {scene.id}",
            got=repr(clustering),
            expected=f"one of {', '.join(scene.clustering)}",
            hint="The founding paper's settings exist for eth-v0, gc-v0 and forum-v0 only."
            if clustering == "paper"
            else "",
        )
    _check_models(models)
    check_against(scene, recording)
    place = replace(scene, folder=out or scene.folder)
    try:  # before the fits, which take minutes
        place.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(place.folder, error) from error
    areas, crowd = fit_areas(recording, scene, scene.clustering[clustering])
    reference = Reference.of(crowd, scene, areas)
    blocks = reference.blocks
    arrivals = {
        split: arrivals_of(crowd, blocks.training(split), len(areas.spawn)) for split in SPLITS
    }
    fits = _fit_models(models, arrivals, areas, place, checked_workers(workers), progress)
    # `out` becomes a separate scene, whose default clustering is the one that was used.
    toml = (scene.folder / "scene.toml").read_text()
    write_text(place.folder / "scene.toml", with_default_clustering(toml, clustering))
    write_areas(areas, place.folder / "areas.json")
    for name in models:
        FITTED[name].write(place.folder, fits[name])
    write_reference(reference, place)
    full = arrivals["full"]
    return {
        "persons": f"{len(crowd)}, {len(full.tick)} of them arrivals in the time blocks",
        "cut off": _cut_off(recording, crowd),
        "in walls": f"{_in_walls(scene, crowd):.2%} of the recorded positions",
        "spawn areas": f"{len(areas.spawn)}, {areas.left_out[0]:.1%} of arrivals left out",
        "goal areas": f"{len(areas.goal)}, {areas.left_out[1]:.1%} of departures left out",
        "arrivals": f"{len(full.tick) / full.exposure_s() * 60:.2f} persons per minute",
        **{name: _likelihood(fits[name]["full"], full) for name in models},
        "time blocks": f"{len(reference.blocks)}, {reference.blocks.exposure_s():.1f} s in total",
        "written to": str(place.folder),
    }


def _check_models(models: Sequence[str]) -> None:
    for name in models:
        if name not in MODELS:
            raise SettingError(
                "models", got=repr(name), expected=f"one or more of {', '.join(MODELS)}"
            )
    if "ntpp-gmm" in models:
        check_torch(", or omit the model with --models poisson-gmm poisson-groups renewal-gmm")


def has_torch() -> bool:
    """Whether torch, which is required to fit `ntpp-gmm`, is installed."""
    return importlib.util.find_spec("torch") is not None


def check_torch(hint: str = "") -> None:
    """Check that torch is installed; `hint` names an alternative to installing it.

    Raises:
        SettingError: torch, which is required to fit `ntpp-gmm`, is not installed.
    """
    if not has_torch():
        raise SettingError(
            "ntpp-gmm",
            got="no installation of torch, which fitting requires",
            expected="torch 2.4 or newer",
            hint=f'Install it in the clone with pip install -e ".[fit]"{hint}.',
        )


def _fit_models(
    models: Sequence[str],
    arrivals: Mapping[str, Arrivals],
    areas: Areas,
    scene: Scene,
    workers: int,
    progress: Progress | None,
) -> dict[str, dict[str, list[Any]]]:
    """The fits of each model for each split, by names of model and split."""
    light = [(n, split, 0) for n in models if n != "ntpp-gmm" for split in SPLITS]
    seeds = range(scene.protocol.fits if "ntpp-gmm" in models else 0)
    heavy = [("ntpp-gmm", split, k) for split in SPLITS for k in seeds]
    done: dict[tuple[str, str, int], SpawnModel] = {}
    for jobs, processes in ((light, 1), (heavy, workers)):
        settings = _ntpp_settings() if jobs is heavy and jobs else None
        tasks = [(n, arrivals[split], areas, scene, seed, settings) for n, split, seed in jobs]
        for k, model in call_each(_fit, tasks, processes, name=_named):
            if progress and not done:
                progress(0, len(light) + len(heavy))
            done[jobs[k]] = model
            if progress:
                progress(len(done), len(light) + len(heavy))
    fits: dict[str, dict[str, list[Any]]] = {n: {p: [] for p in SPLITS} for n in models}
    for name, split, k in light + heavy:
        fits[name][split].append(done[name, split, k])
    return fits


def _ntpp_settings() -> Any:
    from crowdbench.spawn import ntpp_training

    return ntpp_training.SETTINGS


def _named(name: str, *rest: object) -> str:
    return f"a fit of {name}"


def _fit(
    name: str, arrivals: Arrivals, areas: Areas, scene: Scene, seed: int, settings: Any
) -> SpawnModel:
    if name == "poisson-gmm":
        return PoissonGMM.fit(arrivals, areas)
    if name == "poisson-groups":
        return PoissonGroups.fit(arrivals, areas)
    if name == "renewal-gmm":
        return RenewalGMM.fit(arrivals, areas)
    from crowdbench.spawn import ntpp_training

    return ntpp_training.fit(arrivals, areas, scene, seed=seed, settings=settings)


def _cut_off(recording: Trajectories, crowd: Trajectories) -> str:
    """What is cut off from trips after people have reached their goals."""
    rows = 1 - len(crowd.xy) / len(recording.xy)
    stood = int(standing(recording).sum())
    still = 1 - int(standing(crowd).sum()) / stood if stood else 0.0
    return f"{rows:.1%} of the recorded positions and {still:.1%} of the standing, at goals"


def _in_walls(scene: Scene, crowd: Trajectories) -> float:
    return float((~scene.walkable(crowd.xy.astype(np.float64))).mean())


def _likelihood(fits: Sequence[SpawnModel], arrivals: Arrivals) -> str:
    each = [fit.log_likelihood(arrivals) for fit in fits]
    spread = f" ({min(each):.3f} to {max(each):.3f} in {len(each)} fits)" if len(each) > 1 else ""
    return f"{np.mean(each):.3f} nats per person{spread}"


def dwell_p99_s(recording: Trajectories) -> float:
    """The 99th percentile of the dwell times of people who entered and left, seconds."""
    whole = recording.entered & recording.left
    cut_off = recording.outcome == OUTCOMES.index("timeout")  # their length depends on this result
    dwell = (recording.last - recording.first)[whole & ~cut_off] * recording.dt_s
    return float(np.percentile(dwell, 99))


def check_against(scene: Scene, recording: Trajectories) -> None:
    """Check `scene.toml` against the recording.

    Raises:
        SceneError: it states other facts, or too many positions lie outside the bounds or in walls.
    """
    facts = (
        ("dt_s", scene.dt_s, recording.dt_s),
        ("recording.frames", scene.recording.frames, recording.frames),
        ("recording.dwell_p99_s", scene.recording.dwell_p99_s, dwell_p99_s(recording)),
    )
    wrong = [fact for fact in facts if not np.isclose(fact[1], fact[2], rtol=1e-3)]
    if wrong:
        raise SceneError(
            scene.folder / "scene.toml",
            got=", ".join(f"{name} = {stated}" for name, stated, _ in wrong),
            expected=", ".join(f"{name} = {found:.10g}" for name, _, found in wrong)
            + f", as in the recording {recording.scene}",
            hint="Correct scene.toml, or use the recording from which the scene was created.",
        )
    outside = ~scene.walkable(recording.xy.astype(np.float64))
    outside[recording.offsets[1:] - 1] = False  # simulated people may step out in their last frame
    if outside.mean() > ASTRAY:
        row = int(np.flatnonzero(outside)[0])
        raise SceneError(
            scene.folder / "scene.toml",
            got=f"{outside.mean():.1%} of the recorded positions outside the bounds or in a wall, "
            f"the first at {recording.xy[row].round(2).tolist()} m",
            expected=f"at most {ASTRAY:.0%}",
            hint="Correct the bounds and walls, or the units of the recording.",
        )
