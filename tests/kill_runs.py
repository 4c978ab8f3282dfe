"""Kill evaluations and verifications at random moments, and look for what they leave behind.

    python tests/kill_runs.py --kills 30

Each run is killed by SIGTERM or SIGKILL, the main process alone; 2 s later there must be no
process and no file in shared memory of it. Every run takes up what the killed ones before it made;
what the last ones end with must be the same bytes as an undisturbed run's, and no temporary file.
One line for each kill; exits with 1 if anything was wrong. Needs Linux.
"""

import argparse
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from submissions import walk_submission

from crowdbench.registry import import_recording

MARK = "CROWDBENCH_KILLED_RUN"
GRACE_S = 2.0
SHARED = Path("/dev/shm")
CODES = {signal.SIGTERM: (143, -15), signal.SIGKILL: (-9,)}
"""While Python starts or shuts down, when nothing is open, SIGTERM ends it as it always does."""


@dataclass
class Case:
    """A command that is killed, and where its results go."""

    name: str
    command: list[str]
    results: tuple[str, ...]
    """Of the files that it writes, those that are the same each time."""

    def start(self, out: Path, temporary: Path, mark: str) -> "subprocess.Popen[bytes]":
        command = [sys.executable, "-m", "crowdbench", *self.command, "--out", str(out)]
        return subprocess.Popen(
            command,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            env=os.environ | {"TMPDIR": str(temporary), MARK: mark},
            start_new_session=True,
        )

    def found(self, out: Path) -> dict[str, bytes]:
        return {
            str(path.relative_to(out)): path.read_bytes()
            for pattern in self.results
            for path in sorted(out.glob(pattern))
        }


def cases(folder: Path, seeds: int) -> list[Case]:
    """An evaluation, and the verification of a submission with three networks."""
    submission = walk_submission(folder / "mine")
    # With keys of their own, verifications would differ. One that is killed after its entry is
    # written writes it again.
    same = ["--key", "0" * 32, "--replace"]
    asked = ["--spawn", "poisson-gmm", "--policy", "straight", "--workers", "2"]
    return [
        Case(
            "evaluate",
            ["evaluate", "plaza-v0", *asked, "--seeds", str(seeds)],
            ("scorecard.json", "report.html", "*.png", "rollouts/*.parquet"),
        ),
        Case(
            "verify",
            ["leaderboard", "verify", str(submission), "--workers", "2", *same],
            ("a-walker.json.gz", "work/a-walker/plaza-v0/*.parquet"),
        ),
    ]


def processes(mark: str) -> dict[int, str]:
    """Those that run, of those who were started with this mark, and their children."""
    wanted = f"{MARK}={mark}".encode()
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            if wanted in (folder / "environ").read_bytes().split(b"\0"):
                state = (folder / "stat").read_text().rpartition(")")[2].split()[0]
                command = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode()
                if state != "Z":
                    found[int(folder.name)] = command[:80]
        except (OSError, IndexError):  # it ended meanwhile, or is another user's
            continue
    return found


def temporaries(outs: list[Path], temporary: Path, known: set[str]) -> Iterator[str]:
    """Hidden files among the results, and what is in the folder of temporary files.

    `known` are names there that runs leave that nobody kills: onnxruntime has one.
    """
    yield from (str(path) for path in temporary.iterdir() if path.name not in known)
    yield from (str(path) for out in outs for path in out.rglob(".*"))


def shared(by: set[int]) -> Iterator[str]:
    """What is in shared memory with the id of one of these processes in its name."""
    for path in SHARED.iterdir() if SHARED.is_dir() else ():
        if {int(number) for number in re.findall("[0-9]+", path.name)} & by:
            yield str(path)


