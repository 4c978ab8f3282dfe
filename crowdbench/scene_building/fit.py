"""Fit a scene: its areas, its spawn models and its reference statistics, from its recording."""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from msgspec import structs

from crowdbench.data.blocks import SPLITS, TimeBlocks
from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.stops import standing
from crowdbench.data.table import OUTCOMES, Trajectories
from crowdbench.errors import SceneError, SettingError, WeightsError, did_you_mean, to_install
from crowdbench.files import unwritable, write_text
from crowdbench.progress import tell, whole
from crowdbench.registry import DEFAULT_FITS, FITTED, PLANNED, fitted_models
from crowdbench.run.executor import call_each, checked_workers
from crowdbench.scene import Scene
from crowdbench.scene_building.plan_calibration import adjustment
from crowdbench.scene_building.toml import refitted_toml
from crowdbench.scoring.reference import Reference, write_reference
from crowdbench.spawn import Areas, Arrivals, FittedModel, PoissonPaper, arrivals_of, fit_areas
from crowdbench.spawn.areas import read_areas, write_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.plans.files import write_plans
from crowdbench.spawn.plans.fitting import fit_plans
from crowdbench.spawn.plans.links import Adjustment
from crowdbench.spawn.plans.planned import PlannedAreas

MOST_FITS = 100
"""Largest number of fits of a model, and of rollouts of each."""
NEURAL = {
    "ntpp-gmm": "crowdbench.spawn.ntpp.training",
    "joint-gmm": "crowdbench.spawn.joint.training",
    "ntpp-paper": "crowdbench.spawn.paper.training",
}
"""Modules that train the neural models with torch."""
ASTRAY = 0.03
"""Maximum share of the recorded positions outside the bounds or in a wall. Some are unavoidable: if
a person was not seen for minutes, the interpolated path may pass through a wall."""


