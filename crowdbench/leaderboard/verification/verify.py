"""Verification: from an untrusted submission to an entry.

The work is done in a child process with limits, and its answer is validated.
"""

import platform
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from types import MappingProxyType

import numpy as np

from crowdbench import __version__
from crowdbench.errors import WeightsError
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox.parent import Limits, ResourceUsage, SandboxError, call
from crowdbench.leaderboard.verification.check import check_unused
from crowdbench.leaderboard.verification.entry import Entry, entry_path, entry_paths, read_entry
from crowdbench.leaderboard.verification.soundness import check_entry

DEFAULT = Limits()


def verify(
    submission: Path,
    out: Path,
    *,
    workers: int | None = None,
    limits: Limits = DEFAULT,
    progress: Callable[[int, int], None] = lambda done, total: None,
    taken: Collection[str] = (),
) -> tuple[Entry, ResourceUsage]:
    """Roll out and score a submission; write `ID.json.gz` and `ID.run.json` into `out`.

    The same submission gives the same bytes in `ID.json.gz`; time, memory and machine are in
    `ID.run.json`. Rollouts stay in `out/work/ID`, so that an interrupted verification can be
    continued. `taken` are the ids of other submissions.

    Returns:
        The entry, and the resources that the child process used.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
        OutputError: `out` cannot be written.
        SandboxError: the child process crashed or exceeded a limit.
        CrowdbenchError: the id is taken, `out` contains an entry with that id by other authors, or
            something it needs, such as a recording, is missing.
    """
    owners = owners_of(out) | {name: [] for name in taken}
    entry, ran = entry_of(submission, out / "work", workers, limits, progress, owners)
    # The child has checked this before the first rollout, but its answer is not trusted.
    check_unused(submission, entry.id, entry.declared.authors, owners)
    write_json(entry_path(out, entry.id), entry)
    write_run(out / f"{entry.id}.run.json", ran)
    return entry, ran


def owners_of(out: Path) -> dict[str, list[str]]:
    """Authors of the entries in a folder, by id; a broken entry has none and may be overwritten."""
    found = {}
    for path in entry_paths(out).values():
        with suppress(WeightsError):
            entry = read_entry(path)
            found[entry.id] = list(entry.declared.authors)
    return found


def entry_of(
    submission: Path,
    work: Path,
    workers: int | None,
    limits: Limits,
    progress: Callable[[int, int], None],
    owners: Mapping[str, Sequence[str]] = MappingProxyType({}),
) -> tuple[Entry, ResourceUsage]:
    """Verify a submission in a child process; return its entry and the resources used.

    `owners` are the authors of other entries by id, see `check_unused`.
    """
    asked: dict[str, object] = {
        "submission": str(submission.resolve()),
        "work": str(work.resolve()),
        "workers": workers,
        "owners": dict(owners),
    }
    entry, ran = call(
        "crowdbench.leaderboard.verification.judge:make_entry",
        asked,
        Entry,
        where=submission,
        limits=limits,
        progress=progress,
    )
    try:
        check_entry(entry, submission)  # before its id becomes the name of a file
    except WeightsError as error:
        raise SandboxError(
            submission, got=f"an entry with {error.got}", expected=error.expected
        ) from error
    return entry, ran


def write_run(path: Path, ran: ResourceUsage) -> None:
    """Write `ID.run.json`: what depends on the machine and the date."""
    versions = {
        "crowdbench": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.platform(),
    }
    write_json(path, asdict(ran) | versions)
