"""`make attack`: what a hostile submission, file, number or machine can do, tried again (minutes).

    python tests/attack.py

runs the tests of each kind of attack and prints how many were tried, how many were held, and which
were not. It exits with 1 if one was not. Attacks for which a part is missing (bubblewrap, Ray) are
said not to have been tried.
"""

import sys
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass, field
from io import StringIO
from pathlib import Path

import pytest

HERE = Path(__file__).parent
KINDS: dict[str, Sequence[str]] = {
    "networks that mix rows, never answer, or crash": (
        "policies/test_rows.py", "policies/test_onnx_runtime.py", "policies/test_network.py",
    ),
    "submissions: 500 spoilt ones, archives, names, declarations": (
        "leaderboard/test_submission_fuzz.py", "leaderboard/test_submission.py",
        "leaderboard/test_submit.py",
    ),
    "in the sandbox: files, network, forks, memory, time": ("leaderboard/test_sandbox.py",),
    "forged answers and entries": ("leaderboard/test_verification.py",),
    "copies of the recording": ("leaderboard/test_path_copies.py", "leaderboard/test_flags.py"),
    "files: flipped bits, pipes, devices, links, full disks": (
        "test_files.py", "data/test_storage.py", "test_full_disk.py",
    ),
    "numbers: huge, negative, not finite": ("cli/test_hostile_numbers.py",),
    "arguments of wrong types, of the whole Python interface": ("test_arguments.py",),
    "a node that dies": ("run/test_ray_executor.py",),
}  # fmt: skip
"""The tests of each kind of attack."""
KILLS = 100
"""Number of evaluations and verifications that are killed at random moments."""


@dataclass
class Tried:
    """The outcomes of one kind of attack."""

    held: int = 0
    missing: int = 0
    broken: list[str] = field(default_factory=list)


class Counting:
    """A plugin that counts outcomes."""

    def __init__(self) -> None:
        self.found = Tried()

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """A test counts once: where it failed, or where it was called."""
        if report.failed:
            self.found.broken.append(report.nodeid)
        elif report.skipped:
            self.found.missing += 1
        elif report.when == "call":
            self.found.held += 1


def killed() -> Tried:
    """Kill runs, and look for what they leave behind; a fault is printed."""
    if sys.platform != "linux":  # processes are looked up in /proc
        return Tried(missing=KILLS)
    import kill_runs  # after the tests: pytest has to load what it checks itself

    with redirect_stdout(StringIO()) as said:
        faults = kill_runs.run(kills=KILLS, seeds=2, seed=0)
    if faults:
        print(said.getvalue())
    return Tried(held=KILLS - faults, broken=["tests/kill_runs.py"] * faults)


def main() -> int:
    """Run all attacks, and print the table; 1 if one was not held."""
    lines = [("attack", "tried", "held", "not held", "not tried")]
    broken: list[str] = []

    def add(kind: str, found: Tried) -> None:
        broken.extend(found.broken)
        tried = found.held + len(found.broken)
        lines.append((kind, *map(str, (tried, found.held, len(found.broken), found.missing))))

    for kind, files in KINDS.items():
        counting = Counting()
        paths = [str(HERE / name) for name in files]
        asked = ["-q", "-q", "-m", "not slow", "-p", "no:cacheprovider", "--no-header", *paths]
        code = pytest.main(asked, plugins=[counting])
        found = counting.found
        if code not in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED):
            found.broken.append(f"{kind}: {pytest.ExitCode(code).name}")
        add(kind, found)
    add("evaluations and verifications that are killed", killed())
    print()
    widths = [max(len(line[k]) for line in lines) for k in range(len(lines[0]))]
    for line in lines:
        first, *rest = (cell.ljust(w) if k == 0 else cell.rjust(w)
                        for k, (cell, w) in enumerate(zip(line, widths, strict=True)))  # fmt: skip
        print("  ".join((first, *rest)))
    for name in broken:
        print(f"not held: {name}")
    return 1 if broken else 0


if __name__ == "__main__":
    sys.exit(main())
