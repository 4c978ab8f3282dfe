"""Work shared by processes, which end when the one that started them does, however that ends."""

import ctypes
import multiprocessing
import os
import pickle
import signal
import sys
import threading
import time
import traceback
import types
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.reduction import ForkingPickler
from typing import Any, TypeVar

from crowdbench import leftovers, plugins
from crowdbench.errors import SettingError, WorkerError

Result = TypeVar("Result")

_PR_SET_PDEATHSIG = 1
_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS",
)  # fmt: skip


def checked_workers(asked: int | None) -> int:
    """The number of processes: as asked, or one per core.

    Raises:
        SettingError: fewer than one are asked for.
    """
    if asked is not None and asked < 1:
        raise SettingError("workers", got=str(asked), expected="1 or more")
    return asked or os.cpu_count() or 1


def call_each(
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    workers: int,
    *,
    common: tuple[object, ...] = (),
    name: Callable[..., str] = lambda *task: "a task",
) -> Generator[tuple[int, Result], None, None]:
    """Call `function(*task, *common)` for each task; index and result of each as it is done.

    With one worker the calls are made here, else in so many processes, on one thread each. What
    all tasks have in common is sent to each process once.

    Raises:
        WorkerError: a process died; `name(*task)` says at which task.
        Exception: what a call raised.
    """
    workers = min(workers, len(tasks))
    if workers <= 1:
        for index, task in enumerate(tasks):
            yield index, function(*task, *common)
        return
    team: list[_Worker] = []
    with leftovers.swept():
        try:
            with _as_workers_start():
                for _ in range(workers):
                    team.append(_Worker(name))
            yield from _share(team, ForkingPickler.dumps((function, common)), tasks)
        finally:
            for worker in team:
                worker.end()


def _share(
    team: "list[_Worker]", first: object, tasks: Sequence[tuple[object, ...]]
) -> Iterator[tuple[int, Any]]:
    """Give each worker a task at a time: of one that dies it is known which it had."""
    waiting = iter(enumerate(tasks))
    busy = {}
    for worker in team:
        worker.begin(first, *next(waiting))
        busy[worker.connection] = worker
    while busy:
        for connection in wait(list(busy)):
            worker = busy.pop(connection)  # type: ignore[call-overload]
            done = worker.index, worker.result()
            for index, task in waiting:
                worker.send(index, task)
                busy[worker.connection] = worker
                break
            yield done


class _Worker:
    """A process that is sent one task after the other."""

    def __init__(self, name: Callable[..., str]) -> None:
        self.index = 0
        self._name = name
        self._task: tuple[object, ...] = ()
        self.connection, theirs = Pipe()
        # Started afresh, not forked: forking after OpenMP has run hangs.
        self._process = multiprocessing.get_context("spawn").Process(
            target=_work, args=(theirs, _sweeper_of(), plugins.shared()), daemon=True
        )
        self._process.start()
        theirs.close()  # so that its death is told by the end of the pipe

    def begin(self, first: object, index: int, task: tuple[object, ...]) -> None:
        """Send what it needs for all tasks, and the first of them."""
        self._send(first)
        self.send(index, task)

    def send(self, index: int, task: tuple[object, ...]) -> None:
        """Give it a task."""
        self.index, self._task = index, task
        self._send(ForkingPickler.dumps(task))

    def _send(self, data: object) -> None:
        with suppress(ConnectionError):  # its end is told when its result is asked for
            self.connection.send_bytes(data)  # type: ignore[arg-type]

    def result(self) -> object:
        """What the call returned, or raise what it raised.

        Raises:
            WorkerError: it died.
        """
        try:
            done, what, trace = pickle.loads(self.connection.recv_bytes())
        except (EOFError, ConnectionError) as error:
            self._process.join()
            raise _death(self._name(*self._task), self._process.exitcode or 0) from error
        if done:
            return what
        what.add_note(f"In a worker process:\n{trace}")
        raise what

    def end(self) -> None:
        """End it, whatever it does."""
        self._process.kill()
        self._process.join()
        self._process.close()
        self.connection.close()


def _death(where: str, code: int) -> WorkerError:
    """The error of a process that did not end by itself."""
    hint = "What was made before is kept: the same command goes on from there."
    if code >= 0:
        got = f"a worker process that ended with code {code}"
        hint = f"Something in it leaves Python. {hint}"
    else:
        killed = signal.Signals(-code).name
        got = f"a worker process that was killed by {killed}"
        if killed == "SIGKILL":
            hint = f"The system does that where memory is short: use fewer workers. {hint}"
    return WorkerError(where, got=got, expected="one that ends its work", hint=hint)


def _sweeper_of() -> Connection | None:
    """The way to the sweeper, as something that can be sent to a process that is started."""
    pipe = leftovers.pipe()
    if pipe is None or sys.platform == "win32":
        return None
    return Connection(os.dup(pipe), readable=False)


@contextmanager
def _as_workers_start() -> Iterator[None]:
    """Surroundings that workers inherit: one thread each, and no main module to run again.

    The caller's script need not guard what it does by `if __name__ == "__main__"`.
    """
    before = dict(os.environ)
    main = sys.modules["__main__"]
    for variable in _THREADS:
        os.environ.setdefault(variable, "1")
    sys.modules["__main__"] = types.ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
        for variable in _THREADS:
            if variable not in before:
                del os.environ[variable]


def _work(connection: Connection, sweeper: Connection | None, registered: bytes) -> None:
    """What a worker does until nobody has tasks for it any more."""
    parent = multiprocessing.parent_process()
    end_with(parent.pid if parent and parent.pid else os.getppid())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # which ends who started it
    if sweeper is not None:
        leftovers.share(sweeper.fileno())
    import numba

    numba.set_num_threads(1)  # the processes already fill the machine
    plugins.restore(registered)
    with suppress(EOFError, ConnectionError):
        function, common = pickle.loads(connection.recv_bytes())
        while True:
            task = pickle.loads(connection.recv_bytes())
            connection.send_bytes(_outcome(function, (*task, *common)))


def _outcome(function: Callable[..., object], arguments: tuple[object, ...]) -> Any:
    """The result of a call, or what it raised, as bytes."""
    try:
        return ForkingPickler.dumps((True, function(*arguments), ""))
    except BaseException as error:
        trace = traceback.format_exc()
        try:
            # Some exceptions can be written, but not made again from what was written.
            data = ForkingPickler.dumps((False, error, trace))
            pickle.loads(data)
        except Exception:
            plain = RuntimeError(f"{type(error).__name__}: {error}")
            data = ForkingPickler.dumps((False, plain, trace))
        return data


def end_with(parent: int) -> None:
    """End at once when the process that started this one ends.

    Linux kills it then; elsewhere a thread looks after the parent.
    """
    killed = False
    if sys.platform.startswith("linux"):
        killed = ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0
    if os.getppid() != parent:  # it ended before that was asked for
        os._exit(1)
    if not killed:
        threading.Thread(target=_look_after, args=(parent,), daemon=True).start()


def _look_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


class Stopped(SystemExit):
    """The process was asked to end, by SIGTERM or by the end of its terminal."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number
        """The exit code."""


@contextmanager
def stopping_in_order() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into `Stopped`: what is open is closed, what is temporary removed.

    The code is that of shells, 128 + the signal's number. What is ignored stays so (`nohup`).
    """

    def stop(number: int, frame: object) -> None:
        raise Stopped(128 + number)

    changed = []
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has one of them
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, stop)
                changed.append(number)
    try:
        yield
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL)
