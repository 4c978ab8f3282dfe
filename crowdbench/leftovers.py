"""Nothing is left behind: what is temporary goes when the processes that made it have ended.

A process that is killed cannot tidy up. So a run starts a second, small process, the sweeper, and
tells it through a pipe which files are temporary. All processes of the run hold that pipe open;
when the last of them has ended, however it ended, the sweeper removes what is left, and ends too.
Where the sweeper is killed as well, what is left is removed at the next start.

The sweeper runs this file as a script: it imports nothing but the standard library.
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

_PREFIX = "crowdbench-tmp-"
_YOUNG_S = 60.0  # a folder that was just made may not be held yet
_LONGEST = 4000  # bytes that a pipe takes as a whole, whoever else writes

_pipe: int | None = None
"""Where the sweeper is told; None without one."""


@contextmanager
def swept() -> Iterator[None]:
    """Have a sweeper while the block runs, unless there is one already."""
    global _pipe
    if _pipe is not None:
        yield
        return
    try:
        sweeper = subprocess.Popen(
            [sys.executable, "-I", "-S", os.path.abspath(__file__)],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,  # what ends a whole group, as Ctrl-C does, does not end it
            cwd=os.path.abspath(os.sep),
        )
    except OSError:  # no more processes: the next start removes what is left
        yield
        return
    assert sweeper.stdin is not None
    _pipe = sweeper.stdin.fileno()
    try:
        yield
    finally:
        _pipe = None
        sweeper.stdin.close()
        with suppress(subprocess.TimeoutExpired):
            sweeper.wait(5)


def pipe() -> int | None:
    """The descriptor by which other processes of the run may reach the sweeper, if there is one."""
    return _pipe


def share(descriptor: int | None) -> None:
    """Tell the sweeper of the process that started this one; a descriptor that was inherited."""
    global _pipe
    _pipe = descriptor
    if descriptor is not None:
        os.set_inheritable(descriptor, False)


@contextmanager
def temporary(path: Path) -> Iterator[None]:
    """Have a file or folder removed if the block is left without its being gone."""
    name = os.fsencode(path.absolute())
    _tell(b"+" + name)
    try:
        yield
    finally:
        if not os.path.lexists(path):
            _tell(b"-" + name)


@contextmanager
def temporary_folder(what: str) -> Iterator[Path]:
    """An empty folder, removed when the block ends or, at the latest, all processes of the run."""
    with swept():
        _remove_abandoned()
        with (
            tempfile.TemporaryDirectory(
                prefix=f"{_PREFIX}{what}-", ignore_cleanup_errors=True
            ) as folder,
            temporary(Path(folder)),
            _held(folder),
        ):
            yield Path(folder)


def _tell(message: bytes) -> None:
    if _pipe is not None and len(message) < _LONGEST:
        with suppress(OSError):  # it was killed
            os.write(_pipe, message + b"\0")


@contextmanager
def _held(folder: str) -> Iterator[None]:
    """Hold a lock on a folder, which the system gives up when this process ends."""
    descriptor = _lock(folder)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _lock(folder: str | Path) -> int | None:
    """A descriptor that holds the lock on a folder, None where another process has it."""
    try:
        import fcntl
    except ImportError:  # Windows
        return None
    descriptor = None
    try:
        descriptor = os.open(folder, os.O_RDONLY)
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        if descriptor is not None:
            os.close(descriptor)
        return None
    return descriptor


def _remove_abandoned() -> None:
    """Remove the user's temporary folders whose processes and sweepers were killed."""
    if sys.platform == "win32":
        return
    import shutil

    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with suppress(OSError):
            told = folder.lstat()
            if told.st_uid == os.getuid() and time.time() - told.st_mtime > _YOUNG_S:
                descriptor = _lock(folder)
                if descriptor is not None:
                    shutil.rmtree(folder, ignore_errors=True)
                    os.close(descriptor)


def _sweep() -> None:
    """What the sweeper does."""
    for name in ("SIGINT", "SIGTERM", "SIGHUP"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_IGN)
    left: dict[bytes, None] = {}
    half = b""
    while heard := os.read(0, 2**16):
        *messages, half = (half + heard).split(b"\0")
        for message in messages:
            if message[:1] == b"+":
                left[message[1:]] = None
            else:
                left.pop(message[1:], None)
    for path in left:
        with suppress(OSError):
            if os.path.isdir(path) and not os.path.islink(path):
                import shutil

                shutil.rmtree(path, ignore_errors=True)
            else:
                os.unlink(path)


if __name__ == "__main__":
    _sweep()
