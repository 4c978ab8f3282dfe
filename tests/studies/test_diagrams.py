"""The diagrams of the documentation are those that the study draws, and pages show them."""

from pathlib import Path
from xml.etree import ElementTree

import pages
import pytest

from studies.__main__ import main as studies_main
from studies.diagrams import DIAGRAMS, energy_score

DOCS = pages.ROOT / "docs"


def test_the_command_draws_the_pictures_of_the_pages(tmp_path: Path) -> None:
    assert studies_main(["diagrams", "--out", str(tmp_path)]) == 0
    drawn = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert drawn == {path.name: path.read_bytes() for path in (DOCS / "diagrams").iterdir()}
    assert set(drawn) == {f"{name}.svg" for name in DIAGRAMS}


@pytest.mark.parametrize("name", DIAGRAMS)
def test_a_page_shows_it_and_says_what_it_shows(name: str) -> None:
    root = ElementTree.fromstring(DIAGRAMS[name]())
    assert root.find("{*}title") is not None
    shown = [
        page.name for page in DOCS.glob("*.md") if f"](diagrams/{name}.svg)" in page.read_text()
    ]
    assert len(shown) == 1


def test_the_scale_is_drawn_for_the_crowds_beside_it() -> None:
    assert energy_score([(0.0, 0.0), (2.0, 0.0), (1.0, 0.0)], (1.0, 0.0)) == pytest.approx(0)
    assert energy_score([(3.0, 4.0), (3.0, 4.0)], (0.0, 0.0)) == 5