def fit_scene(
    scene: Scene,
    recording: Trajectories,
    *,
    clustering: str = "default",
    preprocess: Literal["", "paper"] | None = None,
    models: Sequence[str] | None = None,
    training: Mapping[str, Any] | None = None,
    fits: int | None = None,
    out: Path | None = None,
    workers: int | None = None,
) -> dict[str, str]:
    """Fit the areas, statistics, spawn models and plans of a scene; write them to it or to `out`.

    Each spawn model is fitted to the whole recording and for each fold. By default all files are
    written, with the fits of `registry.DEFAULT_FITS`. If `models` are named, only their fits are,
    and the plans if their times are from one of them; areas and statistics only into a folder
    without areas.
    With none, areas, statistics and plans are written. With `preprocess`, people
    are dropped as in the founding paper (by default as `scene.toml` says); `out` becomes a scene
    of the others. `training` holds changes
    of the settings of neural models by name of field, such as `window_frames`. `fits` is the
    number of fits of neural models, by default that of the scene. `workers` is the number of
    processes, by default one per core. Returns results by name, as text for a table.

    Raises:
        SettingError: the scene has no clustering of that name, a model or setting does not exist,
            or torch, which is required to fit neural models, is not installed.
        SceneError: `scene.toml` contradicts the recording.
        WeightsError: `models` are named, and the folder has the areas of other settings.
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
    scene, recording, dropped = _preprocessed(scene, recording, preprocess, out)
    named = DEFAULT_FITS if models is None else models
    settings = _all_settings(named, training or {})
    fits = scene.protocol.fits if fits is None else fits
    if not 1 <= fits <= MOST_FITS:
        raise SettingError("fits", got=str(fits), expected=f"1 to {MOST_FITS}")
    check_against(scene, recording)
    place = replace(scene, folder=out or scene.folder)
    try:  # before the fits, which take minutes
        place.folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(place.folder, error) from error
    with whole("areas"):
        areas, crowd = fit_areas(recording, scene, scene.clustering[clustering])
    keeps = bool(models) and (place.folder / "areas.json").exists()
    if keeps and not same_areas(read_areas(place), areas):
        raise not_a_fit(place, "areas.json")
    blocks = blocks_of(crowd, scene)
    arrivals = {
        split: arrivals_of(crowd, blocks.training(split), len(areas.spawn)) for split in SPLITS
    }
    fitted = _fit_models(named, settings, fits, arrivals, areas, place, checked_workers(workers))
    if not keeps:
        # `out` becomes a separate scene, whose default clustering is the one that was used.
        write_text(place.folder / "scene.toml", refitted_toml(scene, clustering))
        write_areas(areas, place.folder / "areas.json")
        write_reference(Reference.of(crowd, scene, areas), place)
    for name in named:
        FITTED[name].write(place.folder, fitted[name])
    if not (keeps and set(PLANNED.values()).isdisjoint(named)):
        _write_plans(crowd, blocks, areas, place, checked_workers(workers))
    full = arrivals["full"]
    in_walls = float((~scene.walkable(crowd.xy.astype(np.float64))).mean())
    return {
        **dropped,
        "persons": f"{len(crowd)}, {len(full.tick)} of them arrivals in the time blocks",
        "cut off": _cut_off(recording, crowd),
        "in walls": f"{in_walls:.2%} of the recorded positions",
        "spawn areas": f"{len(areas.spawn)}, {areas.left_out[0]:.1%} of arrivals left out",
        "goal areas": f"{len(areas.goal)}, {areas.left_out[1]:.1%} of departures left out",
        "arrivals": f"{len(full.tick) / full.exposure_s() * 60:.2f} persons per minute",
        **{name: _likelihood(fitted[name]["full"], full) for name in named},
        "time blocks": f"{len(blocks)}, {blocks.exposure_s():.1f} s in total",
        "written to": str(place.folder),
    }


def _preprocessed(
    scene: Scene, recording: Trajectories, preprocess: str | None, out: Path | None
) -> tuple[Scene, Trajectories, dict[str, str]]:
    """The scene and recording without the people that are dropped, and the counts as text."""
    if preprocess is None:
        preprocess = scene.recording.preprocess
    if preprocess not in ("", "paper"):
        raise SettingError("preprocess", got=repr(preprocess), expected="'paper'")
    if preprocess != scene.recording.preprocess and out is None:
        got = f"{preprocess!r} and no output folder"
        expected = "an output folder, because other people make another scene"
        raise SettingError("preprocess", got=got, expected=expected, hint="Add --out DIR.")
    if not preprocess:
        return scene, recording, {}
    recording, counts = paper_preprocessed(recording)
    of = structs.replace(
        scene.recording, preprocess="paper", dwell_p99_s=round(dwell_p99_s(recording), 6)
    )
    return replace(scene, recording=of), recording, counts


def _write_plans(
    crowd: Trajectories, blocks: TimeBlocks, areas: Areas, scene: Scene, workers: int
) -> None:
    """Fit plans, and adjust them to the models in the scene's folder that have plans."""
    sending = [name for name in PLANNED.values() if name in fitted_models(scene)]
    plans = {split: fit_plans(crowd, blocks.training(split), areas) for split in SPLITS}
    adjustments: dict[str, dict[str, Adjustment]] = {
        split: dict.fromkeys(sending, Adjustment()) for split in SPLITS
    }
    tasks = [
        (split, name, plans[split], blocks.training(split)) for split in SPLITS for name in sending
    ]
    tell("plans", 0, len(tasks))
    calls = call_each(_adjusted, tasks, workers, common=(crowd, areas, scene))
    for done, (k, found) in enumerate(calls, 1):
        split, name, *_ = tasks[k]
        adjustments[split][name] = found
        tell("plans", done, len(tasks))
    write_plans(scene.folder, plans, adjustments)


def _adjusted(
    split: str,
    name: str,
    plans: PlannedAreas,
    blocks: TimeBlocks,
    crowd: Trajectories,
    areas: Areas,
    scene: Scene,
) -> Adjustment:
    model: Any = FITTED[name].read(scene, areas, split, 0)
    return adjustment(model, plans, crowd, blocks, scene)


def _all_settings(models: Sequence[str], changes: Mapping[str, Any]) -> dict[str, Any]:
    """The training settings of the neural ones of these models."""
    for name in models:
        if name not in FITTED:
            expected = f"one or more of {', '.join(FITTED)}"
            hint = did_you_mean(name, FITTED)
            raise SettingError("models", got=repr(name), expected=expected, hint=hint)
    neural = [name for name in NEURAL if name in models]
    if neural:
        check_torch("Or omit the model: --models poisson-gmm poisson-groups renewal-gmm.")
    elif changes:
        got = ", ".join(changes)
        hint = "Name one with --models ntpp-gmm or --models ntpp-paper."
        raise SettingError("training", got=got, expected="none without a neural model", hint=hint)
    return {name: training_settings(name, changes) for name in neural}


