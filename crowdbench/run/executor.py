"""Parallel work: in processes that end with the one that started them, or on a Ray cluster."""

import os
import pickle
import re
import signal
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, BrokenExecutor, Future, wait
from contextlib import contextmanager, nullcontext
from contextvars import ContextVar
from functools import cache, partial
from pathlib import Path
from typing import Any, TypeVar

from crowdbench import plugins
from crowdbench.errors import SettingError, WorkerError, checked
from crowdbench.run import ray_executor
from crowdbench.run.processes import LOCAL, end_with, outcome_of, result_of

Result = TypeVar("Result")

MOST_WORKERS = 10_000
ALONE_S = 3.0
"""Seconds after which the first worker process gets help: twice what it needs to start."""
_THREADS = (
    "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS", "NUMBA_NUM_THREADS", "NUMEXPR_NUM_THREADS",
)  # fmt: skip
_engine: ContextVar[str] = ContextVar("engine", default=LOCAL)


@checked()
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
    if name not in (LOCAL, ray_executor.NAME) and not name.startswith(ray_executor.CLIENT):
        raise SettingError(
            "engine",
            got=repr(name),
            expected="local, ray, or the address ray://HOST:PORT of a Ray client server",
            hint="For the cluster of a head node, set RAY_ADDRESS=HOST:PORT and choose ray."
            if ":" in name
            else "",
        )
    with nullcontext() if name == LOCAL else ray_executor.connected(name):
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
        SettingError: `asked` is less than 1, or more than `MOST_WORKERS`.
    """
    if asked is not None and not 1 <= asked <= MOST_WORKERS:
        raise SettingError("workers", got=str(asked), expected=f"1 to {MOST_WORKERS:,}")
    return asked or (os.cpu_count() or 1 if is_local() else ray_executor.cpus())


def call_each(
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    workers: int,
    *,
    common: tuple[object, ...] = (),
    name: Callable[..., str] = lambda *task: "a task",
    files: Callable[..., Sequence[Path]] = lambda *task: (),
    reads: Callable[..., Sequence[Path]] = lambda *task: (),
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
        yield from ray_executor.call_each(
            function, tasks, workers, common=common, name=name, files=files, reads=reads
        )
        return
    workers = min(workers, len(tasks))
    if workers > 1:
        yield from _in_processes(function, tasks, workers, common, name)
        return
    for index, task in enumerate(tasks):
        yield index, function(*task, *common)


def _in_processes(
    function: Callable[..., Result],
    tasks: Sequence[tuple[object, ...]],
    most: int,
    common: tuple[object, ...],
    name: Callable[..., str],
) -> Generator[tuple[int, Result], None, None]:
    """`call_each` in up to `most` processes, each an executor of its own.

    So the task is known that a process died of. One process is started at once, the others if
    tasks remain after `ALONE_S`: to start one takes as long as many rollouts of a small scene.
    """
    from loky.process_executor import ProcessPoolExecutor

    given = pickle.dumps((function, common)), plugins.shared()
    start = partial(
        ProcessPoolExecutor, 1, initializer=_begin, initargs=(os.getpid(), given),
        env=_environment(),
    )  # fmt: skip
    team: list[ProcessPoolExecutor] = []
    idle: list[ProcessPoolExecutor] = []
    busy: dict[Future[bytes], tuple[ProcessPoolExecutor, int]] = {}
    waiting, until = deque(range(len(tasks))), time.monotonic() + ALONE_S
    try:
        while waiting or busy:
            while waiting and len(busy) < (1 if time.monotonic() < until else most):
                if not idle:
                    idle.append(start())
                    team += idle
                worker, index = idle.pop(), waiting.popleft()
                busy[worker.submit(_call, tasks[index])] = worker, index
            helps = len(busy) < most and waiting
            left_s = max(0.0, until - time.monotonic()) if helps else None
            for future in wait(busy, left_s, FIRST_COMPLETED).done:
                worker, index = busy.pop(future)
                idle.append(worker)
                yield index, _result(future, name(*tasks[index]))
    finally:
        for worker in team:
            worker.shutdown(kill_workers=True)


def _environment() -> dict[str, str]:
    """One thread for each process; and no check of loky's whether its memory grows."""
    wanted = dict.fromkeys(_THREADS, "1") | {"LOKY_MAX_MEMORY_LEAK_SIZE": "1e18"}
    return {name: value for name, value in wanted.items() if name not in os.environ}


_given: tuple[bytes, bytes]
"""In a worker process: the pickled function and common arguments of its tasks, and plugins."""


def _begin(parent: int, given: tuple[bytes, bytes]) -> None:
    global _given
    end_with(parent)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # handled by the process that started this one
    import numba

    numba.set_num_threads(1)  # the processes already use all cores
    _given = given


@cache
def _unpacked() -> tuple[Callable[..., object], tuple[object, ...]]:
    """The function and common arguments; errors in it are those of the first task."""
    packed, registered = _given
    plugins.restore(registered)
    return pickle.loads(packed)


def _call(task: tuple[object, ...]) -> bytes:
    """The outcome of a task in a worker process."""

    def call() -> object:
        function, common = _unpacked()
        return function(*task, *common)

    return outcome_of(call)


def _result(future: "Future[bytes]", where: str) -> Any:
    """The result of a task; raises the exception that it raised.

    Raises:
        WorkerError: its process died.
    """
    try:
        outcome = future.result()
    except BrokenExecutor as error:
        codes = re.search(r"{(.*)}", str(error))  # such as SIGKILL(-9) or EXIT(3)
        ended = codes[1] if codes else "an unknown code"
        hint = "Finished work is kept: the same command continues from there."
        if "SIGKILL" in ended:
            hint = f"The system may have run out of memory: use fewer workers. {hint}"
        elif "EXIT" in ended:
            hint = f"Code in it exits Python. {hint}"
        raise WorkerError(
            where,
            got=f"a worker process that ended with {ended}",
            expected="one that finishes its work",
            hint=hint,
        ) from error
    return result_of(outcome)
