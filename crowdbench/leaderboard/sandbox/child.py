"""The child of a sandbox: `python -m crowdbench.leaderboard.sandbox.child DESK`.

It leaves the network and limits itself before anything heavy is imported: a process may enter a
user namespace as long as it has one thread only.
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

from crowdbench import leftovers
from crowdbench.errors import CrowdbenchError
from crowdbench.evaluation.parallel import end_with
from crowdbench.leaderboard.sandbox.parent import ErrorPayload, Failure, Limits

_CLONE_NEWUSER, _CLONE_NEWNET = 0x10000000, 0x40000000


def main(arguments: Sequence[str]) -> None:
    """What the child does: limit itself, call, answer."""
    desk = Path(arguments[0])
    asked = json.loads((desk / "asked.json").read_text())
    network = _leave_network()
    end_with(int(asked["parent"]))  # after the namespace: whose credentials change is forgotten
    leftovers.share(asked["sweeper"])
    _limit(Limits(**asked["limits"]))
    answer: dict[str, object] = {"network": network}
    try:
        answer["value"] = _called(asked["target"], asked["arguments"], desk)
    except CrowdbenchError as error:
        problems = [ErrorPayload.of(problem) for problem in getattr(error, "problems", ())]
        answer["failure"] = Failure(ErrorPayload.of(error), problems)
    except MemoryError:
        sys.exit("out of memory")
    (desk / "answer.json").write_bytes(msgspec.json.encode(answer))


def _called(target: str, arguments: dict[str, object], desk: Path) -> object:
    module, _, name = target.partition(":")

    def progress(done: int, total: int) -> None:
        half = desk / "progress.half"
        half.write_text(f"{done} {total}")
        half.replace(desk / "progress")

    return getattr(importlib.import_module(module), name)(progress, **arguments)


def _leave_network() -> str:
    """Move into an empty network of its own; `none`, or why that was not possible.

    An ordinary user may do that inside a user namespace of its own, where the system allows one.
    """
    if not sys.platform.startswith("linux"):
        return f"not cut off: {sys.platform} has no network namespaces"
    user, group = os.getuid(), os.getgid()
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.unshare(_CLONE_NEWUSER | _CLONE_NEWNET) != 0:
        return f"not cut off: {os.strerror(ctypes.get_errno())}"
    # Files it writes are to be the user's.
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
        # Who does not end at the first signal of spent time ends at the second.
        last = most + 5 if what == resource.RLIMIT_CPU and hard == resource.RLIM_INFINITY else most
        resource.setrlimit(what, (most, last))


if __name__ == "__main__":
    main(sys.argv[1:])
