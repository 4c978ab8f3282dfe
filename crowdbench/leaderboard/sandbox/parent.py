"""Call a function in a child process with limits on memory, time and files, and without network.

The child is a new interpreter in its own session, isolated by bubblewrap where that is installed
(`crowdbench.leaderboard.sandbox.isolation`). First it leaves the network and sets its limits
(`crowdbench.leaderboard.sandbox.child`). The parent watches the memory and the number of all its
processes, and kills them together. The answer is JSON, so nothing from a child is executed. Files
of a child are read only if they are regular files, and only up to a fixed size.
"""

import errno
import json
import os
import signal
import stat
import subprocess
import sys
import time
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import msgspec
import psutil

from crowdbench.errors import CrowdbenchError
from crowdbench.files import temporary_folder
from crowdbench.leaderboard.sandbox import isolation
from crowdbench.progress import ROLLOUTS

Result = TypeVar("Result")
LARGEST_ANSWER = 2**26
_LONGEST_NEWS = 100  # bytes of the progress file
_KEPT = (
    "PATH", "HOME", "USER", "LANG", "LC_ALL", "TMPDIR", "TZ", "VIRTUAL_ENV", "LD_LIBRARY_PATH",
)  # fmt: skip
_KEPT_STARTS = ("CROWDBENCH_", "NUMBA_", "OMP_", "PYTHON", "XDG_")
_READS = {"CROWDBENCH_STORE": "read"}
"""A submission's rollouts are not kept where other evaluations would find them, see `run.store`."""
_WATCH_S = 0.1
_LAST_S = 0.5  # time in which the processes of a killed child may end by themselves, seconds


class SandboxError(CrowdbenchError):
    """A child process crashed, exceeded a limit or gave an invalid answer."""


@dataclass(frozen=True)
class Limits:
    """Limits of a child process."""

    memory_bytes: int = 12 * 2**30
    """Address space of each process, and resident memory of all processes together."""
    wall_s: float = 24 * 3600.0
    cpu_s: int = 48 * 3600
    """CPU time of each process."""
    file_bytes: int = 2**27
    """Size of each file that it writes. A rollout takes a tenth of that; there may be hundreds."""
    open_files: int = 1024
    processes: int = 256
    """Number of processes, not counting threads."""


@dataclass(frozen=True)
class ResourceUsage:
    """Resources that a child used; the values depend on the machine."""

    wall_s: float
    cpu_s: float
    """Largest observed CPU time of the processes that ran at the same time."""
    peak_bytes: int
    """Largest observed resident memory of all its processes together."""
    network: str
    """`none`, or why the network could not be cut off."""
    files: str
    """`isolated`, or why the child could read the user's files."""


ErrorParts = tuple[str, str, str, str]
"""Where an error occurred, what was found, what was expected, and a hint."""


def parts_of(error: CrowdbenchError) -> ErrorParts:
    """The parts of an error's message."""
    return error.where, error.got, error.expected, error.hint


class Answer(msgspec.Struct, forbid_unknown_fields=True, kw_only=True):
    """What a child writes when it is done: the function's result, or the error that it raised."""

    network: str
    value: msgspec.Raw = msgspec.Raw(b"null")
    errors: list[ErrorParts] = []
    """The error, followed by all problems if it is the rejection of a submission."""


def call(
    target: str,
    arguments: dict[str, object],
    kind: type[Result],
    *,
    where: object,
    limits: Limits,
    reads: Sequence[Path] = (),
    writes: Sequence[Path] = (),
) -> tuple[Result, ResourceUsage]:
    """Call `module:function(**arguments)` in a child process.

    Arguments and result are passed as JSON. The progress of the child's rollouts is reported here,
    see `crowdbench.progress`. `where` names the source in messages. An isolated child sees `reads`
    and the folders `writes` of the user's files.

    Returns:
        The function's result, decoded as `kind`, and the resources that the child used.

    Raises:
        SandboxError: the child crashed or exceeded a limit, or its answer is not of type `kind`.
        CrowdbenchError: the function raised one. It has the same message, and a `SubmissionError`
            remains one.
    """
    # Imported late: the child imports this module while it must have a single thread.
    from crowdbench.leaderboard.submission.errors import SubmissionError, plain, tidy

    if os.name != "posix":
        expected = "Linux or macOS: the sandbox uses process groups and resource limits of POSIX"
        hint = "On Windows, use the Windows Subsystem for Linux (WSL)."
        raise SandboxError(where, got=f"the platform {sys.platform}", expected=expected, hint=hint)
    lacking = isolation.lacking()
    with temporary_folder("sandbox") as desk:
        asked = {
            "target": target,
            "arguments": arguments,
            "limits": asdict(limits),
            "parent": os.getpid() if lacking else 0,
        }
        (desk / "asked.json").write_text(json.dumps(asked))
        walls = [] if lacking else isolation.command(desk, reads, writes)
        ran = _run(walls, desk, where, limits)
        try:
            found = _beginning(desk / "answer.json", LARGEST_ANSWER)
            answer = msgspec.json.decode(found, type=Answer)
            if answer.errors:  # their text may quote the submission
                names = ("got", "expected", "hint")
                error, *problems = (
                    CrowdbenchError(at, **dict(zip(names, parts, strict=True)))
                    for at, *parts in answer.errors
                )
                raise SubmissionError(where, problems) if problems else tidy(error)
            value = msgspec.json.decode(answer.value, type=kind)
        except (OSError, msgspec.DecodeError, RecursionError) as error:
            raise SandboxError(
                where, got=f"an answer that cannot be read ({error})", expected=kind.__name__
            ) from error
    files = f"not isolated: {lacking}" if lacking else "isolated"
    return value, ResourceUsage(**ran, network=plain(answer.network), files=files)


