"""Spawn models by name."""

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from crowdbench import plugins, spawn
from crowdbench.errors import SettingError, WeightsError, checked
from crowdbench.registry.dependencies import Dependencies, files_of
from crowdbench.registry.recordings import has_recording, recording_of
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn.areas import Areas, read_areas
from crowdbench.spawn.events import blocks_of
from crowdbench.spawn.fits import check_split
from crowdbench.spawn.names import PERTURBED, with_key
from crowdbench.spawn.plans.files import FILE as PLANS
from crowdbench.spawn.plans.files import read_plans
from crowdbench.spawn.steering.scenario import check_scenario, read_scenario, split_scenario

FITTED: dict[str, Any] = {
    "poisson-gmm": spawn.PoissonGMM,
    "poisson-groups": spawn.PoissonGroups,
    "renewal-gmm": spawn.RenewalGMM,
    "ntpp-gmm": spawn.NtppGMM,
    "cox-gmm": spawn.CoxGMM,
    "joint-gmm": spawn.JointGMM,
    "poisson-paper": spawn.PoissonPaper,
    "ntpp-paper": spawn.NtppPaper,
}
"""Spawn models that are fitted to a recording; scenes ship their fits."""
DEFAULT_FITS = ("poisson-gmm", "poisson-groups", "renewal-gmm", "cox-gmm", "ntpp-gmm")
"""Models that `scene fit` and `scene create` fit: all but those of the founding paper, and
`joint-gmm`, which takes long."""
_NETWORKS = ("ntpp-gmm", "joint-gmm", "ntpp-paper")
WEIGHTS = {f"{name}.safetensors" if name in _NETWORKS else f"{name}.json": name for name in FITTED}
"""File name of the fits of each spawn model in `FITTED`."""
PLANNED = {
    "poisson-plans": "poisson-groups",
    "ntpp-plans": "ntpp-gmm",
    "cox-plans": "cox-gmm",
    "ntpp-joint": "joint-gmm",
}
"""Models of plans, and the model in `FITTED` that their times are from."""
_PLAYED: dict[str, type[spawn.BlockReplay | spawn.PerturbedReplay | spawn.Replay]] = {
    "block-replay": spawn.BlockReplay,
    "replay": spawn.Replay,
    PERTURBED: spawn.PerturbedReplay,
}
SPAWN_MODELS = (*FITTED, *PLANNED, *_PLAYED)
DEFAULT_SPAWN = "ntpp-gmm"
"""Default spawn model of the environments."""


@dataclass(frozen=True)
class SpawnSource:
    """What the name of a spawn model refers to on a scene, found once by `spawn_source`."""

    name: str
    scene: Scene
    base: str
    """The name without its scenario."""
    scenario: Path | None
    fits: Path | None
    """File with the fits of a model in `FITTED`: the scene's, or that of another folder."""
    own: bool
    """Whether it is a class of a user or another package, which `model` imports."""

    def model(self, split: str = "full", fit: int = 0) -> spawn.SpawnModel:
        """The model, fitted to a split; see `spawn_model`."""
        check_split(split, fit)
        model = self._build(split, fit)
        return model if self.scenario is None else _steer(model, self.scene, self.scenario)

    def dependencies(self) -> Dependencies:
        """What its rollouts depend on."""
        folder = self.scene.folder
        scenario = () if self.scenario is None else (self.scenario,)
        if self.own:
            return Dependencies.of_own("spawn_models", self.base, *scenario, *files_of(folder))
        files = (folder / "areas.json", *scenario)
        modules = (spawn.Steered.__module__,) * len(scenario)
        if self.fits is None:
            modules += (_PLAYED[self.base.partition(":")[0]].__module__,)
            return Dependencies(self.base, modules, files, recording=True)
        times = WEIGHTS[self.fits.name]
        modules += (FITTED[times].__module__,)
        if self.base in PLANNED:
            modules += (read_plans.__module__,)
            return Dependencies(self.base, modules, (*files, self.fits, folder / PLANS))
        return Dependencies(times, modules, (*files, self.fits))

    def _build(self, split: str, fit: int) -> spawn.SpawnModel:
        scene = self.scene
        if self.fits is not None:
            holding, times = replace(scene, folder=self.fits.parent), WEIGHTS[self.fits.name]
            areas = read_areas(scene)
            if self.base not in PLANNED:
                return FITTED[times].read(holding, areas, split, fit)
            areas = read_plans(scene, areas, split, times)
            return replace(FITTED[times].read(holding, areas, split, fit), name=self.base)
        if self.own:
            known = (*SPAWN_MODELS, "a folder with the fits of one model")
            kind = plugins.find("spawn_models", self.base, known)
            needed = ("name", "start", "sample")
            model: spawn.SpawnModel = plugins.create(
                kind, self.base, scene, needed=needed, split=split, fit=fit
            )
            return model
        crowd = recording_of(scene)
        if self.base == "replay":
            return spawn.Replay(crowd)
        if (key := with_key(self.base)) is not None:
            return spawn.PerturbedReplay(crowd, key)
        return spawn.BlockReplay(crowd, blocks_of(crowd, scene).training(split), read_areas(scene))


