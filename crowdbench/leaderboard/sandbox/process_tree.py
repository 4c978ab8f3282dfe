"""The processes of a sandbox: find them and kill them."""

import os
import signal
import subprocess
from collections.abc import Iterable
from contextlib import suppress

import psutil

_LAST_S = 0.5
"""Time in which the processes of a killed child may end by themselves, seconds."""


def family(root: int) -> set[psutil.Process]:
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


def used(processes: Iterable[psutil.Process]) -> tuple[int, float]:
    """The resident memory (bytes) and CPU time (s) of processes together."""
    memory, cpu_s = 0, 0.0
    for process in processes:
        with suppress(psutil.Error), process.oneshot():
            memory += process.memory_info().rss
            times = process.cpu_times()
            cpu_s += times.user + times.system
    return memory, cpu_s


def end(child: "subprocess.Popen[bytes]", seen: set[psutil.Process]) -> None:
    """Kill the child, its session, and the processes in `seen` that have left the session.

    Its own workers end with the child. Whoever tracks their shared resources is given time to
    remove them.
    """
    # Nobody else may wait for the child: its exit code would be lost.
    others = {process for process in seen | family(child.pid) if process.pid != child.pid}
    child.kill()
    psutil.wait_procs(others, timeout=_LAST_S)
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    for process in others:
        with suppress(psutil.Error):
            process.kill()
    child.wait()
