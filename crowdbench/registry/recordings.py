"""Recordings by name: imported ones, generated ones, and those prepared for a scene.

Preparing, that is clustering and cutting, takes seconds on Grand Central, so the result is kept. It
depends on the recording's table, the scene's settings, crowdbench's code and the libraries that
cluster; their hash is its key. Within a process, the last few are kept in memory. On disk they are
in the folder `prepared` of `CROWDBENCH_HOME`, for worker processes and later calls. A file's name
holds the key and the hash of its content, so a stale file is not found and a damaged one is not
used: either is made anew.
"""

import importlib
from contextlib import suppress
from copy import deepcopy
from functools import cache
from importlib.metadata import version
from pathlib import Path

import msgspec

from crowdbench.code import code_hash
from crowdbench.data.preprocessing import paper_preprocessed
from crowdbench.data.recordings import catalogue
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, RecordingError, checked
from crowdbench.files import sha256
from crowdbench.progress import whole
from crowdbench.scene import Scene, load_scene
from crowdbench.spawn import fit_areas

GENERATED = {"plaza": "crowdbench.run.plaza_recording:record"}
"""Recordings that are simulated, and the functions that simulate them, imported on first use."""
RECORDINGS = (*catalogue.SOURCES, *GENERATED)
"""Names of the listed recordings. The catalogue has further days of the Forum."""
_READERS = "crowdbench.data.recordings"  # their product, the recording's table, is hashed itself
_LIBRARIES = ("numpy", "scipy", "scikit-learn")
_IN_MEMORY = 4
_ON_DISK = 8
"""Maximum number of files per recording: one for each of its scenes, and some of earlier code."""
_memory: dict[str, Trajectories] = {}


@checked()
def recording(name: str) -> Trajectories:
    """Recording with the given name: an imported one, or a generated one (the plaza's).

    Raises:
        SettingError: no recording has this name.
        RecordingError: it has not been imported.
    """
    if name in GENERATED and not catalogue.cached(name).exists():
        return deepcopy(_generated(name))
    return catalogue.load_imported(name)


def import_recording(name: str, source: Path | None = None) -> Trajectories:
    """Import a recording into the user's cache and return it; see `catalogue.import_recording`."""
    if name in GENERATED:
        write_parquet(_generated(name), catalogue.cached(name))
        return deepcopy(_generated(name))
    return catalogue.import_recording(name, source)


def raw_recording_of(scene: Scene) -> Trajectories:
    """Recording of a scene, with the people that its `scene.toml` asks for.

    Raises:
        RecordingError: the recording has not been imported.
    """
    crowd = recording(scene.recording.name)
    return paper_preprocessed(crowd)[0] if scene.recording.preprocess else crowd


@checked()
def recording_of(scene: str | Path | Scene) -> Trajectories:
    """Recording of a scene as models and metrics use it.

    Trips are cut off at their goals, and people are assigned to the scene's spawn and goal areas.
    The result is kept; the caller gets a copy.

    Raises:
        SceneError: the scene does not exist.
        RecordingError: the recording has not been imported.
    """
    place = load_scene(scene)
    if not has_recording(place):
        return recording(place.recording.name)  # raises the error that tells how to import it
    key = _key(place)
    crowd = _memory.pop(key, None) or _read(place, key)
    if crowd is None:
        with whole("recording"):
            crowd = fit_areas(raw_recording_of(place), place, place.clustering["default"])[1]
        _write(crowd, place, key)
    _memory[key] = crowd  # at the end, because it was used last
    while len(_memory) > _IN_MEMORY:
        del _memory[next(iter(_memory))]
    return deepcopy(crowd)


def has_recording(scene: Scene) -> bool:
    """Whether the scene's recording is available: imported or generated."""
    name = scene.recording.name
    return name in GENERATED or catalogue.cached(name).exists()


def recording_hash(scene: Scene) -> str:
    """Hash of what a scene's recording is prepared from: table, settings and code."""
    table = catalogue.cached(scene.recording.name)
    what, made_by = "generated", [home.partition(":")[0] for home in GENERATED.values()]
    if table.exists():
        what, made_by = sha256(table.read_bytes()), []
    settings = msgspec.json.encode([scene.id, scene.clustering["default"]], order="deterministic")
    hashed = code_hash("crowdbench.registry.recordings", *made_by, cut=(_READERS,))
    return sha256(b"".join([what.encode(), settings, scene.rules, hashed.encode()]))[:32]


def _key(scene: Scene) -> str:
    """Hash of everything that a prepared recording depends on: also the libraries that cluster."""
    made_with = [f"{name} {version(name)}" for name in _LIBRARIES]
    return sha256("\n".join([recording_hash(scene), *made_with]).encode())[:32]


def _read(scene: Scene, key: str) -> Trajectories | None:
    """The kept recording; None if there is none, or if its file is damaged."""
    for path in catalogue.prepared_folder(scene.recording.name).glob(f"{key}-*.parquet"):
        with suppress(OSError, RecordingError):
            if path.stem == f"{key}-{sha256(path.read_bytes())[:32]}":
                return read_own(path)
        with suppress(OSError):
            path.unlink()
    return None


def _write(crowd: Trajectories, scene: Scene, key: str) -> None:
    """Keep a prepared recording on disk, if that is possible, and remove the oldest ones."""
    folder = catalogue.prepared_folder(scene.recording.name)
    made = folder / f"{key}.parquet"
    # Another process may write the same bytes at the same time, and rename its file first.
    with suppress(OSError, OutputError):
        write_parquet(crowd, made)
        made.replace(folder / f"{key}-{sha256(made.read_bytes())[:32]}.parquet")
        kept = sorted(folder.glob("*-*.parquet"), key=lambda path: path.stat().st_mtime_ns)
        for path in kept[:-_ON_DISK]:
            path.unlink(missing_ok=True)


@cache
def _generated(name: str) -> Trajectories:
    """The simulated recording; callers copy it before they pass it on."""
    module, _, function = GENERATED[name].partition(":")
    crowd: Trajectories = getattr(importlib.import_module(module), function)()
    return crowd
