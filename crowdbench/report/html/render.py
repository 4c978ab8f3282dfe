"""Render templates: those of the report, and those of other generated pages in its frame."""

from base64 import b64encode
from hashlib import sha256
from pathlib import Path

from markupsafe import Markup

from crowdbench.report.text import words
from crowdbench.report.text.words import environment

_FOLDER = Path(__file__).parent
_HTML = environment(_FOLDER / "templates")
_HTML.globals |= {"NOTHING": words.NOTHING, "STEERED": words.STEERED}
for _filter in (words.digits, words.plainly, words.share, words.speed, words.with_interval):
    _HTML.filters[_filter.__name__] = _filter


def html(template: str, **values: object) -> Markup:
    """A rendered template as HTML; values are escaped unless they are `Markup`."""
    return Markup(_HTML.get_template(template).render(values))


def own(name: str) -> str:
    """The text of a file in this package's folder."""
    return (_FOLDER / name).read_text(encoding="utf-8")


def html_page(title: str, body: str, *, style: str, script: str = "") -> str:
    """A complete HTML page: a single file that loads no other files.

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
