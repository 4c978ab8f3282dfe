"""Parallel work on a Ray cluster, whose nodes need no shared disk and no copy of crowdbench.

Nodes need Python and the packages that crowdbench depends on. The code of crowdbench, its scenes,
the Python files of the working directory and the imported recordings travel to each node once, by
Ray's object store, and stay there for later calls: a node compiles the simulation once. Files that
tasks read or write are copied there and back: this process, the driver, writes all of them. If a
node dies, Ray does its tasks again. `node` is what runs there.
"""

import logging
import os
import pickle
import signal
import socket
import threading
import zipfile
from collections.abc import Callable, Generator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from io import BytesIO
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, TypeVar

import crowdbench
from crowdbench import baselines, plugins
from crowdbench.errors import SettingError, WorkerError, to_install
from crowdbench.files import home, replacing, sha256
from crowdbench.run import node
from crowdbench.run.node import PLACES, Files, Given
from crowdbench.run.parallel import Stopped
from crowdbench.scene import scenes_folder

Result = TypeVar("Result")

Sent = tuple[str, Any]
"""Hash of an object in the object store, and a reference to it."""

NAME = "ray"
CLIENT = "ray://"
TRIES_AGAIN = 4
"""Number of times that a task is done again if its node or its process dies."""
_REACHED_S = 20.0
"""Longest time in which a connection to the cluster is made, seconds."""
_NOT_CODE = ("results", "build", "dist", "node_modules", "site-packages")
"""Folders of the working directory whose Python files are not sent."""
_MOST_CODE = 50_000_000
"""Largest size of the Python files of the working directory, bytes."""


