"""Verification: from a submission, which is not trusted, to a signed-off entry.

The work is done in a child process with limits; what it answers is read strictly.
"""

import platform
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path

import numpy as np

from crowdbench import __version__
from crowdbench.errors import OutputError, WeightsError
from crowdbench.files import write_json
from crowdbench.leaderboard.sandbox.parent import Limits, ResourceUsage, SandboxError, call
from crowdbench.leaderboard.submission.errors import plain
from crowdbench.leaderboard.verification.check import Checked, check
from crowdbench.leaderboard.verification.entry import Entry, read_entry
from crowdbench.leaderboard.verification.soundness import check_entry
from crowdbench.leftovers import swept

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
    """Roll out and score a submission; write `ID.json` and `ID.run.json` into `out`.

    The same submission gives the same bytes in `ID.json`; time, memory and machine stand in the
    other. Rollouts stay in `out/work/ID`, where a verification that was stopped goes on. `taken`
    are ids that it must not have, since other submissions have them.

    Raises:
        SubmissionError: something is wrong with it; the error tells everything.
        OutputError: its id is taken, or `out` holds an entry of that id by other authors, or
            cannot be written.
        SandboxError: it hung, crashed or used more than the limits allow.
        CrowdbenchError: what it needs is not at hand.
    """
    with swept():
        known = check(submission)
        _check_free(submission, known, out, taken)
        entry, ran = entry_of(submission, out / "work", workers, limits, progress)
        if entry.id != known.id:
            raise SandboxError(
                submission, got=f"an answer of the id {entry.id}", expected=f"its own, {known.id}"
            )
        write_json(out / f"{entry.id}.json", entry)
        write_run(out / f"{entry.id}.run.json", ran)
    return entry, ran


def _check_free(submission: Path, known: Checked, out: Path, taken: Collection[str]) -> None:
    """Raise before hours of rollouts where an entry of another submission would be overwritten."""
    old = out / f"{known.id}.json"
    authors = known.declared.authors
    with suppress(WeightsError):  # what is no entry is nobody's
        if old.exists():
            authors = read_entry(old).declared.authors
    if known.id in taken or authors != known.declared.authors:
        by = f", of {plain(', '.join(authors))}," * (authors != known.declared.authors)
        raise OutputError(
            submission,
            got=f"the id {known.id}, which another submission{by} has",
            expected="an id of its own",
            hint="Ids are made of names: choose another name, or verify it into another folder.",
        )


def entry_of(
    submission: Path,
    work: Path,
    workers: int | None,
    limits: Limits,
    progress: Callable[[int, int], None],
) -> tuple[Entry, ResourceUsage]:
    """What verification finds, and how the child ran."""
    asked: dict[str, object] = {
        "submission": str(submission.resolve()),
        "work": str(work.resolve()),
        "workers": workers,
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
        check_entry(entry, submission)  # its id becomes the name of a file
    except WeightsError as error:
        raise SandboxError(
            submission, got=f"an answer with {error.got}", expected=error.expected
        ) from error
    return entry, ran


def write_run(path: Path, ran: ResourceUsage) -> None:
    """Write what depends on the machine and the day."""
    versions = {
        "crowdbench": __version__,
        "python": platform.python_version(),
        "numpy": np.__version__,
        "machine": platform.platform(),
    }
    write_json(path, asdict(ran) | versions)
