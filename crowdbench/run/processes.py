"""Processes of a run: how they end, keep apart, and pass on what a call returned or raised."""

import ctypes
import os
import pickle
import signal
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

from crowdbench.errors import OutputError
from crowdbench.files import unwritable

_PR_SET_PDEATHSIG = 1
AGAIN_S = 0.05
"""Time after which a signal that arrived where nothing can be raised is raised again."""

LOCAL = "local"
"""Name of the engine of this machine; see `crowdbench.run.executor.engine`."""


class Stopped(SystemExit):
    """The process was asked to end, by SIGTERM or by the end of its terminal."""

    last: ClassVar["Stopped | None"] = None
    """The one that was raised last."""
    code: int
    """The exit code."""


@contextmanager
def stopping_in_order() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into `Stopped`, so that resources and temporary files are cleaned up.

    The exit code is that of shells, 128 + the signal's number. Signals that are ignored stay
    ignored (`nohup`).
    """
    waiting: list[threading.Timer] = []
    usual = sys.unraisablehook

    def stop(number: int, frame: object) -> None:
        Stopped.last = Stopped(128 + number)
        raise Stopped.last

    def ignored(what: Any) -> None:
        # Python drops what is raised in a finalizer or in the callback of a weak reference. If the
        # signal arrived there, it is raised once more, when that function has returned.
        if isinstance(what.exc_value, Stopped):
            number = what.exc_value.code - 128
            main = threading.main_thread().ident or 0
            waiting.append(threading.Timer(AGAIN_S, signal.pthread_kill, (main, number)))
            waiting[-1].daemon = True
            waiting[-1].start()
        else:
            usual(what)

    changed = []
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has only SIGTERM
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, stop)
                changed.append(number)
    sys.unraisablehook, Stopped.last = ignored, None
    try:
        yield
    except Exception as error:
        # Libraries in C may replace what is raised in them by an error of their own.
        if Stopped.last is not None:
            raise Stopped.last from error
        raise
    finally:
        sys.unraisablehook = usual
        for timer in waiting:
            timer.cancel()
        for number in changed:
            signal.signal(number, signal.SIG_DFL)


def end_with(parent: int) -> None:
    """Make this process end as soon as the process `parent` ends.

    On Linux the kernel kills it; on other systems a thread watches the parent.
    """
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0)
    else:
        threading.Thread(target=_watch, args=(parent,), daemon=True).start()
    if os.getppid() != parent:  # it ended before this was set up
        os._exit(1)


def _watch(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


def outcome_of(call: Callable[[], object]) -> bytes:
    """What a call returned or raised, pickled for `result_of` in another process."""
    try:
        return pickle.dumps((True, call()))
    except BaseException as error:
        told = f"In a worker process:\n{traceback.format_exc()}"
        try:
            error.add_note(told)
            data = pickle.dumps((False, error))
            pickle.loads(data)  # some exceptions can be pickled but not unpickled
        except Exception:
            plain = RuntimeError(f"{type(error).__name__}: {error}")
            plain.add_note(told)
            data = pickle.dumps((False, plain))
        return data


def result_of(outcome: bytes) -> Any:
    """The result of a call from its `outcome_of`.

    Raises:
        Exception: the exception that the call raised.
    """
    returned, what = pickle.loads(outcome)
    if returned:
        return what
    raise what


@contextmanager
def alone_in(out: Path) -> Iterator[None]:
    """Hold the lock of a folder; a missing folder is created.

    The operating system releases the lock when the process ends, even if it crashes.

    Raises:
        OutputError: another process holds the lock, or the folder cannot be written.
    """
    from filelock import FileLock, Timeout  # loads asyncio

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
