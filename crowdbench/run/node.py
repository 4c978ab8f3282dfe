"""What runs on a node of a Ray cluster: tasks of `ray_engine`, with files of their own."""

import os
import pickle
import shutil
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import cache, lru_cache
from pathlib import Path
from typing import Any, NamedTuple

from crowdbench import plugins
from crowdbench.files import replacing
from crowdbench.run.parallel import outcome_of
from crowdbench.scene import scenes_folder

Files = dict[str, bytes]
"""Contents of files by name: `0/full.parquet` is in the first folder of those of a task."""
PLACES: Mapping[str, Callable[[], Path]] = {"scenes": scenes_folder, "working": Path.cwd}
"""Folders that are on all nodes, in different places."""

_TASK = "crowdbench-task-"
_KEPT_S = 7 * 24 * 3600.0
"""Time after which code and recordings that nobody uses are removed from a node, seconds."""

_folder = Path()
"""Folder of the files of the task that runs."""


class Given(NamedTuple):
    """What tasks have in common: hashes of objects, and references to them."""

    code: tuple[str, Any]
    """The archive of crowdbench, the scenes and the user's code."""
    shared: tuple[str, Any]
    """The function and its common arguments, and what was registered, pickled."""
    recordings: tuple[str, Any]
    """Contents of the imported recordings by file name."""
    reads: tuple[str, Any]
    """Contents of files in the working directory by their place."""

    def parts(self) -> tuple[tuple[str, Any], ...]:
        """The same without the class, which a node does not know yet."""
        return tuple(self)


def of_task(name: str) -> Path:
    """Path of a file of the task that runs, or of its folder, which exists."""
    path = _folder / name
    (path.parent if "/" in name else path).mkdir(exist_ok=True)
    return path


def placed(place: str, path: str) -> Path:
    """A path in one of `PLACES`."""
    return PLACES[place]() / path


def work(packed: bytes, sent: Files, given: Given) -> tuple[bytes, Files]:
    """Run a task; return its outcome, pickled, and the files that it wrote."""
    global _folder
    _use_one_thread()
    _clean()
    _import(*given.recordings)
    _put_in_place(*given.reads)
    with tempfile.TemporaryDirectory(prefix=f"{_TASK}{os.getpid()}-") as folder:
        _folder = Path(folder)
        for name, data in sent.items():
            (_folder / name).parent.mkdir(exist_ok=True)
            (_folder / name).write_bytes(data)
        outcome = bytes(outcome_of(_called, (given.shared, packed)))
        found = {
            f"{path.parent.name}/{path.name}": path.read_bytes()
            for path in sorted(_folder.glob("*/*"))
            if path.is_file() and not path.name.startswith(".")
        }
    return outcome, {name: data for name, data in found.items() if data != sent.get(name)}


def _called(shared: tuple[str, Any], packed: bytes) -> Any:
    function, common = _unpacked(*shared)
    return function(*pickle.loads(packed), *common)


@lru_cache(maxsize=1)
def _unpacked(digest: str, shared: Any) -> tuple[Callable[..., Any], tuple[object, ...]]:
    import ray

    packed, registered = ray.get(shared)
    plugins.restore(registered)
    return pickle.loads(packed)


@cache
def _clean() -> None:
    """Remove what killed workers have left, and code and recordings of long ago."""
    root = Path(tempfile.gettempdir())
    for path in root.glob("crowdbench-*"):
        with suppress(OSError):
            if path.stat().st_uid != os.getuid():
                continue
            if path.name.startswith(_TASK):
                number = path.name.removeprefix(_TASK).partition("-")[0]
                left = number.isdecimal() and not _runs(int(number))
            else:
                kept = path.name.startswith(("crowdbench-code-", "crowdbench-home-"))
                left = kept and time.time() - path.stat().st_mtime > _KEPT_S
            if left:
                shutil.rmtree(path, ignore_errors=True)


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except PermissionError:
        return True
    return True


@cache
def _use_one_thread() -> None:
    import numba

    numba.set_num_threads(1)  # the workers of a node already use all cores


@lru_cache(maxsize=1)
def _import(digest: str, recordings: Any) -> None:
    """Write the recordings to this node, unless another worker has."""
    import ray

    there = Path(tempfile.gettempdir()) / f"crowdbench-home-{os.getuid()}-{digest}"
    if not (there / "complete").exists():
        for name, data in ray.get(recordings).items():
            _write(there / "recordings" / name, data)
        _write(there / "complete", b"")
    os.utime(there)
    os.environ["CROWDBENCH_HOME"] = str(there)


@lru_cache(maxsize=64)
def _put_in_place(digest: str, reads: Any) -> None:
    import ray

    for place, data in ray.get(reads).items():
        _write(Path.cwd() / place, data)


def _write(path: Path, data: bytes) -> None:
    if not path.is_file() or path.read_bytes() != data:  # other workers may read it
        with replacing(path) as temporary:
            temporary.write_bytes(data)
