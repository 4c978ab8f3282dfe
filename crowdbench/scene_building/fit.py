"""Fit a scene: its areas, its spawn models and its reference statistics, from its recording."""

import importlib.util
import re
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
from crowdbench.trajectories.blocks import PARTS
from crowdbench.trajectories.table import OUTCOMES, Trajectories

MODELS = tuple(FITTED)
ASTRAY = 0.03
"""Share of the recorded positions that may lie outside the bounds or in a wall: where someone was
not seen for minutes, a straight line through a kiosk is all that a recording knows."""
Progress = Callable[[int, int], None]
"""Is called with the number of fits that are done, and of all."""


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
    """Fit everything that a scene ships and write it into its folder, or into `out`.

    Each spawn model is fitted for the whole recording and for each fold, by `workers` processes
    (by default one per core). Returns what was found, as text for a table.

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
            hint="The founding paper's settings are known for eth-v0, gc-v0 and forum-v0."
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
    arrivals = {part: arrivals_of(crowd, blocks.training(part), len(areas.spawn)) for part in PARTS}
    fits = _fit_models(models, arrivals, areas, place, checked_workers(workers), progress)
    # A folder with a scene.toml is a scene of its own; what it was fitted with is its default.
    toml = (scene.folder / "scene.toml").read_text()
    write_text(place.folder / "scene.toml", _with_default(toml, clustering))
    write_areas(areas, place.folder / "areas.json")
    for name in models:
        FITTED[name].write(place.folder, fits[name])
    write_reference(reference, place)
    full = arrivals["full"]
    return {
        "persons": f"{len(crowd)}, {len(full.tick)} of them arrivals in the time blocks",
        "in walls": f"{_in_walls(scene, crowd):.2%} of the recorded positions",
        "spawn areas": f"{len(areas.spawn)}, {areas.left_out[0]:.1%} of arrivals left out",
        "goal areas": f"{len(areas.goal)}, {areas.left_out[1]:.1%} of departures left out",
        "arrivals": f"{len(full.tick) / full.exposure_s() * 60:.2f} persons per minute",
        **{name: _likelihood(fits[name]["full"], full) for name in models},
        "time blocks": f"{len(reference.blocks)}, {reference.blocks.exposure_s():.1f} s in all",
        "written to": str(place.folder),
    }


def _with_default(toml: str, clustering: str) -> str:
    """The text of a `scene.toml` whose default clustering is the named one."""
    bodies = dict(re.findall(r"^\[clustering\.(\w+)\]\n([^\[]*)", toml, flags=re.M))
    return toml.replace(
        f"[clustering.default]\n{bodies['default'].rstrip()}\n",
        f"[clustering.default]\n{bodies[clustering].rstrip()}\n",
    )


def _check_models(models: Sequence[str]) -> None:
    for name in models:
        if name not in MODELS:
            raise SettingError("models", got=repr(name), expected=f"some of {', '.join(MODELS)}")
    if "ntpp-gmm" in models:
        check_torch(", or leave it out: --models poisson-gmm poisson-groups renewal-gmm")


def has_torch() -> bool:
    """Whether torch, which `ntpp-gmm` is fitted with, is installed."""
    return importlib.util.find_spec("torch") is not None


def check_torch(hint: str = "") -> None:
    """Refuse to begin what cannot be ended; `hint` is what else than installing torch would help.

    Raises:
        SettingError: torch, which `ntpp-gmm` is fitted with, is not installed.
    """
    if not has_torch():
        raise SettingError(
            "ntpp-gmm",
            got="no torch to fit it with",
            expected="torch 2.4 or newer",
            hint=f'Install it, in the clone: pip install -e ".[fit]"{hint}.',
        )


def _fit_models(
    models: Sequence[str],
    arrivals: Mapping[str, Arrivals],
    areas: Areas,
    scene: Scene,
    workers: int,
    progress: Progress | None,
) -> dict[str, dict[str, list[Any]]]:
    """The fits of each model for each part."""
    light = [(n, part, 0) for n in models if n != "ntpp-gmm" for part in PARTS]
    seeds = range(scene.protocol.fits if "ntpp-gmm" in models else 0)
    heavy = [("ntpp-gmm", part, k) for part in PARTS for k in seeds]
    done: dict[tuple[str, str, int], SpawnModel] = {}
    for jobs, processes in ((light, 1), (heavy, workers)):
        settings = _ntpp_settings() if jobs is heavy and jobs else None
        tasks = [(n, arrivals[part], areas, scene, seed, settings) for n, part, seed in jobs]
        for k, model in call_each(_fit, tasks, processes, name=_named):
            if progress and not done:
                progress(0, len(light) + len(heavy))
            done[jobs[k]] = model
            if progress:
                progress(len(done), len(light) + len(heavy))
    fits: dict[str, dict[str, list[Any]]] = {n: {p: [] for p in PARTS} for n in models}
    for name, part, k in light + heavy:
        fits[name][part].append(done[name, part, k])
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


def _in_walls(scene: Scene, crowd: Trajectories) -> float:
    return float((~scene.walkable(crowd.xy.astype(np.float64))).mean())


def _likelihood(fits: Sequence[SpawnModel], arrivals: Arrivals) -> str:
    each = [fit.log_likelihood(arrivals) for fit in fits]
    spread = f" ({min(each):.3f} to {max(each):.3f} in {len(each)} fits)" if len(each) > 1 else ""
    return f"{np.mean(each):.3f} nats per person{spread}"


def dwell_p99_s(recording: Trajectories) -> float:
    """The 99th percentile of the dwell times of those who entered and left."""
    whole = recording.entered & recording.left
    cut_off = recording.outcome == OUTCOMES.index("timeout")  # says how patient the rule is
    dwell = (recording.last - recording.first)[whole & ~cut_off] * recording.dt_s
    return float(np.percentile(dwell, 99))


def check_against(scene: Scene, recording: Trajectories) -> None:
    """Hold the facts that `scene.toml` states of its recording against the recording.

    Raises:
        SceneError: they differ, or people walk outside the bounds or in walls.
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
            hint="Correct it, or fit with the recording that the scene is made from.",
        )
    outside = ~scene.walkable(recording.xy.astype(np.float64))
    outside[recording.offsets[1:] - 1] = False  # a simulated person's last step may lead there
    if outside.mean() > ASTRAY:
        row = int(np.flatnonzero(outside)[0])
        raise SceneError(
            scene.folder / "scene.toml",
            got=f"{outside.mean():.1%} of the recorded positions outside the bounds or in a wall, "
            f"the first at {recording.xy[row].round(2).tolist()} m",
            expected=f"{ASTRAY:.0%} at most",
            hint="Correct the bounds and walls, or the units of the recording.",
        )
