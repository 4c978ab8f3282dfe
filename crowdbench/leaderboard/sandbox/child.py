"""The child process of a sandbox: `python -m crowdbench.leaderboard.sandbox.child DESK`.

It leaves the network and sets its limits before any heavy import: a process may enter a user
namespace only while it has a single thread.
"""

import ctypes
import importlib
import json
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import msgspec

from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.sandbox.parent import Limits, parts_of
from crowdbench.progress import heard_by
from crowdbench.run.processes import end_with

_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000


def main(arguments: Sequence[str]) -> None:
    """Set the limits, call the function and write the answer."""
    desk = Path(arguments[0])
    asked = json.loads((desk / "asked.json").read_text())
    network = "none"  # bubblewrap has left it
    if parent := int(asked["parent"]):
        network = _leave_network()
        end_with(parent)  # after the namespace: new credentials reset this setting
    _limit(Limits(**asked["limits"]))
    answer: dict[str, object] = {"network": network}
    try:
        answer["value"] = _called(asked["target"], asked["arguments"], desk)
    except CrowdbenchError as error:
        answer["errors"] = list(map(parts_of, (error, *getattr(error, "problems", ()))))
    except MemoryError:
        sys.exit("out of memory")
    (desk / "answer.json").write_bytes(msgspec.json.encode(answer))


def _called(target: str, arguments: dict[str, object], desk: Path) -> object:
    module, _, name = target.partition(":")

    def listen(stage: str, done: int, total: int | None) -> None:
        if stage == "rollouts":
            half = desk / "progress.half"
            half.write_text(f"{done} {total}")
            half.replace(desk / "progress")

    with heard_by(listen):
        return getattr(importlib.import_module(module), name)(**arguments)


def _leave_network() -> str:
    """Enter a new, empty network namespace; return `none`, or why that was not possible.

    An ordinary user may do this inside a new user namespace, if the system allows one.
    """
    if not sys.platform.startswith("linux"):
        return f"not cut off: {sys.platform} has no network namespaces"
    user, group = os.getuid(), os.getgid()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET) != 0:
        return f"not cut off: {os.strerror(ctypes.get_errno())}"
    # Ids are mapped to themselves, so that written files belong to the user.
    with suppress(OSError):
        Path("/proc/self/setgroups").write_text("deny")
        Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
        Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
    return "none"


def _limit(limits: Limits) -> None:
    import resource

    for what, most in (
        (resource.RLIMIT_AS, limits.memory_bytes),
        (resource.RLIMIT_CPU, limits.cpu_s),
        (resource.RLIMIT_FSIZE, limits.file_bytes),
        (resource.RLIMIT_NOFILE, limits.open_files),
        (resource.RLIMIT_CORE, 0),
    ):
        hard = resource.getrlimit(what)[1]
        if hard != resource.RLIM_INFINITY:
            most = min(most, hard)
        # A process can ignore the signal at the soft CPU limit, but not the one at the hard limit.
        last = most + 5 if what == resource.RLIMIT_CPU and hard == resource.RLIM_INFINITY else most
        resource.setrlimit(what, (most, last))


if __name__ == "__main__":
    main(sys.argv[1:])
