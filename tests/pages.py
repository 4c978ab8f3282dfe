"""The code and the commands that pages of documentation show."""

import re


def blocks(page: str, language: str) -> list[str]:
    """All blocks of a language, in the order of the page."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)


def commands(page: str) -> list[str]:
    """All commands of crowdbench in shell blocks, without comments, in the order of the page."""
    lines = "\n".join(blocks(page, "sh")).splitlines()
    return [line.split("#")[0].strip() for line in lines if line.startswith("crowdbench")]
