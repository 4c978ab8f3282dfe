"""Work shared by processes."""

import os
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

from crowdbench.errors import SettingError

Result = TypeVar("Result")


def checked_workers(asked: int | None) -> int:
    """The number of processes: as asked, or one per core.

    Raises:
        SettingError: fewer than one are asked for.
    """
    if asked is not None and asked < 1:
        raise SettingError("workers", got=str(asked), expected="1 or more")
    return asked or os.cpu_count() or 1


def call_each(
    function: Callable[..., Result], tasks: Sequence[tuple[object, ...]], workers: int
) -> Iterator[tuple[int, Result]]:
    """Call `function(*task)` for each task; index and result of each as it is done.

    With one worker the calls are made here, else in so many processes, on one thread each.
    """
    workers = min(workers, len(tasks))
    if workers <= 1:
        for index, task in enumerate(tasks):
            yield index, function(*task)
        return
    from joblib import Parallel, delayed
    from joblib.externals.loky import get_reusable_executor

    # joblib's own processes are started afresh, not forked: forking after OpenMP has run hangs.
    parallel = Parallel(n_jobs=workers, return_as="generator_unordered", pre_dispatch=workers)
    try:
        yield from parallel(
            delayed(_alone)(function, index, task) for index, task in enumerate(tasks)
        )
    finally:
        # Left alone, the processes would serve the next call too, in this one's surroundings.
        get_reusable_executor().shutdown(kill_workers=True)


def _alone(
    function: Callable[..., Result], index: int, task: tuple[object, ...]
) -> tuple[int, Result]:
    """Call on one thread: the processes already fill the machine."""
    import numba

    numba.set_num_threads(1)
    return index, function(*task)
