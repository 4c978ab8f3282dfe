"""Parallel work: in processes that end with the one that started them, or on a Ray cluster."""

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
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from multiprocessing.connection import Connection, Pipe, wait
from multiprocessing.reduction import ForkingPickler
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from crowdbench import leftovers, plugins
from crowdbench.errors import SettingError, WorkerError

Result = TypeVar("Result")

_PR_SET_PDEATHSIG = 1
_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS",
)  # fmt: skip


LOCAL = "local"
_engine: ContextVar[str] = ContextVar("engine", default=LOCAL)


@contextmanager
def engine(name: str) -> Iterator[None]:
    """Run parallel work elsewhere: `local`, `ray`, or `ray://HOST:PORT`.

    `local` are processes of this machine. `ray` is the Ray cluster that this process is connected
    to, or that `RAY_ADDRESS` names, or that runs on this machine; if there is none, one is started
    here. The results are the same.

        with crowdbench.engine("ray"):
            crowdbench.evaluate("eth-v0", spawn="ntpp-gmm", policy="social-force", out="results")

    Raises:
        SettingError: there is no such engine, no Ray, or no cluster.
    """
    from crowdbench.run import ray_engine

    if name not in (LOCAL, ray_engine.NAME) and not name.startswith(ray_engine.CLIENT):
        raise SettingError(
            "engine",
            got=repr(name),
            expected="local, ray, or the address ray://HOST:PORT of a Ray client server",
            hint="For the cluster of a head node, set RAY_ADDRESS=HOST:PORT and choose ray."
            if ":" in name
            else "",
        )
    if name != LOCAL:
        ray_engine.connect(name)
    before = _engine.set(name)
    try:
        yield
    finally:
        _engine.reset(before)


def is_local() -> bool:
    """Whether parallel work runs in processes of this machine."""
    return _engine.get() == LOCAL


def checked_workers(asked: int | None) -> int:
    """The number of processes: `asked`, or one per core if it is None.

    Raises:
        SettingError: `asked` is less than 1.
    """
    if asked is not None and asked < 1:
        raise SettingError("workers", got=str(asked), expected="1 or more")
    if asked is None and not is_local():
        from crowdbench.run import ray_engine

        return ray_engine.cpus(_engine.get())
    return asked or os.cpu_count() or 1


ALONE_S = 3.0
"""Seconds after which the first worker process gets help: twice what it needs to start."""


def _no_files(*task: object) -> Sequence[Path]:
    return ()


def call_each(
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    workers: int,
    *,
    common: tuple[object, ...] = (),
    name: Callable[..., str] = lambda *task: "a task",
    files: Callable[..., Sequence[Path]] = _no_files,
    reads: Callable[..., Sequence[Path]] = _no_files,
) -> Generator[tuple[int, Result], None, None]:
    """Call `function(*task, *common)` for each task; yields the index and result of each call.

    Results are yielded as soon as they are available. With one worker the calls run in this
    process, otherwise in `workers` processes with one thread each, or on the cluster of `engine`.
    `common` is sent to each process once.

    On a cluster, files are copied. `files(*task)` are those that the call may read and write, by
    paths that the task contains. `reads(*task)` are others that it reads.

    Raises:
        WorkerError: a process died; `name(*task)` describes the task in the message.
        Exception: any exception that a call raised.
    """
    if not is_local():
        from crowdbench.run import ray_engine

        yield from ray_engine.call_each(
            _engine.get(),
            function,
            tasks,
            workers,
            common=common,
            name=name,
            files=files,
            reads=reads,
        )
        return
    workers = min(workers, len(tasks))
    if workers <= 1:
        for index, task in enumerate(tasks):
            yield index, function(*task, *common)
        return
    team: list[_Worker] = []
    with leftovers.swept():
        try:
            first = ForkingPickler.dumps((function, common))
            yield from _share(team, workers, name, first, tasks)
        finally:
            for worker in team:
                worker.end()


def _share(
    team: "list[_Worker]",
    most: int,
    name: Callable[..., str],
    first: object,
    tasks: Sequence[tuple[object, ...]],
) -> Iterator[tuple[int, Any]]:
    """Give each worker one task at a time, so that the task of a worker that dies is known.

    Adds up to `most` workers to `team`: one at once, the others if tasks remain after `ALONE_S`.
    To start a process takes as long as many rollouts of a small scene.
    """
    waiting = deque(enumerate(tasks))
    busy: dict[object, _Worker] = {}

    def start(number: int) -> None:
        with _as_workers_start():
            new = [_Worker(name) for _ in range(number)]
        team.extend(new)
        for worker in new:
            worker.begin(first, *waiting.popleft())
            busy[worker.connection] = worker

    start(1)
    until = time.monotonic() + ALONE_S
    while busy:
        more, left_s = min(most - len(team), len(waiting)), until - time.monotonic()
        if more > 0 and left_s <= 0:
            start(more)
        timeout_s = left_s if left_s > 0 and more > 0 else None
        for connection in wait(list(busy), timeout_s):  # type: ignore[arg-type]
            worker = busy.pop(connection)
            done = worker.index, worker.result()
            if waiting:
                worker.send(*waiting.popleft())
                busy[worker.connection] = worker
            yield done


