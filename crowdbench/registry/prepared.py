"""Prepared recordings are kept: clustering and cutting Grand Central takes seconds.

A prepared recording depends on the recording's table, the scene's settings, crowdbench's code and
the libraries that cluster. Their hash is its key. Within a process, the last few are kept in
memory. On disk they are in the folder `prepared` of `CROWDBENCH_HOME`, for worker processes and
later calls. A file's name holds the key and the hash of its content, so a stale file is not found
and a damaged one is not used: either is made anew.
"""

from collections.abc import Callable
from contextlib import suppress
from copy import deepcopy
from functools import cache
from importlib.metadata import version
from pathlib import Path

import msgspec

from crowdbench import __version__
from crowdbench.data.recordings import catalogue
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, RecordingError
from crowdbench.files import sha256
from crowdbench.scene import Scene

_CODE = ("data", "spawn", "simulation", "policies", "registry", "run")
"""Parts that prepare recordings, and that generate the plaza's."""
_LIBRARIES = ("numpy", "scipy", "scikit-learn")
_IN_MEMORY = 4
_ON_DISK = 8
"""Maximum number of files per recording: one for each of its scenes, and some of earlier code."""
_memory: dict[str, Trajectories] = {}


def prepared(scene: Scene, make: Callable[[], Trajectories]) -> Trajectories:
    """The prepared recording of a scene: the kept one, or that of `make()`, which is then kept.

    Everyone gets a copy of their own.
    """
    key = key_of(scene)
    crowd = _memory.pop(key, None)
    if crowd is None:
        crowd = _read(scene, key)
    if crowd is None:
        crowd = make()
        _write(crowd, scene, key)
    _memory[key] = crowd  # at the end, because it was used last
    while len(_memory) > _IN_MEMORY:
        del _memory[next(iter(_memory))]
    return deepcopy(crowd)


def key_of(scene: Scene) -> str:
    """Hash of everything that a prepared recording depends on."""
    table = catalogue.cached(scene.recording.name)
    what = sha256(table.read_bytes()) if table.exists() else "generated"
    settings = msgspec.json.encode([scene.id, scene.clustering["default"]], order="deterministic")
    return sha256(b"".join([what.encode(), settings, scene.rules, _code()]))[:32]


@cache
def _code() -> bytes:
    package = Path(__file__).parents[1]
    files = [
        package / "compilation.py",
        package / "scene.py",
        *(f for p in _CODE for f in sorted(package.glob(f"{p}/**/*.py"))),
    ]
    made_with = [f"{name} {version(name)}" for name in _LIBRARIES]
    hashes = [sha256(file.read_bytes()) for file in files]
    return "\n".join([__version__, *made_with, *hashes]).encode()


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
