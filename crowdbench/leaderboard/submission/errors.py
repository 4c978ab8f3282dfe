"""Errors of submissions: all problems at once, each with where, got, expected and hint."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from crowdbench.errors import CrowdbenchError
from crowdbench.leaderboard.submission.limits import MOST_SHOWN

_LONGEST = 400  # characters in each part of a message


class RefusedError(CrowdbenchError):
    """One problem for which a submission is rejected."""


class SubmissionError(CrowdbenchError):
    """The rejection of a submission, with all its problems."""

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


class Problems(list[CrowdbenchError]):
    """The problems of a submission, in the order in which they are found."""

    def refuse(self, where: str, *, got: str, expected: str, hint: str = "") -> None:
        """Append a `RefusedError` with these parts."""
        self.append(RefusedError(where, got=got, expected=expected, hint=hint))

    @contextmanager
    def collected(self, folder: Path) -> Iterator[None]:
        """Append a `CrowdbenchError` raised in the block, with paths inside `folder`."""
        try:
            yield
        except CrowdbenchError as error:
            where, got = (text.replace(f"{folder}/", "") for text in (error.where, error.got))
            self.append(type(error)(where, got=got, expected=error.expected, hint=error.hint))


def tidy(problem: CrowdbenchError) -> CrowdbenchError:
    """Return the same error with printable characters only, since it may quote a submitter's text.

    Each part is cut to `_LONGEST` characters.
    """
    parts = (problem.where, problem.got, problem.expected, problem.hint)
    where, got, expected, hint = (plain(part) for part in parts)
    return type(problem)(where, got=got, expected=expected, hint=hint)


def plain(text: str, longest: int = _LONGEST) -> str:
    """Return the text, cut to `longest` characters, with unprintable characters replaced by �."""
    cut = text if len(text) <= longest else text[: longest - 1] + "…"
    return "".join(c if c.isprintable() else "�" for c in cut)
