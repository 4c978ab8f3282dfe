"""What the names of recordings, spawn models and policies stand for."""

import importlib
import inspect
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from crowdbench import plugins
from crowdbench.errors import CrowdbenchError, OwnCodeError, SettingError, WeightsError
from crowdbench.plugins import told
from crowdbench.policies import OnnxPolicy, Policy, Random, ReplayPolicy, SocialForce, Straight
from crowdbench.recordings import catalogue
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import (
    BlockReplay,
    NtppGMM,
    PoissonGMM,
    PoissonGroups,
    RenewalGMM,
    Replay,
    Scenario,
    SpawnModel,
    Steered,
    fit_areas,
)
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.scenario import check_scenario, read_scenario, split
from crowdbench.spawn.weights import check_part
from crowdbench.trajectories.storage import read_own, write_parquet
from crowdbench.trajectories.table import Trajectories

GENERATED = {"plaza": "crowdbench.rollouts.plaza_recording:record"}
"""Recordings that are simulated, and the functions that do it: loaded when one is asked for."""
RECORDINGS = (*catalogue.SOURCES, *GENERATED)
"""Those that are listed; the catalogue knows other days of the Forum besides."""
FITTED: dict[str, type[PoissonGMM] | type[PoissonGroups] | type[RenewalGMM] | type[NtppGMM]] = {
    "poisson-gmm": PoissonGMM,
    "poisson-groups": PoissonGroups,
    "renewal-gmm": RenewalGMM,
    "ntpp-gmm": NtppGMM,
}
"""The spawn models whose fits scenes ship."""
WEIGHTS = {
    "poisson-gmm.json": "poisson-gmm",
    "poisson-groups.json": "poisson-groups",
    "renewal-gmm.json": "renewal-gmm",
    "ntpp-gmm.safetensors": "ntpp-gmm",
}
"""The files that fits are in, and whose fits these are."""
SPAWN_MODELS = (*FITTED, "block-replay", "replay")
DEFAULT_SPAWN = "ntpp-gmm"
"""Who enters an environment where nothing else is asked for."""
COMPARED = ("poisson-gmm", "renewal-gmm", "ntpp-gmm")
"""What pages of results compare, and `evaluate` where nothing else is asked for."""
POLICIES = ("straight", "social-force", "random", "replay")


def recording(name: str) -> Trajectories:
    """A recording by its name: the imported one, or the plaza's, which is generated.

    Raises:
        SettingError: there is no recording of that name.
        RecordingError: it has not been imported.
    """
    if name in GENERATED:
        path = catalogue.cached(name)
        return read_own(path) if path.exists() else _generated(name)
    return catalogue.load_imported(name)


def import_recording(name: str, source: Path | None = None) -> Trajectories:
    """Import a recording into the user's cache; see `catalogue.import_recording`."""
    if name in GENERATED:
        crowd = _generated(name)
        write_parquet(crowd, catalogue.cached(name))
        return crowd
    return catalogue.import_recording(name, source)


def recording_of(scene: str | Path | Scene) -> Trajectories:
    """The recording of a scene, its persons assigned to the scene's areas.

    Raises:
        SceneError: there is no such scene.
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    _, crowd = fit_areas(recording(place.recording.name), place, place.clustering["default"])
    return crowd


def has_recording(scene: Scene) -> bool:
    """Whether the scene's recording is imported, or is one that is generated."""
    name = scene.recording.name
    return name in GENERATED or catalogue.cached(name).exists()


def _generated(name: str) -> Trajectories:
    module, _, function = GENERATED[name].partition(":")
    crowd: Trajectories = getattr(importlib.import_module(module), function)()
    return crowd


def spawn_model(
    model: str | SpawnModel,
    scene: str | Path | Scene,
    part: str = "full",
    fit: int = 0,
    scenario: Scenario | None = None,
) -> SpawnModel:
    """A spawn model by its name, fitted for a part (one of `blocks.PARTS`) of the recording.

    Of a model with several fits the one of index `fit`, counted round. `replay` is the whole
    recording in any part. A folder holds the fits of one of `FITTED`, in a file as scenes ship it.
    `pkg.module:Class` is called with the scene, and with `part` and `fit` where it takes arguments
    of these names. A `scenario` steers the model; `MODEL+FILE.toml` is the model MODEL under the
    scenario that the file holds.

    Raises:
        SettingError: there is no such model, part or fit, or the scenario does not fit.
        WeightsError: the scene ships no weights for it, or those of a folder are broken.
        RecordingError: it needs a recording that has not been imported.
    """
    place = load_scene(scene)
    plugins.names("spawn_models", SPAWN_MODELS)  # raises if somebody registered a name of ours
    if isinstance(model, str):
        base, file = split(model)
        model = _unsteered(base, place, part, fit)
        model = model if file is None else _steered(model, place, file)
    return model if scenario is None else _steered(model, place, scenario)