def connect(address: str) -> Any:
    """Connect to the cluster, unless this process is connected; return the module `ray`.

    `ray` stands for the cluster in `RAY_ADDRESS` or on this machine, else one is started here.

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
    if not ray.is_initialized():
        where = address if address.startswith(CLIENT) else None
        named = os.environ.get("RAY_ADDRESS", "")
        stopping = signal.getsignal(signal.SIGTERM)
        try:
            _check_reachable(where or named)
            ray.init(address=where, log_to_driver=False, logging_level=logging.ERROR)
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
    return ray


def _check_reachable(address: str) -> None:
    """Check that somebody listens at HOST:PORT, because Ray waits for up to 14 minutes."""
    host, _, port = address.removeprefix(CLIENT).rpartition(":")
    if host and port.isdecimal():
        socket.create_connection((host.strip("[]"), int(port)), timeout=_REACHED_S).close()


def cpus(address: str) -> int:
    """Number of processor cores of the cluster."""
    return max(1, int(connect(address).cluster_resources().get("CPU", 1)))


def call_each(
    address: str,
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    workers: int,
    *,
    common: tuple[object, ...],
    name: Callable[..., str],
    files: Callable[..., Sequence[Path]],
    reads: Callable[..., Sequence[Path]],
) -> Generator[tuple[int, Result], None, None]:
    """Like `parallel.call_each`, on a cluster, with at most `workers` calls at a time.

    Closing the generator, or an interrupt, ends the calls that run.

    Raises:
        WorkerError: a task was lost with its node or process, again and again.
        Exception: any exception that a call raised.
    """
    ray = connect(address)
    sending = _Sending(ray, function, common)
    remote = ray.remote(_begin()).options(num_cpus=1, max_retries=TRIES_AGAIN)
    running: dict[Any, int] = {}
    waiting = iter(range(len(tasks)))
    try:
        while True:
            while len(running) < workers and (index := next(waiting, None)) is not None:
                task = tasks[index]
                paths = files(*task)
                given = sending.given(reads(*task))
                begun = remote.remote(_packed(task, paths), _contents(paths), given.parts())
                running[begun] = index
            if not running:
                return
            done = ray.wait(list(running), num_returns=1)[0][0]
            index = running.pop(done)
            result, written = _got(ray, done, name(*tasks[index]))
            _write(files(*tasks[index]), written)
            yield index, result
    except SystemExit as error:  # Ray raises one of its own instead of that of a signal
        raise Stopped.last or error from None
    finally:
        for left in running:
            ray.cancel(left, force=True)


def _begin() -> Callable[..., tuple[bytes, Files]]:
    """The function that begins a task on a node, where there is no crowdbench to import yet.

    Because it is not at the top of a module, Ray sends its code. It puts crowdbench in place.
    """

    def begin(packed: bytes, sent: Any, given: Any) -> Any:
        import io
        import os
        import sys
        import tempfile
        import zipfile
        from pathlib import Path

        import ray

        digest, code = given[0]
        root = Path(tempfile.gettempdir()) / f"crowdbench-code-{os.getuid()}-{digest}"
        if str(root) not in sys.path:
            if not root.exists():
                with tempfile.TemporaryDirectory(dir=root.parent) as half:
                    zipfile.ZipFile(io.BytesIO(ray.get(code))).extractall(Path(half) / "code")
                    try:
                        (Path(half) / "code").rename(root)
                    except OSError:  # another worker was faster
                        if not root.exists():
                            raise
            if root.stat().st_uid != os.getuid():
                raise PermissionError(f"{root} belongs to another user: its code is not run")
            (root / "working").mkdir(exist_ok=True)
            os.utime(root)  # it is in use: `node` removes what has not been used for long
            os.chdir(root / "working")
            sys.path[:0] = [str(root), str(root / "working")]
        from crowdbench.run.node import Given, work

        return work(packed, sent, Given(*given))

    return begin


@dataclass
class _Sending:
    """Sends what tasks need to the object store, each thing once."""

    ray: Any
    function: Callable[..., Any]
    common: tuple[object, ...]
    _shared: tuple[Sent, Sent, Sent] | None = None
    _read: dict[object, Sent] = field(default_factory=dict)

    def given(self, reads: Sequence[Path]) -> Given:
        """What a task needs that reads these files, beside its own."""
        if self._shared is None:
            shared = _packed((self.function, self.common)), plugins.shared()
            folder = home() / "recordings"
            recordings = {p.name: p.read_bytes() for p in sorted(folder.glob("*.parquet"))}
            self._shared = (
                _sent(self.ray, _code()), _sent(self.ray, shared), _sent(self.ray, recordings)
            )  # fmt: skip
        files = {_place(path): path for path in reads}
        known = tuple((place, path.stat().st_mtime_ns) for place, path in files.items())
        if known not in self._read:
            contents = {place: path.read_bytes() for place, path in files.items()}
            self._read[known] = _sent(self.ray, contents)
        return Given(*self._shared, self._read[known])


def _sent(ray: Any, what: Any) -> Sent:
    """A hash of an object, and the reference to it in the object store."""
    return sha256(what if isinstance(what, bytes) else pickle.dumps(what))[:16], ray.put(what)


def _code() -> bytes:
    """Archive of the packages with the scenes inside, and of the code in the working directory."""
    files: dict[str, Path] = {}
    # As in a wheel: in a clone, the last two are not in the package's folder.
    for place, root in (
        ("crowdbench", Path(crowdbench.__file__).parent),
        ("crowdbench/baselines", Path(baselines.__path__[0])),
        ("crowdbench/_scenes", scenes_folder()),
    ):
        files |= {f"{place}/{p.relative_to(root)}": p for p in _sendable(root, "*")}
    own = _sendable(Path.cwd(), "*.py")
    size = sum(path.stat().st_size for path in own)
    if size > _MOST_CODE:
        raise SettingError(
            "engine ray",
            got=f"{size / 1e6:.0f} MB of Python files in the working directory {Path.cwd()}",
            expected=f"at most {_MOST_CODE / 1e6:.0f} MB, because they are sent to the cluster",
            hint="Start the command in a folder with your own code alone.",
        )
    files |= {f"working/{path.relative_to(Path.cwd())}": path for path in own}
    return _archive(tuple((n, p, p.stat().st_mtime_ns) for n, p in sorted(files.items())))


@cache
def _archive(files: tuple[tuple[str, Path, int], ...]) -> bytes:
    buffer = BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        for name, path, _ in files:
            # Without the time of the file: the same files are the same archive.
            archive.writestr(zipfile.ZipInfo(name), path.read_bytes(), zipfile.ZIP_DEFLATED)
    return buffer.getvalue()


def _sendable(root: Path, pattern: str) -> list[Path]:
    """Files of a folder, without caches, hidden folders, virtual environments and results."""
    found = []
    for path in sorted(root.iterdir()):
        if path.name.startswith(".") or path.name in ("__pycache__", *_NOT_CODE):
            continue
        if path.is_dir() and not (path / "pyvenv.cfg").exists() and not path.is_symlink():
            found += _sendable(path, pattern)
        elif path.is_file() and path.match(pattern):
            found.append(path)
    return found


def _numbered(paths: Sequence[Path]) -> dict[Path, str]:
    """Short names of files, `number of the folder/name`, and of their folders, `number`."""
    folders = list(dict.fromkeys(path.parent for path in paths))
    named = {folder: str(k) for k, folder in enumerate(folders)}
    return named | {path: f"{named[path.parent]}/{path.name}" for path in paths}


class _Packer(ForkingPickler):
    """Pickles paths so that they name the same files on a node as here."""

    names: Mapping[Path, str]
    """Files of a task and their folders."""

    def reducer_override(self, value: object) -> Any:
        if not isinstance(value, Path):
            return NotImplemented
        if value in self.names:
            return node.of_task, (self.names[value],)
        for name, place in PLACES.items():
            if value.is_absolute() and value.is_relative_to(place()):
                return node.placed, (name, str(value.relative_to(place())))
        return NotImplemented


def _packed(value: object, paths: Sequence[Path] = ()) -> bytes:
    buffer = BytesIO()
    packer = _Packer(buffer)
    packer.names = _numbered(paths)
    packer.dump(value)
    return buffer.getvalue()


def _contents(paths: Sequence[Path]) -> Files:
    names = _numbered(paths)
    return {names[path]: path.read_bytes() for path in paths if path.is_file()}


def _place(path: Path) -> str:
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
    return str(there.relative_to(Path.cwd()))


def _write(paths: Sequence[Path], written: Files) -> None:
    names = _numbered(paths)
    for path in paths:
        if names[path] in written:
            with replacing(path) as temporary:
                temporary.write_bytes(written[names[path]])


def _got(ray: Any, done: Any, where: str) -> tuple[Any, Files]:
    """The result of a task and the files that it wrote."""
    try:
        outcome, written = ray.get(done)
    except ray.exceptions.RayError as error:
        if Stopped.last is not None:  # what Ray tells of is how it ends
            raise Stopped.last from None
        raise WorkerError(
            where,
            got=f"{type(error).__name__}: {_short(error)}",
            expected="a worker on the cluster that finishes its work",
            hint="Finished work is kept: the same command continues from there.",
        ) from error
    finished, what, trace = pickle.loads(outcome)
    if finished:
        return what, written
    what.add_note(f"In a worker on the cluster:\n{trace}")
    raise what


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[-300:]