def kill(
    case: Case,
    out: Path,
    temporary: Path,
    mark: str,
    number: signal.Signals,
    after_s: float,
) -> tuple[bool, list[str]]:
    """Whether it was killed before it ended, and what was wrong."""
    process = case.start(out, temporary, mark)
    ever = {process.pid}
    try:
        process.wait(after_s)
    except subprocess.TimeoutExpired:
        ever |= processes(mark).keys()
        os.kill(process.pid, number)
    time.sleep(GRACE_S)
    wrong = [f"process {pid}: {told}" for pid, told in processes(mark).items()]
    wrong += [f"left: {name}" for name in shared(ever)]
    if process.poll() is None:
        process.kill()
    said = process.communicate()[1].decode()
    killed = process.returncode in CODES[number]
    if not killed and process.returncode != 0:
        wrong.append(f"exit code {process.returncode}: {said.strip()[-300:]}")
    if number == signal.SIGTERM and "Traceback" in said:
        wrong.append(f"a traceback: {said.strip()[-300:]}")
    return killed, wrong


def whole(case: Case, out: Path, temporary: Path) -> tuple[dict[str, bytes], float]:
    """What a run makes that nobody kills, and how long it takes."""
    began = time.monotonic()
    process = case.start(out, temporary, "whole")
    said = process.communicate()[1].decode()
    if process.returncode:
        raise SystemExit(f"{case.name}: {said}")
    return case.found(out), time.monotonic() - began


def run(kills: int, seeds: int, seed: int) -> int:
    """Kill so many times; the number of faults."""
    rng = np.random.default_rng(seed)
    faults = late = 0
    with tempfile.TemporaryDirectory(prefix="crowdbench-kills-") as name:
        folder = Path(name)
        os.environ["CROWDBENCH_HOME"] = str(folder / "home")
        import_recording("plaza")
        temporary = folder / "tmp"
        temporary.mkdir()
        every = cases(folder, seeds)
        expected = {case.name: whole(case, folder / case.name, temporary) for case in every}
        for name, (_, took_s) in expected.items():
            print(f"     {name:8}  takes {took_s:.1f} s undisturbed", flush=True)
        known = {path.name for path in temporary.iterdir()}
        round_of = dict.fromkeys(expected, 0)
        for k in range(kills):
            case = every[k % 2]
            number = (signal.SIGTERM, signal.SIGKILL)[k // 2 % 2]
            after_s = float(rng.uniform(0.05, 1.0) * expected[case.name][1])
            out = folder / f"{case.name}-{round_of[case.name]}"
            killed, wrong = kill(case, out, temporary, f"{k}", number, after_s)
            if not killed and not wrong:  # it had ended: what it made is looked at, then made anew
                late += 1
                wrong += differing(case, out, expected[case.name][0])
                round_of[case.name] += 1
            faults += bool(wrong)
            result = "; ".join(wrong) or ("nothing is left" if killed else "had ended before")
            print(
                f"{k + 1:3d}  {case.name:8}  {number.name}  {after_s:5.1f} s  {result}", flush=True
            )
        for case in every:
            out = folder / f"{case.name}-{round_of[case.name]}"
            whole(case, out, temporary)
            wrong = differing(case, out, expected[case.name][0])
            faults += bool(wrong)
            print(f"     {case.name:8}  resumed: {'; '.join(wrong) or 'the same bytes'}")
        outs = [folder / f"{case.name}-{round_of[case.name]}" for case in every]
        left = list(temporaries(outs, temporary, known))
        faults += bool(left)
        print(f"     after the next starts: {'; '.join(left) or 'nothing is left'}")
    print(f"{kills} kills, {late} of them too late, {faults} faults")
    return faults


def differing(case: Case, out: Path, expected: dict[str, bytes]) -> list[str]:
    found = case.found(out)
    names = sorted(found.keys() | expected.keys())
    return [f"{name} differs" for name in names if found.get(name) != expected.get(name)]


def main() -> None:
    """Parse, kill, exit."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--kills", type=int, default=30)
    parser.add_argument("--seeds", type=int, default=4, help="rollouts of each pair")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    asked = parser.parse_args()
    sys.exit(1 if run(asked.kills, asked.seeds, asked.seed) else 0)


if __name__ == "__main__":
    main()
