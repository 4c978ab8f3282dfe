"""A function in a child process that cannot harm: limits on memory, time and files, no network.

The child is a fresh interpreter in a session of its own. It cuts itself off from the network and
limits itself first (`crowdbench.leaderboard.confined`); the parent watches the memory and the
number of all its processes, and ends them together. What comes back is JSON: nothing that a child
says is run.
"""

import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import msgspec

from crowdbench.errors import CrowdbenchError

Result = TypeVar("Result")
LARGEST_ANSWER = 2**26
_KEPT = (
    "PATH", "HOME", "USER", "LANG", "LC_ALL", "TMPDIR", "TZ", "VIRTUAL_ENV", "LD_LIBRARY_PATH",
)  # fmt: skip
_KEPT_STARTS = ("CROWDBENCH_", "NUMBA_", "OMP_", "PYTHON", "XDG_")
_WATCH_S = 0.1


class SandboxError(CrowdbenchError):
    """What was tried did not end well: it crashed, or met a limit."""


@dataclass(frozen=True)
class Limits:
    """What a child may use."""

    memory_bytes: int = 12 * 2**30
    """Address space of each process, and resident memory of all together."""
    wall_s: float = 24 * 3600.0
    cpu_s: int = 48 * 3600
    """Of each process."""
    file_bytes: int = 2**30
    """Of each file it writes."""
    open_files: int = 1024
    processes: int = 256
    """Processes (of all of them together, not counting threads)."""


@dataclass(frozen=True)
class Ran:
    """How a child ran, in numbers that depend on the machine."""

    wall_s: float
    cpu_s: float
    """Of the processes that were there at once, as far as was seen."""
    peak_bytes: int
    """Largest resident memory of all its processes together that was seen."""
    network: str
    """`none`, or why it could not be cut off."""


class Failure(msgspec.Struct, forbid_unknown_fields=True):
    """An error that a child raised."""

    where: str
    got: str
    expected: str
    mend: str
    problems: tuple["Failure", ...] = ()
    """Of a submission that is refused: what is wrong with it."""


class Answer(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What a child writes when it is done."""

    network: str
    value: msgspec.Raw = msgspec.Raw(b"null")
    failure: Failure | None = None


def call(
    target: str,
    arguments: dict[str, object],
    kind: type[Result],
    *,
    where: object,
    limits: Limits,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> tuple[Result, Ran]:
    """Call `module:function(progress, **arguments)` in a child; its result, read as `kind`.

    `arguments` and the result travel as JSON. `progress(done, total)` says here what the function
    says there. `where` names the cause in messages.

    Raises:
        SandboxError: it crashed, met a limit, or its answer is not of this kind.
        CrowdbenchError: the function raised one: one with its message.
    """
    with tempfile.TemporaryDirectory(prefix="crowdbench-sandbox-") as folder:
        desk = Path(folder)
        asked = {"target": target, "arguments": arguments, "limits": asdict(limits)}
        (desk / "asked.json").write_text(json.dumps(asked))
        ran = _run(desk, where, limits, progress)
        try:
            answer = msgspec.json.decode(_bounded(desk / "answer.json"), type=Answer)
            if answer.failure is not None:
                raise _raised(answer.failure, where)
            value = msgspec.json.decode(answer.value, type=kind)
        except (OSError, msgspec.DecodeError) as error:
            raise SandboxError(
                where, got=f"an answer that cannot be read ({error})", expected=kind.__name__
            ) from error
    return value, Ran(**ran, network=answer.network)


def _raised(told: Failure, where: object) -> CrowdbenchError:
    """The error that a child told of."""
    # Not at the top: the child must leave the network before anything heavy is imported.
    from crowdbench.leaderboard.problems import SubmissionError

    if told.problems:
        return SubmissionError(where, [_raised(problem, where) for problem in told.problems])
    return CrowdbenchError(told.where, got=told.got, expected=told.expected, mend=told.mend)


def _run(
    desk: Path, where: object, limits: Limits, progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """Start the child, watch it until it ends, and end what it leaves behind."""
    began, peak, cpu = time.monotonic(), 0, 0.0
    with (desk / "said.txt").open("wb") as said:
        child = subprocess.Popen(
            [sys.executable, "-m", "crowdbench.leaderboard.confined", str(desk)],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            env=_environment(),
            start_new_session=True,
        )
    broken = ""
    ever: dict[int, _Process] = {}
    try:
        while not broken and child.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                child.wait(_WATCH_S)
            seen = _family(child.pid)
            ever |= seen
            peak = max(peak, sum(process.memory_bytes for process in seen.values()))
            cpu = max(cpu, sum(process.cpu_s for process in seen.values()))
            broken = _broken(limits, len(seen), peak, time.monotonic() - began)
            _tell(desk / "progress", progress)
    finally:
        _end(child, ever)
    if not broken:
        broken = _died(child.returncode, limits)
    if broken:
        last = _last_line(desk / "said.txt")
        raise SandboxError(
            where,
            got=f"{broken}{f'; it said last: {last}' if last else ''}",
            expected="one that ends by itself within the limits",
            mend="If it is sound and the limits are narrow, raise them.",
        )
    return {
        "wall_s": round(time.monotonic() - began, 2),
        "cpu_s": round(cpu, 2),
        "peak_bytes": peak,
    }


def _environment() -> dict[str, str]:
    """What the child knows of its surroundings: no keys, no tokens."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_KEPT_STARTS)
    }
    # Threads that nobody asked for would each reserve memory.
    return {"OPENBLAS_NUM_THREADS": "1", **kept}


