"""Work shared by processes: the same results from any number, errors that arrive, no leftovers."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numba
import numpy as np
import pytest

from crowdbench.errors import CrowdbenchError, SettingError, WorkerError
from crowdbench.files import replacing, temporary_folder
from crowdbench.run.executor import call_each, checked_workers

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
    with pytest.raises(SettingError, match="1 to 10,000"):
        checked_workers(asked)


def dying(number: int) -> None:
    if number:
        os.kill(os.getpid(), number)


def leaving(code: int) -> None:
    if code:
        os._exit(code)


def summed(size: int, common: np.ndarray) -> tuple[int, float]:
    return id(common), float(common[:size].sum())


class PickyError(Exception):
    """Can be written, and not be made again from that."""

    def __init__(self, one: int, other: int) -> None:
        super().__init__(f"{one} and {other}")


def picky(_: int) -> None:
    raise PickyError(1, 2)


@pytest.mark.parametrize(
    ("function", "how", "message"),
    [(dying, signal.SIGKILL, "ended with SIGKILL.*use fewer workers"),
     (dying, signal.SIGSEGV, "ended with SIGSEGV"),
     (leaving, 3, r"ended with EXIT\(3\).*exits Python")],
)  # fmt: skip
def test_a_worker_that_dies_is_told_by_its_task(function: object, how: int, message: str) -> None:
    with pytest.raises(WorkerError, match=message) as error:
        list(call_each(function, [(0,), (int(how),)], 2, name="task {}".format))  # type: ignore[arg-type]
    assert error.value.where == f"task {int(how)}"


def test_what_tasks_have_in_common_is_sent_once_to_each_worker_and_not_by_shared_memory() -> None:
    common = np.ones(2**21)  # beyond the size from which joblib would write it to shared memory
    before = shared()
    found = [
        result for _, result in call_each(summed, [(k,) for k in range(6)], 2, common=(common,))
    ]
    assert sorted(total for _, total in found) == [0, 1, 2, 3, 4, 5]
    assert len({identity for identity, _ in found}) <= 2
    assert not [name for name in shared() - before if not name.startswith("sem.")]


def shared() -> set[str]:
    return (
        {path.name for path in Path("/dev/shm").iterdir()} if Path("/dev/shm").is_dir() else set()
    )


def test_an_error_that_cannot_be_sent_is_told_by_its_name() -> None:
    with pytest.raises(RuntimeError, match="PickyError: 1 and 2") as error:
        list(call_each(picky, [(0,), (1,)], 2))
    assert "in picky" in "".join(error.value.__notes__)


def test_workers_see_the_callers_surroundings_but_for_threads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("CROWDBENCH_TOLD", "this")
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    found = [of for _, of in call_each(os.getenv, [("CROWDBENCH_TOLD",), ("OMP_NUM_THREADS",)], 2)]
    assert sorted(found) == ["1", "this"]  # type: ignore[type-var]
    assert "OMP_NUM_THREADS" not in os.environ


def memory_that_may_grow(_: int) -> int:
    from loky import process_executor

    return process_executor._MAX_MEMORY_LEAK_SIZE


def test_a_worker_keeps_what_it_has_loaded_however_much_that_is() -> None:
    assert all(most > 2**40 for _, most in call_each(memory_that_may_grow, [(0,), (1,)], 2))


SCRIPT = """
import math, sys
from crowdbench.run.executor import call_each

print("run", flush=True)
print(sorted(value for _, value in call_each(math.sqrt, [(4.0,), (9.0,)], 2)))
"""


def test_a_script_needs_no_guard_against_being_run_by_workers(tmp_path: Path) -> None:
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    done = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert (done.stdout, done.stderr) == ("run\n[2.0, 3.0]\n", "")


KILLED = """
import sys
from pathlib import Path
from crowdbench.files import replacing, temporary_folder
from crowdbench.run.executor import call_each
import test_executor

folder = Path(sys.argv[1])
with temporary_folder("test") as other, replacing(folder / "mine.txt"):
    list(call_each(test_executor.hanging, [(folder / str(k), other) for k in range(2)], 2))
"""


def hanging(path: Path, other: Path) -> None:
    """Hang in the middle of writing a file, in compiled code that lets no thread run."""
    (other / path.name).write_text("half")
    with replacing(path) as temporary:
        temporary.write_text("half")
        noted = path.with_suffix(".pid")
        noted.with_suffix(".new").write_text(f"{os.getpid()}")
        noted.with_suffix(".new").rename(noted)
        spin()


@numba.njit
def spin() -> int:
    k = 0
    while k >= 0:
        k = (k + 1) % 1000
    return k


@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_whoever_is_killed_leaves_no_process_and_no_file_after_the_next_start(
    tmp_path: Path, number: signal.Signals, monkeypatch: pytest.MonkeyPatch
) -> None:
    out, temporary = tmp_path / "out", tmp_path / "tmp"
    out.mkdir()
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    tests = os.pathsep.join(map(str, Path(__file__).parents[:2]))
    monkeypatch.setenv("PYTHONPATH", tests, prepend=os.pathsep)
    with subprocess.Popen([sys.executable, "-c", KILLED, str(out)]) as process:
        soon = time.monotonic() + 60
        while len(list(out.glob("*.pid"))) < 2 and time.monotonic() < soon:
            time.sleep(0.05)
        assert list(temporary.iterdir())
        assert [path for path in out.rglob(".*") if path.suffix == ".txt"]
        os.kill(process.pid, number)
    workers = [int(path.read_text()) for path in out.glob("*.pid")]
    assert len(workers) == 2
    soon = time.monotonic() + 10
    while (any(map(alive, workers)) or shared_by(process.pid)) and time.monotonic() < soon:
        time.sleep(0.02)
    assert not any(map(alive, workers))
    assert not shared_by(process.pid)
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    for path in left(out, temporary):
        os.utime(path, (LONG_AGO, LONG_AGO))
    with temporary_folder("test"):
        for name in ("0", "1", "mine.txt"):
            with replacing(out / name):
                pass
    assert left(out, temporary) == []


LONG_AGO = 1_000_000_000


def left(out: Path, temporary: Path) -> list[Path]:
    return [*out.rglob(".*"), *temporary.iterdir()]


def shared_by(process: int) -> list[str]:
    return [name for name in shared() if f"-{process}-" in name]


def alive(process: int) -> bool:
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"
