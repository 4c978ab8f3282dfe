"""Parallel work on a Ray cluster, whose nodes need no shared disk and no copy of crowdbench.

Nodes need Python and the packages that crowdbench depends on. Ray brings them the code: crowdbench
with its scenes, and the Python files of the working directory (`runtime_env`). Files that tasks
read or write, and the imported recordings, are copied there and back: this process, the driver,
writes all results. If a node dies, Ray does its tasks again.
"""

import copyreg
import logging
import os
import pickle
import signal
import socket
import threading
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from functools import lru_cache
from io import BytesIO
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import crowdbench
from crowdbench import baselines, plugins
from crowdbench.errors import SettingError, WorkerError, to_install
from crowdbench.files import home, replacing, sha256, temporary_folder
from crowdbench.run.processes import Stopped, outcome_of, result_of
from crowdbench.scene import scenes_folder

Result = TypeVar("Result")
Files = dict[str, bytes | None]
"""Contents of files by name; None: there is no such file yet."""

NAME = "ray"
CLIENT = "ray://"
TRIES_AGAIN = 4
"""Number of times that a task is done again if its node or its process dies."""
_REACHED_S = 20.0
"""Longest time in which a connection to the cluster is made, seconds."""
_NOT_CODE = ("__pycache__", "results", "build", "dist", "node_modules", "site-packages")
"""Folders of the working directory whose Python files are not sent."""


@contextmanager
def connected(address: str) -> Iterator[None]:
    """Connect to the cluster and send it the code, unless this process is connected.

    `ray` stands for the cluster in `RAY_ADDRESS` or on this machine, else one is started here. Who
    is connected already has decided what code the nodes have.

    Raises:
        SettingError: Ray is not installed, or there is no cluster at the address.
    """
    try:
        import ray
    except ImportError as error:
        raise SettingError(
            "engine",
            got=f"{address!r} without the package ray",
            expected="an installation of Ray",
            hint=to_install("ray"),
        ) from error
    if ray.is_initialized():
        yield
        return
    where = address if address.startswith(CLIENT) else None
    named = os.environ.get("RAY_ADDRESS", "")
    stopping = signal.getsignal(signal.SIGTERM)
    try:
        host, _, port = (where or named).removeprefix(CLIENT).rpartition(":")
        if host and port.isdecimal():  # Ray would wait for up to 14 minutes
            socket.create_connection((host.strip("[]"), int(port)), _REACHED_S).close()
        with temporary_folder("code") as folder:
            ray.init(
                address=where,
                runtime_env=_code(folder),
                log_to_driver=False,
                logging_level=logging.ERROR,
            )
    except Exception as error:  # Ray's errors have no common base class
        raise SettingError(
            "engine",
            got=f"{address!r}{f' with RAY_ADDRESS={named}' if named and not where else ''} "
            f"({type(error).__name__}: {_short(error)})",
            expected="the address of a Ray cluster that runs",
            hint="ray start --head starts one. If it uses tokens, set RAY_AUTH_MODE=token here "
            "and copy ~/.ray/auth_token from its first node.",
        ) from error
    if stopping is not None and threading.current_thread() is threading.main_thread():
        signal.signal(signal.SIGTERM, stopping)  # Ray's own handler prints a trace of C++
    try:
        yield
    finally:
        ray.shutdown()


def _code(folder: Path) -> dict[str, Any]:
    """Ray's `runtime_env`, of links in an empty folder."""
    package, working = folder / "crowdbench", folder / "working"
    package.mkdir()
    working.mkdir()
    inside = {path.name: path for path in Path(crowdbench.__file__).parent.iterdir()}
    # As in a wheel: in a clone, these two are not in the package's folder.
    inside |= {"baselines": Path(baselines.__path__[0]), "_scenes": scenes_folder()}
    for name, path in inside.items():
        (package / name).symlink_to(path.resolve())
    for path in Path.cwd().rglob("*.py"):
        place = path.relative_to(Path.cwd())
        if not any(part.startswith(".") or part in _NOT_CODE for part in place.parts):
            (working / place).parent.mkdir(parents=True, exist_ok=True)
            (working / place).symlink_to(path)
    modules = {"py_modules": [str(package)], "excludes": ["__pycache__"]}
    return modules | {"working_dir": str(working)}


def cpus() -> int:
    """Number of processor cores of the cluster."""
    import ray

    found = ray.cluster_resources()  # type: ignore[no-untyped-call]
    return max(1, int(found.get("CPU", 1)))


