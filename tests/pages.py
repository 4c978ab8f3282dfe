"""The code and the commands that pages of documentation show."""

import re
import shlex
from pathlib import Path

ROOT = Path(__file__).parents[1]


def blocks(page: str, language: str) -> list[str]:
    """All blocks of a language, in the order of the page."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


def block_with(page: str, words: str) -> str:
    """The only Python block of the page that has these words in it."""
    (found,) = (block for block in blocks(page, "python") if words in block)
    return found


def commands(page: str) -> list[str]:
    """All lines of shell that call crowdbench, in the order of the page."""
    lines = "\n".join(blocks(page, "sh")).splitlines()
    return [line.split("#")[0].strip() for line in lines if line.startswith("crowdbench")]


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
