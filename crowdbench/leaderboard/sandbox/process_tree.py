"""The processes of a sandbox: find them, measure them and kill them."""

import os
import signal
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple


class Process(NamedTuple):
    """What the system reports about a process."""

    parent: int
    session: int
    began: int
    """Start time in ticks since boot. With its id it identifies a process; ids alone are reused."""
    memory_bytes: int
    cpu_s: float


def _processes() -> dict[int, Process]:
    """All processes by id; empty if the system has no `/proc`."""
    found = {}
    page, tick = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            # The process name in brackets may contain anything, so only the rest is parsed.
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            parent, session, user, system, began, pages = (
                int(fields[k]) for k in (1, 3, 11, 12, 19, 21)
            )
            found[int(folder.name)] = Process(
                parent, session, began, pages * page, (user + system) / tick
            )
    return found


def family(root: int) -> dict[int, Process]:
    """A process, its session and all their descendants, by id.

    Processes that left the session and whose parents have ended are not found.
    """
    everyone = _processes()
    found = {root} | {pid for pid, process in everyone.items() if process.session == root}
    before = 0
    while len(found) > before:
        before = len(found)
        found |= {pid for pid, process in everyone.items() if process.parent in found}
    return {pid: everyone[pid] for pid in found if pid in everyone}


def end(child: "subprocess.Popen[bytes]", seen: dict[int, Process]) -> None:
    """Kill the child, its session, and the processes in `seen` that have left the session."""
    seen = seen | family(child.pid)
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    now = _processes()
    for pid, process in seen.items():
        if pid in now and now[pid].began == process.began:
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
    child.wait()
