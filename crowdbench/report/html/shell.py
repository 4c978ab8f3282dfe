"""The HTML frame of all pages: a single file that loads no other files."""

from base64 import b64encode
from hashlib import sha256

from markupsafe import Markup

from crowdbench.report.html.render import html, own


def html_page(title: str, body: str, *, style: str, script: str = "") -> str:
    """A complete HTML page.

    Its content security policy forbids the browser to load anything, or to run any script other
    than `script`.

    Args:
        title: Plain text.
        body: HTML.
        style: CSS in addition to `base.css`, which all pages share.
        script: JavaScript. Without it, the page may not run any script.
    """
    code = f"\n{script}" if script else ""
    page = html(
        "page.html.j2",
        title=title,
        body=Markup(body),
        style=Markup(f"{own('base.css')}\n{style}"),
        script=Markup(code),
        digest=b64encode(sha256(code.encode()).digest()).decode(),
    )
    return str(page)  # whoever adds text to a `Markup` would have it escaped
