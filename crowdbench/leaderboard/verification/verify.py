"""Verification: from untrusted submissions to entries.

The work is done in child processes with limits, and their answers are validated.
"""

import os
import platform
import secrets
import tempfile
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType

import numpy as np

from crowdbench import __version__
from crowdbench.errors import CrowdbenchError, OutputError, WeightsError
from crowdbench.files import write_json, write_text
from crowdbench.leaderboard.sandbox import isolation
from crowdbench.leaderboard.sandbox.parent import Limits, ResourceUsage, SandboxError, call
from crowdbench.leaderboard.verification.entry import Entry, check_unused, entry_path, owners_of
from crowdbench.leaderboard.verification.soundness import check_entry
from crowdbench.progress import tell
from crowdbench.run.executor import call_each, checked_workers

DEFAULT = Limits()
Verified = tuple[Entry, ResourceUsage]


def verify(
    submission: Path,
    out: Path,
    *,
    workers: int | None = None,
    limits: Limits = DEFAULT,
    taken: Collection[str] = (),
    exam: bool = False,
    replace: bool = False,
    key: str = "",
) -> Verified:
    """Roll out and score a submission; write `ID.json.gz` and `ID.run.json` into `out`.

    Policies are ranked under perturbed arrivals, whose key is drawn now and written into the entry,
    or is `key`, to verify an entry again. The same submission and key give the same bytes in
    `ID.json.gz`; time, memory and machine are in `ID.run.json`. Rollouts stay in `out/work/ID`, so
    that an interrupted verification can be continued. `taken` are the ids of other submissions.
    With `exam`, the policy is examined. With `replace`, an entry with that id by the same authors
    is overwritten.

    Returns:
        The entry, and the resources that the child process used.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
        OutputError: `out` cannot be written.
        SandboxError: the child process crashed or exceeded a limit.
        CrowdbenchError: the id is taken, `out` contains an entry with that id, or something it
            needs, such as a recording, is missing.
    """
    owners = owners_of(out) | {name: [] for name in taken}
    verified = entry_of(
        submission, out / "work", workers, limits, owners, exam=exam, replace=replace, key=key
    )
    _write(submission, out, verified, owners, replace=replace)
    return verified


def verify_each(
    submissions: Sequence[Path],
    out: Path,
    *,
    workers: int | None = None,
    limits: Limits = DEFAULT,
    exam: bool = False,
    replace: bool = False,
) -> Iterator[tuple[Path, Verified | CrowdbenchError]]:
    """Verify submissions on the engine of `run.executor`, each by one process and in a sandbox.

    `workers` is the number of submissions at a time. Rollouts are not kept. With `replace`, entries
    of the same authors are overwritten.

    Yields:
        Each submission with its entry and resources, or with what is wrong with it.

    Raises:
        OutputError: a submission or `out` cannot be read or written.
        WorkerError: a process of the cluster died.
    """
    owners = owners_of(out)
    settings = (limits, dict(owners), exam, replace)
    tasks = [(path.name, _files(path), *settings) for path in submissions]
    tell("submissions", 0, len(tasks))
    found = call_each(_verified, tasks, checked_workers(workers), name=lambda name, *rest: name)
    for done, (k, verified) in enumerate(found, 1):
        if not isinstance(verified, CrowdbenchError):
            try:
                _write(submissions[k], out, verified, owners, replace=replace)
                owners[verified[0].id] = []
            except CrowdbenchError as error:
                verified = error
        tell("submissions", done, len(tasks))
        yield submissions[k], verified


def _verified(
    name: str,
    files: Mapping[str, bytes],
    limits: Limits,
    owners: Mapping[str, Sequence[str]],
    exam: bool,
    replace: bool,
) -> Verified | CrowdbenchError:
    with tempfile.TemporaryDirectory(prefix="crowdbench-verify-") as folder:
        submission = Path(folder) / "submission" / name
        for path, data in files.items():
            (submission / path).parent.mkdir(parents=True, exist_ok=True)
            (submission / path).write_bytes(data)
        try:
            work = Path(folder) / "work"
            return entry_of(submission, work, 1, limits, owners, exam=exam, replace=replace)
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


def entry_of(
    submission: Path,
    work: Path,
    workers: int | None,
    limits: Limits,
    owners: Mapping[str, Sequence[str]] = MappingProxyType({}),
    *,
    exam: bool = False,
    replace: bool = False,
    key: str = "",
) -> Verified:
    """Verify a submission in a child process; return its entry and the resources used.

    `owners` are the authors of other entries by id, see `check_unused` for them and `replace`. With
    `exam`, its policy is put through the exam. `key` is that of perturbed arrivals, by default a
    secret one.
    """
    _refuse_root(submission)
    entry, ran = call(
        "crowdbench.leaderboard.verification.make_entry:make_entry",
        {
            "submission": str(submission.resolve()),
            "work": str(work.resolve()),
            "workers": workers,
            "owners": dict(owners),
            "examine": exam,
            "replace_entry": replace,
            "key": key or _key_in(work, submission.name),
        },
        Entry,
        where=submission,
        limits=limits,
        reads=[submission],
        writes=[work],
    )
    try:
        check_entry(entry, submission)
    except WeightsError as error:
        raise SandboxError(
            submission, got=f"an entry with {error.got}", expected=error.expected
        ) from error
    return entry, ran


def _refuse_root(submission: Path) -> None:
    """Refuse to run what strangers sent as root without isolation: it could change anything."""
    if os.name != "posix" or os.geteuid() != 0 or not (why := isolation.lacking()):
        return
    if os.environ.get(isolation.AS_ROOT) != "1":
        raise SandboxError(
            submission,
            got=f"the user root, without isolation ({why})",
            expected="another user, or bubblewrap",
            hint="Install bubblewrap, or run as another user. In a container that holds nothing "
            f"else, set {isolation.AS_ROOT}=1.",
        )


def _key_file(work: Path, submission: str) -> Path:
    return work / f"{submission}.key"


def _key_in(work: Path, submission: str) -> str:
    """The key of perturbed arrivals: an interrupted verification goes on with its own."""
    path = _key_file(work, submission)
    if not path.is_file():
        write_text(path, secrets.token_hex(16))
    return path.read_text().strip()


def _write(
    submission: Path,
    out: Path,
    verified: Verified,
    owners: Mapping[str, Sequence[str]],
    *,
    replace: bool,
) -> None:
    """Write an entry. The child has checked its id before the first rollout, but is not trusted."""
    entry, ran = verified
    check_unused(submission, entry.id, entry.declared.authors, owners, replace=replace)
    write_json(entry_path(out, entry.id), entry)
    write_run(out / f"{entry.id}.run.json", ran)
    # The key is in the entry now: a submission that is changed is judged with another one.
    _key_file(out / "work", submission.name).unlink(missing_ok=True)


def write_run(path: Path, ran: ResourceUsage) -> None:
    """Write `ID.run.json`: what depends on the machine and the date."""
    versions = {
        "crowdbench": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.platform(),
    }
    write_json(path, asdict(ran) | versions)