def _run(walls: list[str], desk: Path, where: object, limits: Limits) -> dict[str, Any]:
    """Start the child behind `walls`, watch it, and kill what it has started; returns its usage."""
    began, peak, cpu, broken = time.monotonic(), 0, 0.0, ""
    ever: set[psutil.Process] = set()
    with (desk / "said.txt").open("w+b") as said:
        child = subprocess.Popen(
            [*walls, sys.executable, "-m", "crowdbench.leaderboard.sandbox.child", str(desk)],
            stdin=subprocess.DEVNULL,
            stdout=said,
            stderr=said,
            env=_environment(),
            start_new_session=True,
        )
        try:
            while not broken and child.poll() is None:
                with suppress(subprocess.TimeoutExpired):
                    child.wait(_WATCH_S)
                seen = _family(child.pid)
                ever |= seen
                memory, cpu_s = _used(seen)
                peak, cpu = max(peak, memory), max(cpu, cpu_s)
                broken = _broken(limits, len(seen), peak, time.monotonic() - began)
                with suppress(OSError, ValueError):  # it has not told anything, or nonsense
                    done, total = _beginning(desk / "progress", _LONGEST_NEWS).split()
                    ROLLOUTS(int(done), int(total))
        finally:
            _end(child, ever)
        if broken := broken or _died(child.returncode, limits):
            last = _last_line(said.fileno())
            got = f"{broken}{f', last output: {last}' if last else ''}"
            expected = "a run that ends within the limits"
            hint = "If the submission is correct and needs more, raise the limits."
            raise SandboxError(where, got=got, expected=expected, hint=hint)
    wall_s = round(time.monotonic() - began, 2)
    return {"wall_s": wall_s, "cpu_s": round(cpu, 2), "peak_bytes": peak}


def _family(root: int) -> set[psutil.Process]:
    """A process, its session and all their descendants, without those that have ended.

    Processes that left the session and whose parents have ended are not found.
    """
    parents: dict[psutil.Process, int] = {}
    found = set()
    for process in psutil.process_iter():
        with suppress(psutil.Error, OSError):
            if process.status() != psutil.STATUS_ZOMBIE:
                parents[process] = process.ppid()
                if root in (process.pid, os.getsid(process.pid)):
                    found.add(process)
    before = -1
    while len(found) > before:
        before, pids = len(found), {process.pid for process in found}
        found |= {process for process, parent in parents.items() if parent in pids}
    return found


def _used(processes: Iterable[psutil.Process]) -> tuple[int, float]:
    """The resident memory (bytes) and CPU time (s) of processes together."""
    memory, cpu_s = 0, 0.0
    for process in processes:
        with suppress(psutil.Error), process.oneshot():
            memory += process.memory_info().rss
            times = process.cpu_times()
            cpu_s += times.user + times.system
    return memory, cpu_s


def _end(child: "subprocess.Popen[bytes]", seen: set[psutil.Process]) -> None:
    """Kill the child, its session, and the processes in `seen` that have left the session.

    Its own workers end with the child. Whoever tracks their shared resources is given time to
    remove them.
    """
    # Nobody else may wait for the child: its exit code would be lost.
    others = {process for process in seen | _family(child.pid) if process.pid != child.pid}
    child.kill()
    psutil.wait_procs(others, timeout=_LAST_S)
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    for process in others:
        with suppress(psutil.Error):
            process.kill()
    child.wait()


def _environment() -> dict[str, str]:
    kept = {
        name: value
        for name, value in os.environ.items()
        if name in _KEPT or name.startswith(_KEPT_STARTS)
    }
    # Each thread of OpenBLAS would reserve memory. With PYTHONSAFEPATH, nothing is imported from
    # the current folder, which may be a submission's.
    return {"OPENBLAS_NUM_THREADS": "1", **kept, "PYTHONSAFEPATH": "1", **_READS}


def _broken(limits: Limits, processes: int, peak: int, wall_s: float) -> str:
    """The limit that the child has exceeded, in words; empty if none."""
    if wall_s > limits.wall_s:
        return f"no end after {limits.wall_s:g} s"
    if peak > limits.memory_bytes:
        return f"more than {limits.memory_bytes / 2**30:g} GiB of memory"
    if processes > limits.processes:
        return f"more than {limits.processes} processes"
    return ""


def _died(code: int, limits: Limits) -> str:
    """How the child failed, in words; empty if it ended normally."""
    number = code - 128 if code > 128 else -code  # bubblewrap tells signals as shells do
    if number == signal.SIGXCPU:
        return f"more than {limits.cpu_s} s of CPU time"
    if number in {*signal.Signals} and (code < 0 or code > 128):
        return f"a crash ({signal.Signals(number).name})"
    return "" if code == 0 else f"exit code {code}"


def _beginning(path: Path, most: int) -> bytes:
    """The first bytes of a regular file: links could lead anywhere, and pipes could block."""

    def opener(name: str, flags: int) -> int:
        return os.open(name, flags | os.O_NOFOLLOW | os.O_NONBLOCK)

    with open(path, "rb", opener=opener) as file:
        if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
            raise OSError(errno.EINVAL, "not a regular file")
        return file.read(most)


def _last_line(said: int) -> str:
    """The last line that a child printed to the open file `said`, as plain text."""
    end = os.pread(said, 2000, max(0, os.fstat(said).st_size - 2000))
    plain = ["".join(c for c in line if c.isprintable()).strip()
             for line in end.decode(errors="replace").split("\n")]  # fmt: skip
    return next((line for line in reversed(plain) if line), "")[:200]
