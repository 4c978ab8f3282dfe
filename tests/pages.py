"""The code that pages of documentation show."""

import re


def blocks(page: str, language: str) -> list[str]:
    """All blocks of a language, in the order of the page."""
    return re.findall(rf"```{language}\n(.*?)```", page, re.S)