def spawn_source(name: str, scene: Scene) -> SpawnSource:
    """Find what the name of a spawn model refers to on a scene.

    Raises:
        SettingError: a folder does not contain the fits of exactly one model, or a key is invalid.
        WeightsError: the scene has no fits of this model.
    """
    plugins.names("spawn_models", SPAWN_MODELS)  # raises an error if a built-in name was registered
    base, scenario = split_scenario(name)
    fits = _fits_of(base, scene)
    if base.startswith(f"{PERTURBED}:") and with_key(base) is None:
        expected = f"{PERTURBED}:KEY, with a key of letters, digits and _"
        raise SettingError("spawn model", got=repr(base), expected=expected)
    own = fits is None and base not in SPAWN_MODELS and with_key(base) is None
    return SpawnSource(name, scene, base, scenario, fits, own)


@checked()
def spawn_model(
    model: str | spawn.SpawnModel,
    scene: str | Path | Scene,
    split: str = "full",
    fit: int = 0,
    scenario: spawn.Scenario | None = None,
) -> spawn.SpawnModel:
    """Spawn model with the given name, fitted to a split of the recording.

    Args:
        model: a name; a folder with the fits of one model of `FITTED`, in a file named as in
            `WEIGHTS`; `pkg.module:Class`, which is called with the scene, and with `split` and
            `fit` if it takes arguments of these names; `MODEL+FILE.toml`, the model MODEL steered
            by the scenario in the file; `perturbed-replay:KEY`, with other draws for each key; or
            a spawn model.
        scene: an id from `list_scenes()`, a folder with a `scene.toml`, or a `Scene`.
        split: one of `blocks.SPLITS`. `replay` is the whole recording in every split.
        fit: index of the fit, modulo the number of fits.
        scenario: a scenario that steers the model.

    Raises:
        SettingError: there is no such model, split or fit, or the scenario does not fit.
        WeightsError: the scene has no fits of this model, or those in the folder are invalid.
        RecordingError: it needs a recording that is not imported.
    """
    place = load_scene(scene)
    if isinstance(model, str):
        check_split(split, fit)
        model = spawn_source(model, place).model(split, fit)
    return model if scenario is None else _steer(model, place, scenario)


def _steer(model: spawn.SpawnModel, scene: Scene, scenario: spawn.Scenario | Path) -> spawn.Steered:
    own = getattr(model, "areas", None)
    areas = own if isinstance(own, Areas) else read_areas(scene)
    if isinstance(scenario, Path):
        scenario = read_scenario(scenario, scene, areas)
    else:
        check_scenario(scenario, scene, areas, f"scenario {scenario.name}")
    return spawn.Steered(model, scenario, areas)


def _fits_of(model: str, scene: Scene) -> Path | None:
    if model in FITTED or model in PLANNED:
        return _shipped_fits(PLANNED.get(model, model), scene)
    folder = Path(model)
    if model in SPAWN_MODELS or not folder.is_dir():
        return None
    found = [folder / name for name in WEIGHTS if (folder / name).is_file()]
    if len(found) != 1:
        got = f"a folder with {', '.join(f.name for f in found) or 'no fits'}"
        expected = f"exactly one of {', '.join(WEIGHTS)}"
        hint = "Put the fits of each model into a separate folder."
        raise SettingError(f"spawn model {model}", got=got, expected=expected, hint=hint)
    return found[0]


def _shipped_fits(model: str, scene: Scene) -> Path:
    file = next(scene.folder / file for file, name in WEIGHTS.items() if name == model)
    if not file.is_file():
        torch = " (it needs torch, the extra `fit`)" if model in _NETWORKS else ""
        extra = " --models " + model if model not in DEFAULT_FITS else ""
        others = ", ".join(fitted_models(scene))
        raise WeightsError(
            file,
            got="no such file",
            expected=f"the scene's fits of {model}",
            hint=f"Run `crowdbench scene fit {scene.asked}{extra}`{torch}"
            + (f", or choose a fitted spawn model: {others}." if others else "."),
        )
    return file


@checked()
def list_spawn_models(scene: str | Path | Scene) -> list[str]:
    """Names of the spawn models of a scene: fitted, replayed, and registered by packages.

    Raises:
        SceneError: the scene does not exist.
    """
    place = load_scene(scene)
    fitted = fitted_models(place)
    planned = [name for name, times in PLANNED.items() if times in fitted]
    planned *= (place.folder / PLANS).is_file()
    played = [*_PLAYED] * has_recording(place)
    return [*fitted, *planned, *played, *plugins.names("spawn_models", SPAWN_MODELS)]


def fitted_models(scene: Scene) -> list[str]:
    """Names of the spawn models whose fits are in a scene's folder."""
    return [name for file, name in WEIGHTS.items() if (scene.folder / file).is_file()]
