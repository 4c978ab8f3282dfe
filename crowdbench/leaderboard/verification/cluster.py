"""Verification of several submissions at once, on the engine of `run.executor`.

Each submission is one task: it is rolled out and scored by one process, in a sandbox as elsewhere.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path

from crowdbench.errors import CrowdbenchError, OutputError
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox.parent import Limits, ResourceUsage
from crowdbench.leaderboard.verification.check import check_unused
from crowdbench.leaderboard.verification.entry import Entry, entry_path
from crowdbench.leaderboard.verification.verify import DEFAULT, entry_of, owners_of, write_run
from crowdbench.run.executor import call_each, checked_workers

Verified = tuple[Entry, ResourceUsage]


def verify_each(
    submissions: Sequence[Path],
    out: Path,
    *,
    workers: int | None = None,
    limits: Limits = DEFAULT,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Iterator[tuple[Path, Verified | CrowdbenchError]]:
    """Verify submissions like `verify`; yield each with its entry, or with what is wrong with it.

    `workers` is the number of submissions at a time. Rollouts are not kept.

    Raises:
        OutputError: a submission or `out` cannot be read or written.
        WorkerError: a process of the cluster died.
    """
    owners, made = owners_of(out), set[str]()
    tasks = [(path.name, _files(path), limits, owners) for path in submissions]
    progress(0, len(tasks))
    found = call_each(_verified, tasks, checked_workers(workers), name=lambda name, *rest: name)
    for done, (k, verified) in enumerate(found, 1):
        if not isinstance(verified, CrowdbenchError):
            entry, ran = verified
            try:
                known = owners | {name: [] for name in made}
                check_unused(submissions[k], entry.id, entry.declared.authors, known)
            except CrowdbenchError as error:
                verified = error
            else:
                made.add(entry.id)
                write_json(entry_path(out, entry.id), entry)
                write_run(out / f"{entry.id}.run.json", ran)
        progress(done, len(tasks))
        yield submissions[k], verified


def _verified(
    name: str, files: Mapping[str, bytes], limits: Limits, owners: Mapping[str, Sequence[str]]
) -> Verified | CrowdbenchError:
    with tempfile.TemporaryDirectory(prefix="crowdbench-verify-") as folder:
        submission = Path(folder) / "submission" / name
        for path, data in files.items():
            (submission / path).parent.mkdir(parents=True, exist_ok=True)
            (submission / path).write_bytes(data)
        try:
            return entry_of(
                submission, Path(folder) / "work", 1, limits, lambda done, total: None, owners
            )
        except CrowdbenchError as error:
            return error


def _files(submission: Path) -> dict[str, bytes]:
    """The files of a submission by their paths, without looking at what is in them.

    Raises:
        OutputError: it cannot be read.
    """
    if not submission.is_dir():
        raise OutputError(submission, got="no such folder", expected="a submission's folder")
    try:
        return {
            path.relative_to(submission).as_posix(): path.read_bytes()
            for path in sorted(submission.rglob("*"))
            if path.is_file() and not path.is_symlink()
        }
    except OSError as error:
        raise OutputError(
            submission, got=error.strerror or str(error), expected="a readable folder"
        ) from error
