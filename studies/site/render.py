"""Render the templates of the leaderboard's pages."""

from pathlib import Path

from markupsafe import Markup

from crowdbench.exam import TRIALS
from crowdbench.leaderboard.scores import View
from crowdbench.report.text.words import NOTHING, digits, environment, speed
from crowdbench.report.text.words import share as shown_share
from studies.site import axis
from studies.site.tables import GATE, examined, gated
from studies.site.text import (
    copied_share,
    decimals,
    in_html,
    link,
    plain,
    share,
    short,
    what_link,
)

_FOLDER = Path(__file__).parent
_HTML = environment(_FOLDER / "templates")
_HTML.globals |= {"GATE": GATE, "axis": axis, "examined": examined, "gated": gated,
                  "NOTHING": NOTHING, "TRIALS": TRIALS, "View": View}  # fmt: skip
_HTML.globals |= {"copied_share": copied_share}
_HTML.filters |= {
    "decimals": decimals,
    "digits": digits,
    "in_html": in_html,
    "link": link,
    "plain": plain,
    "share": share,
    "short": short,
    "shown_share": shown_share,
    "speed": speed,
    "what_link": what_link,
}
_MARKDOWN = environment(_FOLDER / "templates", html=False)


def html(template: str, **values: object) -> Markup:
    """A rendered template as HTML; values are escaped unless they are `Markup`."""
    return Markup(_HTML.get_template(template).render(values))


def markdown(template: str, **values: object) -> str:
    """A rendered template as Markdown; values are Markdown already."""
    return _MARKDOWN.get_template(template).render(values)


def own(name: str) -> str:
    """The text of a file in this package's folder."""
    return (_FOLDER / name).read_text(encoding="utf-8")
