"""Environments for templates: HTML is escaped, and no value may be missing."""

from pathlib import Path

import pytest
from jinja2 import UndefinedError
from markupsafe import Markup

from crowdbench.report.text.words import environment


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "page.j2").write_text("<b>\n  {% if name %}\n{{ name }}\n  {% endif %}\n</b>\n")
    return tmp_path


@pytest.mark.parametrize(
    ("html", "name", "shown"),
    [
        (True, "<i>'\"&", "&lt;i&gt;&#39;&#34;&amp;"),
        (True, Markup("<i>"), "<i>"),
        (False, "<i>'\"&", "<i>'\"&"),
    ],
)
def test_only_html_is_escaped_and_lines_of_tags_vanish(
    html: bool, name: str, shown: str, folder: Path
) -> None:
    template = environment(folder, html=html).get_template("page.j2")
    assert template.render(name=name) == f"<b>\n{shown}\n</b>\n"


def test_a_missing_value_is_an_error(folder: Path) -> None:
    with pytest.raises(UndefinedError, match="'name' is undefined"):
        environment(folder).get_template("page.j2").render()
