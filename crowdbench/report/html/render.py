"""Render the templates of the report, and of the frame that it shares with other pages."""

from pathlib import Path

from markupsafe import Markup

from crowdbench.report.text.templates import environment
from crowdbench.report.text.words import (
    NOTHING,
    STEERED,
    digits,
    plainly,
    share,
    speed,
    with_interval,
)

_FOLDER = Path(__file__).parent
_HTML = environment(_FOLDER / "templates")
_HTML.globals |= {"NOTHING": NOTHING, "STEERED": STEERED}
_HTML.filters |= {"digits": digits, "plainly": plainly, "share": share, "speed": speed}
_HTML.filters |= {"with_interval": with_interval}


def html(template: str, **values: object) -> Markup:
    """A rendered template as HTML; values are escaped unless they are `Markup`."""
    return Markup(_HTML.get_template(template).render(values))


def own(name: str) -> str:
    """The text of a file in this package's folder."""
    return (_FOLDER / name).read_text(encoding="utf-8")