def call_each(
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    workers: int,
    *,
    common: tuple[object, ...],
    name: Callable[..., str],
    files: Callable[..., Sequence[Path]],
    reads: Callable[..., Sequence[Path]],
) -> Generator[tuple[int, Result], None, None]:
    """Like `executor.call_each`, on a cluster, with at most `workers` calls at a time.

    Closing the generator, or an interrupt, ends the calls that run.

    Raises:
        SettingError: a file in `reads` is not in the working directory.
        WorkerError: a task was lost with its node or process, again and again.
        Exception: any exception that a call raised.
    """
    import ray

    read = dict.fromkeys(path for task in tasks for path in reads(*task))
    sent = {f"working/{_place(path)}": path.read_bytes() for path in read}
    for path in sorted((home() / "recordings").glob("*.parquet")):
        sent[f"home/recordings/{path.name}"] = path.read_bytes()
    shared = pickle.dumps((_packed((function, common)), plugins.shared(), sent))
    given = sha256(shared), ray.put(shared)
    remote = ray.remote(num_cpus=1, max_retries=TRIES_AGAIN)(_work)
    running: dict[Any, int] = {}
    waiting = iter(range(len(tasks)))
    try:
        while True:
            while len(running) < workers and (index := next(waiting, None)) is not None:
                names = _names(files(*tasks[index]))
                contents = {n: p.read_bytes() if p.is_file() else None for p, n in names.items()}
                running[remote.remote(_packed(tasks[index], names), contents, given)] = index
            if not running:
                return
            done = ray.wait(list(running), num_returns=1)[0][0]
            index = running.pop(done)
            outcome, written = _got(done, name(*tasks[index]))
            result = result_of(outcome)
            for path, key in _names(files(*tasks[index])).items():
                if key in written:
                    with replacing(path) as temporary:
                        temporary.write_bytes(written[key])
            yield index, result
    except SystemExit as error:  # Ray raises one of its own instead of that of a signal
        raise Stopped.last or error from None
    finally:
        for left in running:
            ray.cancel(left, force=True)


def _names(paths: Sequence[Path]) -> dict[Path, str]:
    folders = list(dict.fromkeys(path.parent for path in paths))
    return {path: f"{folders.index(path.parent)}/{path.name}" for path in paths}


def _place(path: Path) -> Path:
    """Where a file is in the working directory.

    Raises:
        SettingError: it is somewhere else.
    """
    there = path.resolve()
    if not there.is_relative_to(Path.cwd()) or path.is_absolute() or ".." in path.parts:
        raise SettingError(
            "engine ray",
            got=f"the file {path}",
            expected="a path in the working directory, relative to it",
            hint="Start the command in a folder that contains the file.",
        )
    return there.relative_to(Path.cwd())


def _packed(value: object, names: Mapping[Path, str] = MappingProxyType({})) -> bytes:
    """A value, pickled so that its paths name the same files on a node as here.

    `names` are the files of the task.
    """
    of_task = {path.parent: name.partition("/")[0] for path, name in names.items()} | dict(names)
    roots = {"scenes": scenes_folder(), "working": Path.cwd()}

    def reduced(path: Path) -> Any:
        if path in of_task:
            return _on_node, ("task", of_task[path])
        for place, root in roots.items():
            if path.is_absolute() and path.is_relative_to(root):
                return _on_node, (place, str(path.relative_to(root)))
        return path.__reduce__()

    buffer = BytesIO()
    pickler = pickle.Pickler(buffer)
    pickler.dispatch_table = copyreg.dispatch_table | {type(Path()): reduced}
    pickler.dump(value)
    return buffer.getvalue()


def _got(done: Any, where: str) -> tuple[bytes, dict[str, bytes]]:
    """The outcome of a task and the files that it wrote."""
    import ray

    try:
        return ray.get(done)
    except ray.exceptions.RayError as error:
        if Stopped.last is not None:  # what Ray tells of is how it ends
            raise Stopped.last from None
        raise WorkerError(
            where,
            got=f"{type(error).__name__}: {_short(error)}",
            expected="a worker on the cluster that finishes its work",
            hint="Finished work is kept: the same command continues from there.",
        ) from error


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[-300:]


# What follows runs on a node.

_task = Path()
"""Folder of the files of the task that runs."""
_open = ExitStack()
"""Temporary folders that this process uses until it ends."""


def _work(packed: bytes, sent: Files, given: tuple[str, Any]) -> tuple[bytes, dict[str, bytes]]:
    """Do a task on a node; return its outcome and the files that it wrote."""
    global _task
    with temporary_folder("task") as _task:
        for name, data in sent.items():
            _write(_task / name, data)
        outcome = outcome_of(lambda: _called(packed, given))
        files = {name: _task / name for name in sent if (_task / name).is_file()}
        written = {name: path.read_bytes() for name, path in files.items()}
    return outcome, {name: data for name, data in written.items() if data != sent[name]}


def _called(packed: bytes, given: tuple[str, Any]) -> object:
    function, common = _unpacked(*given)  # changes the working directory, before paths are read
    return function(*pickle.loads(packed), *common)


@lru_cache(maxsize=1)
def _unpacked(digest: str, shared: Any) -> tuple[Callable[..., object], tuple[Any, ...]]:
    """What the tasks of a call have in common; its files become this process's."""
    import numba
    import ray

    numba.set_num_threads(1)  # the workers of a node already use all cores
    packed, registered, files = pickle.loads(ray.get(shared))
    folder = _open.enter_context(temporary_folder("node"))
    for name in ("working", "home"):
        (folder / name).mkdir()
    for name, data in files.items():
        _write(folder / name, data)
    os.chdir(folder / "working")
    os.environ["CROWDBENCH_HOME"] = str(folder / "home")
    plugins.restore(registered)
    return pickle.loads(packed)


def _write(path: Path, data: bytes | None) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    if data is not None:
        path.write_bytes(data)


def _on_node(place: str, path: str) -> Path:
    """A path that `_packed` has replaced."""
    return {"task": _task, "scenes": scenes_folder(), "working": Path.cwd()}[place] / path
