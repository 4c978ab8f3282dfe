"""The code and the commands that pages of documentation show."""

import re


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
