"""What is wrong with a submission: everything at once, each with where, got, expected and hint."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.submission.limits import MOST_SHOWN

_LONGEST = 400  # characters of a part of a message


class RefusedError(CrowdbenchError):
    """One thing for which a submission is refused."""


class SubmissionError(CrowdbenchError):
    """A submission that is refused, with all that is wrong with it."""

    problems: tuple[CrowdbenchError, ...]

    def __init__(self, where: object, problems: Sequence[CrowdbenchError]) -> None:
        self.problems = tuple(tidy(problem) for problem in problems)
        shown = [f"\n  {problem}" for problem in self.problems[:MOST_SHOWN]]
        if len(problems) > MOST_SHOWN:
            shown.append(f"\n  and {len(problems) - MOST_SHOWN} more.")
        number = f"{len(problems)} problem{'s' * (len(problems) != 1)}"
        super().__init__(where, got=number, expected="none", hint="".join(shown))

    def __str__(self) -> str:
        return f"{self.where}: {self.got}.{self.hint}"

    def __reduce__(self) -> tuple[object, ...]:
        return type(self), (self.where, self.problems)


def tidy(problem: CrowdbenchError) -> CrowdbenchError:
    """The same on one line that a terminal only shows: what was got may be a submitter's text."""
    parts = (problem.where, problem.got, problem.expected, problem.hint)
    where, got, expected, hint = (plain(part) for part in parts)
    return type(problem)(where, got=got, expected=expected, hint=hint)


def plain(text: str, longest: int = _LONGEST) -> str:
    """The text, what cannot be printed replaced by �, and cut where it is too long."""
    cut = text if len(text) <= longest else text[: longest - 1] + "…"
    return "".join(c if c.isprintable() else "�" for c in cut)


@contextmanager
def collecting(problems: list[CrowdbenchError], folder: Path) -> Iterator[None]:
    """Note an error that readers of files raise; its place is told as one in the folder."""
    try:
        yield
    except CrowdbenchError as error:
        where, got = (text.replace(f"{folder}/", "") for text in (error.where, error.got))
        problems.append(type(error)(where, got=got, expected=error.expected, hint=error.hint))
