"""Text of the pages: a submitter's text, which remains plain text, and numbers."""

import html
import re

from markupsafe import Markup

from crowdbench.report.text.words import NOTHING, plainly

_SHORT = 80
_LINK = re.compile(
    r"https://[a-z0-9](?:[a-z0-9.-]*[a-z0-9])?(?::[0-9]{1,5})?"
    r"(?:[/?#][a-z0-9._~!$&'()*+,;=:@%/?#-]*)?",
    re.IGNORECASE,
)


def plain(text: str, most: int | None = None) -> str:
    """The text on one line, cut to `most` characters, without unprintable characters.

    Some of these would change the direction of the text around them.
    """
    seen = "".join(c if c.isprintable() else "\ufffd" for c in " ".join(text.split()))
    return seen if most is None or len(seen) <= most else f"{seen[: most - 1].rstrip()}…"


def in_html(text: str, most: int | None = None) -> Markup:
    """The text escaped for HTML, with its direction isolated from the text around it."""
    return Markup(f"<bdi>{html.escape(plain(text, most))}</bdi>")


def in_markdown(text: str, most: int | None = _SHORT) -> str:
    """The text for Markdown; special characters become character references."""
    return re.sub(r"[!-+./:-@\[-`{-~]", lambda found: f"&#{ord(found[0])};", plain(text, most))


def short(text: str) -> Markup:
    """The text escaped for HTML, cut to fit into a table's cell."""
    return in_html(text, _SHORT)


def link(address: str, text: str = "") -> Markup:
    """A link if the address is a plain https URL of at most 200 characters, else the address.

    Its text is `text`, by default the address.
    """
    if len(address) > 200 or not _LINK.fullmatch(address):
        return in_html(address)
    to = html.escape(plain(address))
    shown = html.escape(text) or to
    return Markup(f'<a href="{to}" rel="nofollow noopener">{shown}</a>')


def what_link(address: str) -> str:
    """What an address leads to, in a word: a paper, or something else, such as code."""
    return "paper" if re.match(r"(?i)https://(dx\.|www\.)?(doi|arxiv)\.org/", address) else "link"


def decimals(value: float | None) -> str:
    """A number with two decimals, or a dash."""
    return NOTHING if value is None else plainly(value)


def copied_share(value: float | None, limit: float | None) -> str:
    """A share of copied trips with the limit beyond which it is flagged, or a dash."""
    return NOTHING if value is None else f"{share(value)} (limit {share(limit)})"


def share(value: float | None) -> str:
    """A share in per cent, or a dash."""
    return NOTHING if value is None else f"{100 * value:.1f}\u00a0%"