def training_settings(model: str, changes: Mapping[str, Any]) -> Any:
    """The training settings of a neural model, with some of them changed.

    Raises:
        SettingError: the model has no setting of that name, or a number is not positive.
    """
    kinds = {name: type(importlib.import_module(m).DEFAULT) for name, m in NEURAL.items()}
    known = {name: [f.name for f in fields(kind)] for name, kind in kinds.items()}
    for name, value in changes.items():
        if name not in known[model]:
            others = [other for other in NEURAL if name in known[other]]
            raise SettingError(
                f"training of {model}",
                got=name,
                expected=f"one of {', '.join(known[model])}",
                hint=f"Only {others[0]} has it: name no other neural model with --models."
                if others
                else did_you_mean(name, known[model]),
            )
        if not (np.isfinite(value) and (value > 0 or isinstance(value, bool))):
            raise SettingError(name, got=str(value), expected="a positive number")
    return kinds[model](**changes)


def has_torch() -> bool:
    """Whether torch, which is required to fit neural spawn models, is installed."""
    return importlib.util.find_spec("torch") is not None


def check_torch(hint: str = "") -> None:
    """Check that torch is installed; `hint` names an alternative to installing it.

    Raises:
        SettingError: torch, which is required to fit neural spawn models, is not installed.
    """
    if not has_torch():
        raise SettingError(
            "neural spawn models",
            got="no installation of torch, which fitting requires",
            expected="torch 2.4 or newer",
            hint=f"{to_install('fit')} {hint}".rstrip(),
        )


def _fit_models(
    models: Sequence[str],
    settings: Mapping[str, Any],
    count: int,
    arrivals: Mapping[str, Arrivals],
    areas: Areas,
    scene: Scene,
    workers: int,
) -> dict[str, dict[str, list[Any]]]:
    """The fits by names of model and split; models with settings are fitted `count` times."""
    light = [(n, split, 0) for n in models if n not in settings for split in SPLITS]
    heavy = [(n, split, k) for n in settings for split in SPLITS for k in range(count)]
    fits: dict[str, dict[str, list[Any]]] = {
        n: {split: [None] * (count if n in settings else 1) for split in SPLITS} for n in models
    }
    done, total = 0, len(light) + len(heavy)
    tell("fits", done, total)
    for jobs, processes in ((light, 1), (heavy, workers)):
        tasks = [
            (n, arrivals[split], areas, scene, seed, settings.get(n)) for n, split, seed in jobs
        ]
        for k, model in call_each(_fit, tasks, processes, name=lambda n, *_: f"a fit of {n}"):
            name, split, seed = jobs[k]
            fits[name][split][seed] = model
            done += 1
            tell("fits", done, total)
    return fits


def _fit(
    name: str, arrivals: Arrivals, areas: Areas, scene: Scene, seed: int, settings: Any
) -> FittedModel:
    kind: Any = FITTED[name]
    if name in NEURAL:
        training: Any = importlib.import_module(NEURAL[name])
        model = training.fit(arrivals, areas, scene, seed=seed, settings=settings)
    elif kind is PoissonPaper:
        model = kind.fit_frames(arrivals, areas, scene)
    else:
        model = kind.fit(arrivals, areas)
    return model


def _cut_off(recording: Trajectories, crowd: Trajectories) -> str:
    """What is cut off from trips after people have reached their goals."""
    rows = 1 - len(crowd.xy) / len(recording.xy)
    stood = int(standing(recording).sum())
    still = 1 - int(standing(crowd).sum()) / stood if stood else 0.0
    return f"{rows:.1%} of the recorded positions and {still:.1%} of the standing, at goals"


def _likelihood(fits: Sequence[FittedModel], arrivals: Arrivals) -> str:
    each = [fit.log_likelihood(arrivals) for fit in fits]
    spread = f" ({min(each):.3f} to {max(each):.3f} in {len(each)} fits)" if len(each) > 1 else ""
    return f"{np.mean(each):.3f} nats per person{spread}"


def same_areas(a: Areas, b: Areas) -> bool:
    """Whether areas are the same, except for rounding."""
    pairs = ((a.spawn.mean, b.spawn.mean), (a.goal.mean, b.goal.mean), (a.flow, b.flow))
    return all(x.shape == y.shape and np.allclose(x, y, atol=1e-6) for x, y in pairs)


def not_a_fit(scene: Scene, file: str) -> WeightsError:
    """Error that a file of a scene has other values than a new fit."""
    return WeightsError(
        scene.folder / file,
        got="values that do not follow from the recording and scene.toml",
        expected="the same values as a new fit gives",
        hint=f"Run `crowdbench scene fit {scene.asked}`, then "
        f"`crowdbench scene anchors {scene.asked}`.",
    )


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
        ("grid_s", scene.grid_s, recording.grid_s),
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