class _Worker:
    """A process that receives one task after the other."""

    def __init__(self, name: Callable[..., str]) -> None:
        self.index = 0
        self._name = name
        self._task: tuple[object, ...] = ()
        self.connection, theirs = Pipe()
        # Spawned instead of forked: a fork hangs after OpenMP has been used.
        self._process = multiprocessing.get_context("spawn").Process(
            target=_work, args=(theirs, _sweeper_of(), plugins.shared()), daemon=True
        )
        self._process.start()
        theirs.close()  # so that the pipe ends when the process dies

    def begin(self, first: object, index: int, task: tuple[object, ...]) -> None:
        """Send the data that all tasks share, and the first task."""
        self._send(first)
        self.send(index, task)

    def send(self, index: int, task: tuple[object, ...]) -> None:
        """Send a task to the process."""
        self.index, self._task = index, task
        self._send(ForkingPickler.dumps(task))

    def _send(self, data: object) -> None:
        with suppress(ConnectionError):  # `result` reports that the process has died
            self.connection.send_bytes(data)  # type: ignore[arg-type]

    def result(self) -> object:
        """Wait for the call and return its result, or raise the exception that it raised.

        Raises:
            WorkerError: the process died.
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
        """Kill the process."""
        self._process.kill()
        self._process.join()
        self._process.close()
        self.connection.close()


def _death(where: str, code: int) -> WorkerError:
    """The error for a process that died."""
    hint = "Finished work is kept: the same command continues from there."
    if code >= 0:
        got = f"a worker process that ended with code {code}"
        hint = f"Code in it exits Python. {hint}"
    else:
        killed = signal.Signals(-code).name
        got = f"a worker process that was killed by {killed}"
        if killed == "SIGKILL":
            hint = f"The system may have run out of memory: use fewer workers. {hint}"
    return WorkerError(where, got=got, expected="one that finishes its work", hint=hint)


def _sweeper_of() -> Connection | None:
    """The pipe to the process that removes leftovers, in a form that a new process can inherit."""
    pipe = leftovers.pipe()
    if pipe is None or sys.platform == "win32":
        return None
    return Connection(os.dup(pipe), readable=False)


@contextmanager
def _as_workers_start() -> Iterator[None]:
    """An environment for workers to inherit: one thread each, and an empty main module.

    Because of the empty main module, the caller's script does not need the guard
    `if __name__ == "__main__"`.
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
    """Main function of a worker process: run tasks until the connection is closed."""
    parent = multiprocessing.parent_process()
    end_with(parent.pid if parent and parent.pid else os.getppid())
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # handled by the process that started this one
    if sweeper is not None:
        leftovers.share(sweeper.fileno())
    import numba

    numba.set_num_threads(1)  # the processes already use all cores
    plugins.restore(registered)
    with suppress(EOFError, ConnectionError):
        function, common = pickle.loads(connection.recv_bytes())
        while True:
            task = pickle.loads(connection.recv_bytes())
            connection.send_bytes(outcome_of(function, (*task, *common)))


def outcome_of(function: Callable[..., object], arguments: tuple[object, ...]) -> Any:
    """The result of a call, or the exception that it raised, pickled."""
    try:
        return ForkingPickler.dumps((True, function(*arguments), ""))
    except BaseException as error:
        trace = traceback.format_exc()
        try:
            # Some exceptions can be pickled but not unpickled.
            data = ForkingPickler.dumps((False, error, trace))
            pickle.loads(data)
        except Exception:
            plain = RuntimeError(f"{type(error).__name__}: {error}")
            data = ForkingPickler.dumps((False, plain, trace))
        return data


def end_with(parent: int) -> None:
    """Make this process end as soon as the process `parent` ends.

    On Linux the kernel kills it; on other systems a thread watches the parent.
    """
    killed = False
    if sys.platform.startswith("linux"):
        killed = ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL, 0, 0, 0) == 0
    if os.getppid() != parent:  # the parent ended before this was set up
        os._exit(1)
    if not killed:
        threading.Thread(target=_look_after, args=(parent,), daemon=True).start()


def _look_after(parent: int) -> None:
    while os.getppid() == parent:
        time.sleep(0.5)
    os._exit(1)


class Stopped(SystemExit):
    """The process was asked to end, by SIGTERM or by the end of its terminal."""

    last: ClassVar["Stopped | None"] = None
    """The one that was raised last."""

    def __init__(self, number: int) -> None:
        super().__init__(number)
        self.number = number
        """The exit code."""


@contextmanager
def stopping_in_order() -> Iterator[None]:
    """Turn SIGTERM and SIGHUP into `Stopped`, so that resources and temporary files are cleaned up.

    The exit code is that of shells, 128 + the signal's number. Signals that are ignored stay
    ignored (`nohup`).
    """

    def stop(number: int, frame: object) -> None:
        Stopped.last = Stopped(128 + number)
        raise Stopped.last

    changed = []
    if threading.current_thread() is threading.main_thread():
        for name in ("SIGTERM", "SIGHUP"):
            number = getattr(signal, name, None)  # Windows has only SIGTERM
            if number is not None and signal.getsignal(number) == signal.SIG_DFL:
                signal.signal(number, stop)
                changed.append(number)
    try:
        yield
    finally:
        for number in changed:
            signal.signal(number, signal.SIG_DFL)
