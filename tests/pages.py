"""The code and the commands that pages of documentation show."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[1]
WITHIN = 0.02
"""Tolerance of scores, distances and other numbers with decimals: another processor rounds
otherwise, and what people do goes on from what it rounded."""
SHARE = 0.005
"""The same for large ones, as a share of the number."""
_NUMBER = re.compile(r"(?<![\w.])[-−]?\d+(?:\.\d+)?(?![\w])")


PROGRAMS = ("crowdbench ", "python -m studies ")


def blocks(page: str, language: str) -> list[str]:
    """All blocks of a language, in the order of the page."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


def block_with(page: str, words: str) -> str:
    """The only Python block of the page that has these words in it."""
    (found,) = (block for block in blocks(page, "python") if words in block)
    return found


def differences(shown: str, printed: str) -> list[str]:
    """What a page shows and its commands do not print.

    Spaces do not count. Integers, which count people, must be equal, other numbers within `WITHIN`
    or `SHARE`. A number with a unit of time or speed of the machine has no place in such a block.
    """
    lines = [_parts(line) for line in printed.splitlines()]
    found, at = [], 0
    for line in filter(str.strip, shown.splitlines()):
        words, numbers = _parts(line)
        there = [k for k in range(at, len(lines)) if lines[k][0] == words]
        near = [k for k in there if all(map(_close, numbers, lines[k][1]))]
        if near:
            at = near[0] + 1
        else:
            found.append(f"shown: {line.strip()}; printed: {[lines[k][1] for k in there[:3]]}")
    return found


def _parts(line: str) -> tuple[str, list[str]]:
    """A line without numbers and spaces, and its numbers."""
    plain = re.sub(r"[─━]+", "", line)
    return "".join(_NUMBER.sub("#", plain).split()), _NUMBER.findall(plain.replace("−", "-"))


def _close(shown: str, printed: str) -> bool:
    if "." not in shown + printed:
        return shown == printed
    return abs(float(shown) - float(printed)) <= max(WITHIN, SHARE * abs(float(printed))) + 1e-9


def commands(page: str) -> list[str]:
    """All lines of shell that call crowdbench or a study, in the order of the page."""
    lines = "\n".join(blocks(page, "sh")).splitlines()
    return [line.split("#")[0].strip() for line in lines if line.startswith(PROGRAMS)]


def arguments(page: str, program: str, *, small: bool = True) -> list[str]:
    """Of the page's only line that begins with `program`; `small` puts the plaza, which needs no
    recording and is walked in seconds, in the place of its scenes."""
    lines = "\n".join(blocks((ROOT / page).read_text(), "sh")).splitlines()
    (line,) = (line for line in lines if f"{line.split('#')[0].strip()} ".startswith(f"{program} "))
    given = shlex.split(line.split("#")[0].strip().removeprefix(program))
    if not small:
        return given
    scenes = [word for word in given if word.endswith("-v0")]
    assert scenes
    return ["plaza-v0" if word == scenes[0] else word for word in given if word not in scenes[1:]]
