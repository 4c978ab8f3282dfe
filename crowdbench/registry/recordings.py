"""Recordings by name: imported ones, and generated ones."""

import importlib
from copy import deepcopy
from functools import cache
from pathlib import Path

from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.recordings import catalogue
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.progress import whole
from crowdbench.registry.prepared import prepared
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import fit_areas

GENERATED = {"plaza": "crowdbench.run.plaza_recording:record"}
"""Recordings that are simulated, and the functions that simulate them, imported on first use."""
RECORDINGS = (*catalogue.SOURCES, *GENERATED)
"""Names of the listed recordings. The catalogue has further days of the Forum."""


def recording(name: str) -> Trajectories:
    """Recording with the given name: an imported one, or a generated one (the plaza's).

    Raises:
        SettingError: no recording has this name.
        RecordingError: it has not been imported.
    """
    if name in GENERATED:
        path = catalogue.cached(name)
        return read_own(path) if path.exists() else _generate(name)
    return catalogue.load_imported(name)


def import_recording(name: str, source: Path | None = None) -> Trajectories:
    """Import a recording into the user's cache and return it; see `catalogue.import_recording`."""
    if name in GENERATED:
        crowd = _generate(name)
        write_parquet(crowd, catalogue.cached(name))
        return crowd
    return catalogue.import_recording(name, source)


def raw_recording_of(scene: Scene) -> Trajectories:
    """Recording of a scene, with the people that its `scene.toml` asks for.

    Raises:
        RecordingError: the recording has not been imported.
    """
    crowd = recording(scene.recording.name)
    return paper_preprocessed(crowd)[0] if scene.recording.preprocess else crowd


def recording_of(scene: str | Path | Scene) -> Trajectories:
    """Recording of a scene as models and metrics use it.

    Trips are cut off at their goals, and people are assigned to the scene's spawn and goal areas.
    The result is kept, see `crowdbench.registry.prepared`; the caller gets a copy.

    Raises:
        SceneError: the scene does not exist.
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)

    def make() -> Trajectories:
        with whole("recording"):
            return fit_areas(raw_recording_of(place), place, place.clustering["default"])[1]

    if not has_recording(place):
        return make()  # raises the error that tells how to import it
    return prepared(place, make)


def has_recording(scene: Scene) -> bool:
    """Whether the scene's recording is available: imported or generated."""
    name = scene.recording.name
    return name in GENERATED or catalogue.cached(name).exists()


def _generate(name: str) -> Trajectories:
    """Generated once in each process; everyone gets a copy of their own."""
    return deepcopy(_simulate_once(name))


@cache
def _simulate_once(name: str) -> Trajectories:
    module, _, function = GENERATED[name].partition(":")
    crowd: Trajectories = getattr(importlib.import_module(module), function)()
    return crowd
