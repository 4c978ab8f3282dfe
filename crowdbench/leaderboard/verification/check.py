"""`check`: what a submission is, found in a sandbox: a network may never end, or eat all memory."""

from collections.abc import Callable
from pathlib import Path

import msgspec

from crowdbench.leaderboard.sandbox.parent import Limits, call
from crowdbench.leaderboard.submission.schema import Declared
from crowdbench.leaderboard.submission.submission import open_submission
from crowdbench.leaderboard.verification.entry import Status

LIMITS = Limits(memory_bytes=6 * 2**30, wall_s=600.0, cpu_s=600)
"""Thirty rollouts of Grand Central as tables take a minute."""


class Checked(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """A submission in which nothing is wrong."""

    id: str
    status: Status
    why: str
    """Why it has that status, in half a sentence."""
    declared: Declared
    artefacts: dict[str, str]
    """SHA-256 by path in the submission and, of shipped models, in crowdbench."""
    networks: int
    fits: int
    rollouts: int


def check(submission: Path, limits: Limits = LIMITS) -> Checked:
    """What a folder or zip is that is not trusted.

    Raises:
        SubmissionError: something is wrong with it; the error tells everything.
        SandboxError: it hung, crashed or used more than the limits allow.
    """
    return call(
        "crowdbench.leaderboard.verification.check:opened",
        {"submission": str(submission)},
        Checked,
        where=submission,
        limits=limits,
    )[0]


def opened(progress: Callable[[int, int], None], submission: str) -> Checked:
    """What `check` does in the sandbox."""
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
