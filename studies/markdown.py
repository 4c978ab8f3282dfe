"""Markdown for generated pages: tables, and paragraphs wrapped at 100 characters."""

import re
import textwrap
from collections.abc import Sequence


def table(head: Sequence[str], lines: Sequence[Sequence[str]], *, text: int = 1) -> str:
    """A Markdown table; the first `text` columns are left-aligned, the others right-aligned."""
    rule = ["---" if k < text else "---:" for k in range(len(head))]
    return "\n".join(f"| {' | '.join(line)} |" for line in (head, rule, *lines))


def flowed(text: str) -> str:
    """Wrap paragraphs and list items at 100 characters; leave all other blocks unchanged."""
    found = []
    for block in text.split("\n\n"):
        if block.startswith("- "):
            items = block.split("\n")
            found.append("\n".join(_filled(item, "  ") for item in items))
        elif block.startswith(("#", "|", "!", "```")):
            found.append(block)
        else:
            found.append(_filled(" ".join(block.split("\n")).strip()))
    return "\n\n".join(found) + "\n"


def _filled(text: str, indent: str = "") -> str:
    # Intervals, percentages and names of crowds are not broken across lines.
    kept = re.sub(r" ×\s|\d %|\S+ \[\S+, \S+\]", lambda found: found[0].replace(" ", "\0"), text)
    lines = textwrap.fill(
        kept, 100, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
    )
    return lines.replace("\0", " ")
