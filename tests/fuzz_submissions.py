"""Thousands of spoilt submissions: each is refused clearly, or was harmless.

    python tests/fuzz_submissions.py --cases 10000

A case is a number: the same number spoils the same submission in the same way. Cases are opened in
a child process that may take 1 GiB, and is watched: 5 seconds a case, no file written but in the
folder for temporary ones, nothing left there, no other exception than a `CrowdbenchError`. Of time
that of the processor counts, so that a busy machine finds nothing else; the wall clock ends what
waits for ever.
"""

import argparse
import multiprocessing
import os
import random
import shutil
import sys
import tempfile
import time
import traceback
from collections import Counter
from multiprocessing.connection import Connection
from pathlib import Path

from spoiling import spoilt
from submissions import SHIPPED_FITS, listed_submission, spawn_submission, walk_submission

LIMIT_S = 5.0
LIMIT_BYTES = 2**30
_WAIT_S = 12 * LIMIT_S
_FIRST_S = 300.0  # what a child may take to import everything and open sound submissions


def sound_submissions(folder: Path) -> list[Path]:
    """Submissions of every kind in which nothing is wrong."""
    sound = [walk_submission(folder / "walk"), listed_submission(folder / "listed")]
    for file in SHIPPED_FITS:
        sound.append(spawn_submission(folder / file.partition(".")[0], file))
    return sound


def fuzz(cases: range, folder: Path) -> tuple[Counter[str], list[str]]:
    """Open each case; how often it was accepted or refused, and what went wrong."""
    sound = sound_submissions(folder / "sound")
    counts: Counter[str] = Counter()
    failures = []
    child = _Child(folder, sound)
    for case in cases:
        place = folder / "deep" / "case"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir(parents=True)
        rng = random.Random(case)
        path, how = spoilt(rng.choice(sound), place, rng)
        answer, told = child.ask(path)
        counts[answer] += 1
        if answer not in ("accepted", "refused"):
            failures.append(f"case {case} ({how}): {answer} {told}")
    child.end()
    return counts, failures


class _Child:
    """The process that opens submissions, started anew whenever it dies."""

    def __init__(self, folder: Path, sound: list[Path]) -> None:
        self.folder, self.sound = folder, sound
        self._start()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        arguments = (other, self.folder / "temporary", self.sound)
        self.process = context.Process(target=_work, args=arguments, daemon=True)
        self.process.start()
        other.close()
        assert self.pipe.poll(_FIRST_S)
        assert self.pipe.recv() == "ready"

    def ask(self, path: Path) -> tuple[str, str]:
        self.pipe.send(path)
        answer: tuple[str, str]
        if not self.pipe.poll(_WAIT_S):
            answer = "hung", f"for {_WAIT_S:g} s"
        else:
            try:
                answer = self.pipe.recv()
                return answer
            except EOFError:
                self.process.join()
                answer = "died", f"with {self.process.exitcode}"
        self.end()
        self._start()
        return answer

    def end(self) -> None:
        self.process.kill()
        self.process.join()
        self.pipe.close()


def _work(pipe: Connection, temporary: Path, sound: list[Path]) -> None:
    """Open what is sent, and tell how that ended."""
    from crowdbench.errors import CrowdbenchError
    from crowdbench.leaderboard.submission.submission import read_submission

    shutil.rmtree(temporary, ignore_errors=True)
    temporary.mkdir()
    tempfile.tempdir = str(temporary)
    for path in sound:  # what is loaded and compiled once is not the cases' doing
        read_submission(path)
    _limit()
    written = _watch(temporary)
    pipe.send("ready")
    while True:
        path = pipe.recv()
        written.clear()
        began = time.process_time()
        try:
            submission = read_submission(path)
            answer = "accepted", submission.id
        except CrowdbenchError as error:
            told = str(error)
            clear = " problem" in told and "expected" in told and len(told) < 50_000
            printable = all(line.isprintable() for line in told.split("\n"))
            answer = ("refused" if clear and printable else "unclear"), told
        except BaseException:
            answer = "raised", traceback.format_exc()
        if written or any(temporary.iterdir()):
            answer = "wrote", f"{written or list(temporary.iterdir())}"
        if time.process_time() - began > LIMIT_S:
            answer = "slow", answer[1]
        pipe.send(answer)


def _limit() -> None:
    """So much memory on top of what is in use, and no large files."""
    import resource

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    most = pages * resource.getpagesize() + LIMIT_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (most, most))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LIMIT_BYTES // 4, LIMIT_BYTES // 4))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _watch(temporary: Path) -> list[str]:
    """A list that fills with paths outside of `temporary` that are written."""
    written: list[str] = []
    writing = os.O_WRONLY | os.O_RDWR | os.O_CREAT
    changing = ("os.mkdir", "os.rename", "os.link", "os.symlink", "os.chmod", "os.remove")

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        opened = event == "open" and isinstance(arguments[2], int) and arguments[2] & writing
        if not (opened or event in changing or event.startswith(("subprocess", "socket"))):
            return
        path = os.path.realpath(str(arguments[0])) if arguments else ""
        within = path.startswith(f"{temporary.resolve()}{os.sep}") or path == os.devnull
        # What is removed by its folder's descriptor has a name alone.
        removed = event == "os.remove" and os.sep not in str(arguments[0])
        if not (within or removed):
            written.append(f"{event} {path}")

    sys.addaudithook(hook)
    return written


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="crowdbench-fuzz-") as folder:
        began = time.perf_counter()
        counts, failures = fuzz(range(asked.first, asked.first + asked.cases), Path(folder))
        seconds = time.perf_counter() - began
    for failure in failures[:50]:
        print(failure)
    told = ", ".join(f"{count} {answer}" for answer, count in sorted(counts.items()))
    print(f"{asked.cases} cases in {seconds:.0f} s: {told}")
    return bool(failures)


if __name__ == "__main__":
    sys.exit(main())