def _steered(model: SpawnModel, scene: Scene, scenario: Scenario | Path) -> Steered:
    own = getattr(model, "areas", None)
    areas = own if isinstance(own, Areas) else read_areas(scene)
    if isinstance(scenario, Path):
        scenario = read_scenario(scenario, scene, areas)
    else:
        check_scenario(scenario, scene, areas, f"scenario {scenario.name}")
    return Steered(model, scenario, areas)


def _unsteered(model: str, scene: Scene, part: str, fit: int) -> SpawnModel:
    check_part(part, fit)
    if model in FITTED:
        _check_shipped(model, scene)
        return FITTED[model].read(scene, read_areas(scene), part, fit)
    if file := weights_file(model):
        holding = replace(scene, folder=file.parent)
        return FITTED[WEIGHTS[file.name]].read(holding, read_areas(scene), part, fit)
    if model == "block-replay":
        crowd = recording_of(scene)
        return BlockReplay(crowd, blocks_of(crowd, scene).training(part), read_areas(scene))
    if model == "replay":
        return Replay(recording_of(scene))
    known = (*SPAWN_MODELS, *plugins.names("spawn_models"), "a folder with the fits of one")
    kind = plugins.part("spawn_models", model) or _own(model, "spawn model", known)
    made: SpawnModel = _made(kind, model, scene, **_understood(kind, part=part, fit=fit))
    return _having(made, model, ("name", "start", "sample"))


def _check_shipped(model: str, scene: Scene) -> None:
    """Tell who asks for fits that a scene does not have which others it has.

    Raises:
        WeightsError: the file is missing.
    """
    there = fitted_models(scene)
    if model not in there:
        torch = " (it needs torch, the extra `fit`)" if model == "ntpp-gmm" else ""
        others = ", ".join(there)
        raise WeightsError(
            next(scene.folder / file for file, name in WEIGHTS.items() if name == model),
            got="no such file",
            expected=f"the scene's fits of {model}",
            hint=f"Run `crowdbench fit {scene.asked}`{torch}"
            + (f", or name a spawn model that it has: {others}." if others else "."),
        )


def policy(named: str | Policy, scene: str | Path | Scene, part: str = "full") -> Policy:
    """A policy by its name, or from an ONNX file; `pkg.module:Class` is called without arguments.

    A folder is one of files for each part (one of `blocks.PARTS`) of the recording: `full.onnx`,
    `fold0.onnx` and so on. Policies that come with a scene stand in its folder `policies`.

    Raises:
        SettingError: there is no such policy, or ONNX files cannot be read here.
        WeightsError: the file is missing or broken.
        RecordingError: it needs a recording that has not been imported.
    """
    if not isinstance(named, str):
        return named
    plain: dict[str, Callable[[], Policy]] = {
        "straight": Straight,
        "social-force": SocialForce,
        "random": Random,
    }
    plugins.names("policies", POLICIES)  # raises if somebody registered a name of ours
    if named in plain:
        return plain[named]()
    place = load_scene(scene)
    if named == "replay":
        return ReplayPolicy(recording_of(place))
    if file := policy_file(named, place, part):
        return OnnxPolicy(file)
    others = plugins.names("policies")
    known = (*POLICIES, *trained_policies(place), *others, "an ONNX file, a folder of them")
    kind = plugins.part("policies", named) or _own(named, "policy", known)
    made: Policy = _made(kind, named)
    _having(made, named, ("name", "sees", "reset", "act"))
    if made.sees not in ("observation", "state"):
        raise SettingError(named, got=f"sees = {made.sees!r}", expected="'observation' or 'state'")
    return made


def policy_file(named: str, scene: Scene, part: str) -> Path | None:
    """The ONNX file that a policy's name stands for, None if it stands for something else."""
    check_part(part, 0)
    if named.endswith(".onnx"):
        return Path(named)
    if ":" in named:
        return None
    own = Path(named)
    folder = own if len(own.parts) > 1 else scene.folder / "policies" / named
    return folder / f"{part}.onnx" if folder.is_dir() else None


