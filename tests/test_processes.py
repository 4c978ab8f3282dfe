"""Work shared by processes: the same results from any number, and errors that arrive."""

import os

import numba
import numpy as np
import pytest

from crowdbench.errors import CrowdbenchError, SettingError
from crowdbench.processes import call_each, checked_workers

TASKS = [(3, 4), (10, 1), (2, 2)]


def drawn(seed: int, size: int) -> list[float]:
    return np.random.default_rng(seed).random(size).tolist()


def surroundings(_: int) -> tuple[int, int]:
    return os.getpid(), numba.get_num_threads()


def failing(error: Exception | None) -> str:
    if error is not None:
        raise error
    return "done"


@pytest.mark.parametrize("workers", [1, 2, 9])
def test_each_task_gives_its_own_result_with_its_index(workers: int) -> None:
    found = list(call_each(drawn, TASKS, workers))
    assert sorted(index for index, _ in found) == [0, 1, 2]
    assert all(result == drawn(*TASKS[index]) for index, result in found)


@pytest.mark.parametrize("workers", [1, 2])
def test_no_tasks_are_no_calls(workers: int) -> None:
    assert list(call_each(drawn, [], workers)) == []


def test_one_worker_works_here_and_several_elsewhere_on_one_thread_each() -> None:
    threads = numba.get_num_threads()
    ((_, here),) = call_each(surroundings, [(0,)], 5)  # a task is never shared
    elsewhere = [result for _, result in call_each(surroundings, [(0,), (1,)], 2)]
    assert here == (os.getpid(), threads)
    assert all(pid != os.getpid() and count == 1 for pid, count in elsewhere)
    assert numba.get_num_threads() == threads


@pytest.mark.parametrize("workers", [1, 2])
@pytest.mark.parametrize(
    "error", [ValueError("what went wrong"), SettingError("here", got="this", expected="that")]
)
def test_an_error_of_a_worker_reaches_the_caller_as_it_was(workers: int, error: Exception) -> None:
    with pytest.raises(type(error)) as caught:
        list(call_each(failing, [(None,), (error,), (None,)], workers))
    assert str(error) in str(caught.value)
    if isinstance(error, CrowdbenchError):
        assert (caught.value.where, caught.value.got) == ("here", "this")


def test_after_an_error_there_are_workers_for_the_next_call() -> None:
    with pytest.raises(ValueError, match="wrong"):
        list(call_each(failing, [(ValueError("wrong"),)] * 2, 2))
    assert [result for _, result in call_each(failing, [(None,), (None,)], 2)] == ["done", "done"]


def test_workers_are_as_many_as_asked_for_or_as_there_are_cores() -> None:
    assert checked_workers(3) == 3
    assert checked_workers(None) == (os.cpu_count() or 1)


@pytest.mark.parametrize("asked", [0, -1])
def test_fewer_than_one_worker_is_refused(asked: int) -> None:
    with pytest.raises(SettingError, match="1 or more"):
        checked_workers(asked)
