"""The processes of a sandbox: find them, measure them and kill them."""

import os
import signal
import subprocess
import time
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

_LAST_S = 0.5
"""Time in which the processes of a killed child may end by themselves, seconds."""


class Process(NamedTuple):
    """What the system reports about a process."""

    parent: int
    session: int
    began: int
    """Start time in ticks since boot. With its id it identifies a process; ids alone are reused."""
    memory_bytes: int
    cpu_s: float


def _processes() -> dict[int, Process]:
    """All processes that run by id; empty if the system has no `/proc`."""
    found = {}
    page, tick = os.sysconf("SC_PAGE_SIZE"), os.sysconf("SC_CLK_TCK")
    for folder in Path("/proc").glob("[0-9]*"):
        with suppress(OSError, ValueError, IndexError):
            # The process name in brackets may contain anything, so only the rest is parsed.
            fields = (folder / "stat").read_text(errors="replace").rpartition(")")[2].split()
            if fields[0] == "Z":
                continue
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
    """Kill the child, its session, and the processes in `seen` that have left the session.

    Its own workers end with the child. Whoever tracks their shared resources is given time to
    remove them.
    """
    seen = seen | family(child.pid)
    child.kill()
    until = time.monotonic() + _LAST_S
    while time.monotonic() < until and _left(seen):
        time.sleep(0.02)
    with suppress(ProcessLookupError):
        os.killpg(child.pid, signal.SIGKILL)
    for pid in _left(seen):
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    child.wait()


def _left(seen: dict[int, Process]) -> list[int]:
    """Those of `seen` that still run."""
    now = _processes()
    return [pid for pid, old in seen.items() if pid in now and now[pid].began == old.began]