def weights_file(named: str) -> Path | None:
    """The file of fits that a spawn model's name stands for, None if it names no folder.

    Raises:
        SettingError: the folder does not hold the fits of exactly one model.
    """
    folder = Path(named)
    if named in SPAWN_MODELS or not folder.is_dir():
        return None
    found = [folder / name for name in WEIGHTS if (folder / name).is_file()]
    if len(found) != 1:
        raise SettingError(
            f"spawn model {named}",
            got=f"a folder with {', '.join(f.name for f in found) or 'no fits'}",
            expected=f"exactly one of {', '.join(WEIGHTS)}",
            hint="Put the fits of one model into a folder of their own.",
        )
    return found[0]


def list_spawn_models(scene: str | Path | Scene) -> list[str]:
    """Names of the spawn models that a scene ships or plays, and of those that others registered.

    Raises:
        SceneError: there is no such scene.
    """
    place = load_scene(scene)
    played = [name for name in SPAWN_MODELS if name not in FITTED] * has_recording(place)
    return [*fitted_models(place), *played, *plugins.names("spawn_models", SPAWN_MODELS)]


def list_policies(scene: str | Path | Scene) -> list[str]:
    """Names of the policies that every scene has, that this one ships, and that others registered.

    Raises:
        SceneError: there is no such scene.
    """
    place = load_scene(scene)
    plain = [name for name in POLICIES if name != "replay" or has_recording(place)]
    return [*plain, *trained_policies(place), *plugins.names("policies", POLICIES)]


def add_metric(path: str) -> None:
    """Register the metric `pkg.module:Class` for this process and its workers.

    Raises:
        SettingError: it cannot be imported, or has no name.
        OwnCodeError: its module or class raised something.
    """
    if path in plugins.names("metrics"):
        return
    kind = _own(path, "metric", tuple(plugins.names("metrics")))
    metric = _having(_made(kind, path), path, ("name", "family", "summarise", "embed"))
    plugins.register("metrics", metric.name, metric)


def fitted_models(scene: Scene) -> list[str]:
    """Names of the spawn models whose fits are in a scene's folder."""
    return [name for file, name in WEIGHTS.items() if (scene.folder / file).is_file()]


def trained_policies(scene: Scene) -> list[str]:
    """Names of the policies that come with a scene."""
    folder = scene.folder / "policies"
    return sorted(f.name for f in folder.iterdir() if f.is_dir()) if folder.is_dir() else []


def _own(path: str, kind: str, known: tuple[str, ...]) -> Callable[..., Any]:
    module, colon, attribute = path.partition(":")
    if not colon:
        named = f"one of {', '.join(known)}, or " if known else ""
        raise SettingError(kind, got=repr(path), expected=f"{named}pkg.module:Class")
    try:
        found: Callable[..., Any] = getattr(importlib.import_module(module), attribute)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        raise SettingError(
            kind,
            got=f"{path!r} ({error})",
            expected="a class that can be imported",
            hint="Install its package, or run where Python finds it.",
        ) from error
    except Exception as error:
        raise OwnCodeError(
            f"{kind} {path}", got=f"{told(error)} on import", expected="a module without errors"
        ) from error
    return found


def _understood(kind: Callable[..., Any], **offered: object) -> dict[str, object]:
    """Those of the arguments that it takes by name."""
    try:
        taken = inspect.signature(kind).parameters
    except (TypeError, ValueError):
        return {}
    return {name: value for name, value in offered.items() if name in taken}


def _made(kind: Callable[..., Any], path: str, *arguments: object, **named: object) -> Any:
    try:
        return kind(*arguments, **named)
    except CrowdbenchError:
        raise
    except Exception as error:
        called = error.__traceback__ is not None and error.__traceback__.tb_next is not None
        if isinstance(error, TypeError) and not called:
            raise SettingError(
                path,
                got=str(error),
                expected="a class that is called with the scene (spawn models) or without "
                "arguments (policies)",
            ) from error
        raise OwnCodeError(path, got=told(error), expected="no error when it is called") from error


def _having(made: Any, path: str, needed: tuple[str, ...]) -> Any:
    missing = [name for name in needed if not hasattr(made, name)]
    if missing:
        raise SettingError(
            path, got=f"an object without {', '.join(missing)}", expected=f"{', '.join(needed)}"
        )
    return made
