"""A function in a child process that cannot harm: limits on memory, time and files, no network.

The child is a fresh interpreter in a session of its own. It cuts itself off from the network and
limits itself first (`crowdbench.leaderboard.sandbox.child`); the parent watches the memory and the
number of all its processes, and ends them together. What comes back is JSON: nothing that a child
says is run. What it leaves in its folder is read only if it is a plain file, and never whole.
"""

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from crowdbench import leftovers
from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.sandbox.process_tree import Process, end, family

Result = TypeVar("Result")
LARGEST_ANSWER = 2**26
_LONGEST_NEWS = 100  # bytes of a file that tells of progress
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
    file_bytes: int = 2**27
    """Of each file it writes: a rollout takes a tenth of that, and there may be hundreds."""
    open_files: int = 1024
    processes: int = 256
    """Processes (of all of them together, not counting threads)."""


@dataclass(frozen=True)
class ResourceUsage:
    """How a child ran, in numbers that depend on the machine."""

    wall_s: float
    cpu_s: float
    """Of the processes that were there at once, as far as was seen."""
    peak_bytes: int
    """Largest resident memory of all its processes together that was seen."""
    network: str
    """`none`, or why it could not be cut off."""


class ErrorPayload(msgspec.Struct, forbid_unknown_fields=True):
    """The parts of an error's message."""

    where: str
    got: str
    expected: str
    hint: str

    @classmethod
    def of(cls, error: CrowdbenchError) -> "ErrorPayload":
        """Those of an error."""
        return cls(error.where, error.got, error.expected, error.hint)

    def error(self) -> CrowdbenchError:
        """The error again."""
        return CrowdbenchError(self.where, got=self.got, expected=self.expected, hint=self.hint)


class Failure(msgspec.Struct, forbid_unknown_fields=True):
    """An error that a child raised."""

    told: ErrorPayload
    problems: list[ErrorPayload] = []
    """All that is wrong with a submission that is refused."""


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
) -> tuple[Result, ResourceUsage]:
    """Call `module:function(progress, **arguments)` in a child; its result, read as `kind`.

    `arguments` and the result travel as JSON. `progress(done, total)` says here what the function
    says there. `where` names the cause in messages.

    Raises:
        SandboxError: it crashed, met a limit, or its answer is not of this kind.
        CrowdbenchError: the function raised one: one with its message, a `SubmissionError` where
            it was one.
    """
    # Not above: the child leaves the network before it imports what this does.
    from crowdbench.leaderboard.submission.errors import plain

    with leftovers.temporary_folder("sandbox") as desk:
        asked = {
            "target": target,
            "arguments": arguments,
            "limits": asdict(limits),
            "parent": os.getpid(),
            "sweeper": leftovers.pipe(),
        }
        (desk / "asked.json").write_text(json.dumps(asked))
        ran = _run(desk, where, limits, progress)
        try:
            found = _beginning(desk / "answer.json", LARGEST_ANSWER)
            answer = msgspec.json.decode(found, type=Answer)
            if answer.failure is not None:
                raise _raised(answer.failure, where)
            value = msgspec.json.decode(answer.value, type=kind)
        except (OSError, msgspec.DecodeError, RecursionError) as error:
            raise SandboxError(
                where, got=f"an answer that cannot be read ({error})", expected=kind.__name__
            ) from error
    return value, ResourceUsage(**ran, network=plain(answer.network))


def _raised(failure: Failure, where: object) -> CrowdbenchError:
    """The child's error; its text may hold what a submission says."""
    from crowdbench.leaderboard.submission.errors import SubmissionError, tidy

    if failure.problems:
        return SubmissionError(where, [problem.error() for problem in failure.problems])
    return tidy(failure.told.error())


def _run(
    desk: Path, where: object, limits: Limits, progress: Callable[[int, int], None]
) -> dict[str, Any]:
    """Start the child, watch it until it ends, and end what it leaves behind."""
    with (desk / "said.txt").open("w+b") as said:
        child = subprocess.Popen(
            [sys.executable, "-m", "crowdbench.leaderboard.sandbox.child", str(desk)],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            env=_environment(),
            start_new_session=True,
            pass_fds=[pipe] if (pipe := leftovers.pipe()) is not None else [],
        )
        broken, ran = _watched(child, desk, limits, progress)
        if broken:
            last = _last_line(said.fileno())
            raise SandboxError(
                where,
                got=f"{broken}{f'; it said last: {last}' if last else ''}",
                expected="one that ends by itself within the limits",
                hint="If it is sound and the limits are narrow, raise them.",
            )
    return ran


def _watched(
    child: "subprocess.Popen[bytes]",
    desk: Path,
    limits: Limits,
    progress: Callable[[int, int], None],
) -> tuple[str, dict[str, Any]]:
    """Wait until the child ends, or end it; what it broke, in words, and how it ran."""
    began, peak, cpu, broken = time.monotonic(), 0, 0.0, ""
    ever: dict[int, Process] = {}
    try:
        while not broken and child.poll() is None:
            with suppress(subprocess.TimeoutExpired):
                child.wait(_WATCH_S)
            seen = family(child.pid)
            ever |= seen
            peak = max(peak, sum(process.memory_bytes for process in seen.values()))
            cpu = max(cpu, sum(process.cpu_s for process in seen.values()))
            broken = _broken(limits, len(seen), peak, time.monotonic() - began)
            _tell(desk / "progress", progress)
    finally:
        end(child, ever)
    ran = {
        "wall_s": round(time.monotonic() - began, 2),
        "cpu_s": round(cpu, 2),
        "peak_bytes": peak,
    }
    return broken or _died(child.returncode, limits), ran


def _environment() -> dict[str, str]:
    """What the child knows of its surroundings: no keys, no tokens."""
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_KEPT_STARTS)
    }
    # Threads that nobody asked for would each reserve memory. What lies in the folder where one
    # stands, which may be a submission's, is nothing to be imported.
    return {"OPENBLAS_NUM_THREADS": "1", **kept, "PYTHONSAFEPATH": "1"}


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


def _tell(path: Path, progress: Callable[[int, int], None]) -> None:
    with suppress(OSError, ValueError):
        done, total = _beginning(path, _LONGEST_NEWS).split()
        progress(int(done), int(total))


def _beginning(path: Path, most: int) -> bytes:
    """The first bytes of a plain file. Links could lead anywhere, pipes would hold us up.

    Raises:
        OSError: it is no plain file, or there is none.
    """

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK)

    with open(path, "rb", opener=opener) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "no plain file")
        return file.read(most)


def _last_line(said: int) -> str:
    """The end of what a child printed into the open file `said`, as one line of plain text."""
    end = os.pread(said, 2000, max(0, os.fstat(said).st_size - 2000))
    plain = ["".join(c for c in line if c.isprintable()).strip()
             for line in end.decode(errors="replace").split("\n")]  # fmt: skip
    return next((line for line in reversed(plain) if line), "")[:200]