class _Process(NamedTuple):
    parent: int
    session: int
    began: int
    """In ticks since the machine started: with its id this is a process and no later one."""
    memory_bytes: int
    cpu_s: float


def _processes() -> dict[int, _Process]:
    """All processes by id; empty where the system does not tell."""
    found = {}
    page, tick = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            # The name in brackets may hold anything.
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            parent, session, user, system, began, pages = (
                int(fields[k]) for k in (1, 3, 11, 12, 19, 21)
            )
            found[int(folder.name)] = _Process(
                parent, session, began, pages * page, (user + system) / tick
            )
    return found


def _family(root: int) -> dict[int, _Process]:
    """A process, its session, and all that these started and that did not lose their parents."""
    everyone = _processes()
    found = {root} | {pid for pid, process in everyone.items() if process.session == root}
    before = 0
    while len(found) > before:
        before = len(found)
        found |= {pid for pid, process in everyone.items() if process.parent in found}
    return {pid: everyone[pid] for pid in found if pid in everyone}


def _broken(limits: Limits, processes: int, peak: int, wall_s: float) -> str:
    """Which limit the child has broken, in words; empty for none."""
    if wall_s > limits.wall_s:
        return f"no end after {limits.wall_s:g} s"
    if peak > limits.memory_bytes:
        return f"more than {limits.memory_bytes / 2**30:g} GiB of memory"
    if processes > limits.processes:
        return f"more than {limits.processes} processes"
    return ""


def _died(code: int, limits: Limits) -> str:
    """How it ended if not well, in words."""
    if code == -signal.SIGXCPU:
        return f"more than {limits.cpu_s} s of CPU time"
    if code < 0:
        return f"a crash ({signal.Signals(-code).name})"
    return "" if code == 0 else f"an end with code {code}"


def _end(child: "subprocess.Popen[bytes]", seen: dict[int, _Process]) -> None:
    """Kill the child, its session, and those who left that but were seen before."""
    seen = seen | _family(child.pid)
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    now = _processes()
    for pid, process in seen.items():
        if pid in now and now[pid].began == process.began:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    child.wait()


def _tell(path: Path, progress: Callable[[int, int], None]) -> None:
    with suppress(OSError, ValueError):
        done, total = path.read_text().split()
        progress(int(done), int(total))


def _bounded(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(LARGEST_ANSWER)


def _last_line(path: Path) -> str:
    """The end of what a child printed, as one line of plain text."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - 2000))
        lines = file.read().decode(errors="replace").split("\n")
    plain = ["".join(c for c in line if c.isprintable()).strip() for line in lines]
    return next((line for line in reversed(plain) if line), "")[:200]
