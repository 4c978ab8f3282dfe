"""Text that a submitter wrote, on its way into a page: it stays text."""

import html
import re

_SHORT = 80
_LINK = re.compile(
    r"https://[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?(?::[0-9]{1,5})?"
    r"(?:[/?#][a-z0-9._~!$&'()*+,;=:@%/?#-]*)?",
    re.IGNORECASE,
)


def plain(text: str, most: int | None = None) -> str:
    """On one line, at most so long, without letters nobody sees, which can turn others round."""
    seen = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))
    return seen if most is None or len(seen) <= most else f"{seen[: most - 1].rstrip()}…"


def escaped(text: str, most: int | None = None) -> str:
    """For attributes and pictures."""
    return html.escape(plain(text, most))


def in_html(text: str, most: int | None = None) -> str:
    """Escaped, and set apart from the direction in which the text around it runs."""
    return f"<bdi>{escaped(text, most)}</bdi>"


def in_markdown(text: str, most: int | None = _SHORT) -> str:
    """All that could mean something in Markdown, in a table or in HTML as character references."""
    return re.sub(r"[!-+./:-@\[-`{-~]", lambda found: f"&#{ord(found[0])};", plain(text, most))


def short(text: str) -> str:
    """As HTML, cut to what a cell of a table holds."""
    return in_html(text, _SHORT)


def link(address: str) -> str:
    """An `<a>` if the address is a plain https one of at most 200 letters, else text."""
    if len(address) > 200 or not _LINK.fullmatch(address):
        return in_html(address)
    shown = escaped(address)
    return f'<a href="{shown}" rel="nofollow noopener">{shown}</a>'
