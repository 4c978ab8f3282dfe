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
from importlib.metadata import version

import msgspec

from crowdbench.code import code_hash
from crowdbench.data.recordings import catalogue
from crowdbench.data.storage import read_own, write_parquet
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, RecordingError
from crowdbench.files import sha256
from crowdbench.scene import Scene

_READERS = "crowdbench.data.recordings"
"""Their product, the recording's table, is hashed itself."""
_PLAZA = "crowdbench.run.plaza_recording"
"""The module that generates the plaza's recording."""
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


def recording_hash(scene: Scene) -> str:
    """Hash of what a scene's recording is prepared from: table, settings and code."""
    table = catalogue.cached(scene.recording.name)
    what, code = (sha256(table.read_bytes()), ()) if table.exists() else ("generated", (_PLAZA,))
    settings = msgspec.json.encode([scene.id, scene.clustering["default"]], order="deterministic")
    hashed = code_hash("crowdbench.registry.recordings", *code, cut=(_READERS,))
    return sha256(b"".join([what.encode(), settings, scene.rules, hashed.encode()]))[:32]


def key_of(scene: Scene) -> str:
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
