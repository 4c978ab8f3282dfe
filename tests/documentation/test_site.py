"""The site is built from the repository without a network, and its links lead somewhere."""

import re
from importlib.util import find_spec
from pathlib import Path

import pytest
from conftest import need

import crowdbench
from crowdbench.errors import SettingError
from studies.site.documentation import build_site, place_of
from studies.site.reference import MODULES

ROOT = Path(__file__).parents[2]
_NEEDED = re.compile(r'<(?:script|link|img|iframe)[^>]*(?:src|href)="(https?:[^"]*)"')
_TO = re.compile(r'(?:href|src)="([^":#?]+)(?:#[^"]*)?"')


def needs_mkdocs() -> None:
    need(find_spec("mkdocs") and find_spec("mkdocstrings"), "the extra site")


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    needs_mkdocs()
    out = tmp_path_factory.mktemp("built") / "site"
    build_site(ROOT, out)
    return out


@pytest.mark.long
@pytest.mark.xdist_group("site")
def test_all_links_of_the_site_lead_to_files(site: Path) -> None:
    wrong = []
    for page in site.rglob("*.html"):
        for to in _TO.findall(page.read_text(encoding="utf-8")):
            if page.name != "404.html" and not (page.parent / to).exists():
                wrong.append(f"{page.relative_to(site)}: {to}")
    assert not wrong, "\n".join(wrong)


@pytest.mark.long
@pytest.mark.xdist_group("site")
def test_the_site_needs_no_network(site: Path) -> None:
    needed = {
        address
        for page in site.rglob("*.html")
        for address in _NEEDED.findall(page.read_text(encoding="utf-8"))
    }
    assert not needed


@pytest.mark.long
@pytest.mark.xdist_group("site")
def test_all_pages_and_public_names_are_there(site: Path) -> None:
    for page in (ROOT / "docs").rglob("*.md"):
        path = page.relative_to(ROOT).as_posix()
        assert (site / place_of(path)).with_suffix(".html").is_file(), path
    for book in (ROOT / "docs" / "notebooks").glob("*.ipynb"):
        assert (site / "notebooks" / book.name).is_file()
        assert "<code>" in (site / "notebooks" / f"{book.stem}.html").read_text(encoding="utf-8")
    names = (site / "reference" / "crowdbench.html").read_text(encoding="utf-8")
    for name in crowdbench.__all__:
        assert re.search(rf'id="crowdbench\.(\w+\.)*{name}"', names), name
    for page, modules in MODULES.items():
        text = (site / page).with_suffix(".html").read_text(encoding="utf-8")
        for module in modules:
            assert f'id="crowdbench.{module}"' in text
    start = (site / "index.html").read_text(encoding="utf-8")
    assert "Reference" in start
    assert 'href="robots.html"' in start
    assert (site / "search" / "search_index.json").stat().st_size > 100_000
    board = (site / "leaderboard" / "index.html").read_text(encoding="utf-8")
    assert 'href="../index.html"' in board


@pytest.mark.long
def test_a_link_to_nothing_is_an_error_and_keeps_the_former_site(tmp_path: Path) -> None:
    needs_mkdocs()
    root, out = tmp_path / "repository", tmp_path / "site"
    (root / "docs").mkdir(parents=True)
    for path in ROOT.iterdir():
        if path.name not in ("docs", ".git"):
            (root / path.name).symlink_to(path)
    (root / "docs/README.md").write_text("# Pages\n\n## Use\n\n| [One](one.md) | a page |\n")
    (root / "docs/one.md").write_text("# One\n\n[Nothing](nothing.md)\n")
    out.mkdir()
    (out / "sitemap.xml").write_text("former")
    with pytest.raises(SettingError, match=r"nothing\.md"):
        build_site(root, out)
    assert (out / "sitemap.xml").read_text() == "former"


def test_another_folder_is_no_repository(tmp_path: Path) -> None:
    needs_mkdocs()
    with pytest.raises(SettingError, match=r"without docs/README\.md"):
        build_site(tmp_path, tmp_path / "site")


def test_other_files_are_not_replaced(tmp_path: Path) -> None:
    needs_mkdocs()
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(SettingError, match="other files"):
        build_site(ROOT, tmp_path)
    assert (tmp_path / "thesis.tex").exists()
