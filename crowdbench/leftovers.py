"""Removal of temporary files, even if the processes that created them are killed.

A killed process cannot clean up. Therefore a run starts a small second process, the sweeper, and
sends it the paths of temporary files through a pipe. All processes of the run keep this pipe open.
When the last of them has ended, for whatever reason, the sweeper removes the remaining temporary
files and exits. If the sweeper is killed too, the next run removes them when it starts.

The sweeper runs this file as a script, so this file imports the standard library only.
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
_YOUNG_S = 60.0  # a folder that was just created may not be locked yet
_LONGEST = 4000  # bytes; longer writes to a pipe may mix with those of other processes

_pipe: int | None = None
"""File descriptor of the pipe to the sweeper; None if there is no sweeper."""


@contextmanager
def swept() -> Iterator[None]:
    """Run a sweeper for the duration of the block, unless one runs already."""
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
            start_new_session=True,  # signals to the whole process group (Ctrl-C) do not reach it
            cwd=os.path.abspath(os.sep),
        )
    except OSError:  # no process can be started: the next run removes the files
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
    """File descriptor for messages to the sweeper, for other processes of the run; None without."""
    return _pipe


def share(descriptor: int | None) -> None:
    """Use the sweeper of the parent process, through an inherited file descriptor."""
    global _pipe
    _pipe = descriptor
    if descriptor is not None:
        os.set_inheritable(descriptor, False)


@contextmanager
def temporary(path: Path) -> Iterator[None]:
    """Register a file or folder with the sweeper until the block has removed it."""
    name = os.fsencode(path.absolute())
    _tell(b"+" + name)
    try:
        yield
    finally:
        if not os.path.lexists(path):
            _tell(b"-" + name)


@contextmanager
def temporary_folder(what: str) -> Iterator[Path]:
    """Yield an empty folder, removed at the end of the block or, at the latest, of the run."""
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
        with suppress(OSError):  # the sweeper was killed
            os.write(_pipe, message + b"\0")


@contextmanager
def _held(folder: str) -> Iterator[None]:
    """Lock a folder; the operating system releases the lock when this process ends."""
    descriptor = _lock(folder)
    try:
        yield
    finally:
        if descriptor is not None:
            os.close(descriptor)


def _lock(folder: str | Path) -> int | None:
    """File descriptor that holds the lock on a folder; None if another process holds it."""
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
    """Remove this user's temporary folders whose processes and sweepers were killed."""
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
    """Collect paths until the pipe is closed, then remove those that are left."""
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
