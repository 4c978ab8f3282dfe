"""`check`: inspect a submission in a sandbox, since a network may run forever or use all memory."""

from pathlib import Path

from crowdbench.leaderboard.sandbox.parent import Limits, Progress, call
from crowdbench.leaderboard.submission.submission import Submission, read_submission

LIMITS = Limits(memory_bytes=6 * 2**30, wall_s=600.0, cpu_s=600)
"""Reading thirty rollouts of Grand Central takes a minute."""


def check(submission: Path, limits: Limits = LIMITS) -> Submission:
    """Check an untrusted folder in a sandbox, and return what it contains.

    Raises:
        SubmissionError: the submission is invalid; the error lists all its problems.
        SandboxError: the check crashed or exceeded a limit.
    """
    return call(
        "crowdbench.leaderboard.verification.check:read",
        {"submission": str(submission)},
        Submission,
        where=submission,
        limits=limits,
    )[0]


def read(progress: Progress, submission: str) -> Submission:
    """Read a submission; `check` calls this in the sandbox."""
    return read_submission(Path(submission))
