"""A lock that allows one evaluation at a time per output folder."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

from crowdbench.errors import OutputError
from crowdbench.files import unwritable


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Hold the lock of a folder; a missing folder is created.

    The operating system releases the lock when the process ends, even if it crashes.

    Raises:
        OutputError: another process holds the lock, or the folder cannot be written.
    """
    lock = FileLock(out / ".lock", timeout=0)
    try:
        out.mkdir(parents=True, exist_ok=True)
        lock.acquire()
    except Timeout as error:
        raise OutputError(
            out,
            got="a folder that another evaluation is writing to",
            expected="a separate folder for each evaluation",
            hint="Wait until the other evaluation ends, or choose another folder.",
        ) from error
    except OSError as error:
        raise unwritable(out, error) from error
    try:
        yield
    finally:
        # Removed before it is released: a process that has opened it notices that.
        Path(lock.lock_file).unlink(missing_ok=True)
        lock.release()
