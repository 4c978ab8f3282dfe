"""`check`: inspect a submission in a sandbox, since a network may run forever or use all memory."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import msgspec

from crowdbench.errors import OutputError
from crowdbench.leaderboard.sandbox.parent import Limits, call
from crowdbench.leaderboard.submission.errors import plain
from crowdbench.leaderboard.submission.schema import Declared
from crowdbench.leaderboard.submission.submission import open_submission
from crowdbench.leaderboard.verification.entry import Status

LIMITS = Limits(memory_bytes=6 * 2**30, wall_s=600.0, cpu_s=600)
"""Reading thirty rollouts of Grand Central takes a minute."""


class Checked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A description of a valid submission."""

    id: str
    status: Status
    why: str
    """The reason for its status, as a clause."""
    declared: Declared
    artefacts: dict[str, str]
    """SHA-256 of each file, by its path in the submission or, for shipped models, in crowdbench."""
    networks: int
    fits: int
    rollouts: int


def check(submission: Path, limits: Limits = LIMITS) -> Checked:
    """Check an untrusted folder in a sandbox, and return its description.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
        SandboxError: the check crashed or exceeded a limit.
    """
    return call(
        "crowdbench.leaderboard.verification.check:opened",
        {"submission": str(submission)},
        Checked,
        where=submission,
        limits=limits,
    )[0]


def opened(progress: Callable[[int, int], None], submission: str) -> Checked:
    """Return the description of a submission; `check` calls this in the sandbox."""
    with open_submission(Path(submission)) as given:
        return Checked(
            id=given.id,
            status=given.status,
            why=given.why,
            declared=given.declared,
            artefacts=given.artefacts | given.shipped,
            networks=len(given.layout.networks),
            fits=len(given.layout.weights),
            rollouts=sum(map(len, given.layout.crowds.values())),
        )


def check_unused(
    submission: object, name: str, authors: Sequence[str], owners: Mapping[str, Sequence[str]]
) -> None:
    """Check that an entry would not overwrite that of another submission.

    `owners` are the authors of other entries by id.

    Raises:
        OutputError: the id belongs to an entry of other authors.
    """
    owner = owners.get(name, authors)
    if list(owner) != list(authors):
        by = f" by {plain(', '.join(owner))}" if owner else ""
        raise OutputError(
            submission,
            got=f"the id {name} of another submission{by}",
            expected="an unused id",
            hint="The id is made from the name: choose another name or another output folder.",
        )
