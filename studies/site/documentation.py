"""The documentation as a site: the repository's pages, a reference of the API, the leaderboard.

MkDocs with the theme Material draws it, mkdocstrings the reference. Pages are read where they are
in the repository, and their links are written for where they are in the site. It needs no network;
its search needs a server, such as `python -m http.server`.
"""

import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from posixpath import dirname, normpath, relpath
from typing import Any

import msgspec

from crowdbench.errors import SettingError
from crowdbench.files import temporary_folder, unwritable
from crowdbench.report.html.player import SCRIPT, STYLE
from studies.site import build, players, reference

PAGES = {
    "README.md": "index.md",
    "docs/README.md": "pages.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "baselines/README.md": "scripts.md",
    "leaderboard/README.md": "standings.md",
    "leaderboard/RULES.md": "rules.md",
    "leaderboard/index.html": "leaderboard/index.html",
}
"""Where the pages outside `docs` are in the site; those in `docs` keep their places."""
SUBMISSION = "leaderboard/submissions/"
SOURCE = "source"
"""Folder of the site for files of the repository that pages link to."""
MOVING = (
    "Crowds of [the leaderboard](../leaderboard/index.html). Where a policy alone is ranked, "
    "people of `cox-plans` enter: recorded arrivals are not published."
)
_HOME = '<a href="../index.html">crowdbench</a>'
LANGUAGES = {".py": "python", ".toml": "toml", ".sh": "sh", ".yml": "yaml"}
_LINK = re.compile(r"(?P<before>\]\(|(?:src|href)=\")(?P<to>[^)\"#\s]*)(?P<rest>#[^)\"\s]*)?")
_BADGE = re.compile(r"^!\[[^\]]*\]\(https://img\.shields\.io/[^)]*\)\n", re.MULTILINE)
_FENCE = re.compile(r"^```.*?^```$", re.MULTILINE | re.DOTALL)
_ROW = re.compile(r"^\| \[(?P<title>[^\]]+)\]\((?P<to>[^)]+)\)", re.MULTILINE)


def build_site(root: Path, out: Path) -> None:
    """Write the site of the repository `root` into the folder `out`; an earlier site is replaced.

    Raises:
        SettingError: MkDocs is not installed, a page has a link to nothing, or `out` contains
            something else than a site; or `root` is not the repository.
        OutputError: the folder cannot be written.
    """
    if find_spec("mkdocs") is None:
        raise SettingError(
            "the site",
            got="no MkDocs",
            expected="its installation",
            hint='Run pip install -c constraints.txt -e ".[site]".',
        )
    if not (root / "docs" / "README.md").is_file():
        raise SettingError(
            root, got="a folder without docs/README.md", expected="the repository's folder"
        )
    if out.exists() and any(out.iterdir()) and not (out / "sitemap.xml").is_file():
        raise SettingError(
            out, got="a folder with other files", expected="an empty one, or that of a site"
        )
    with temporary_folder("site", out.absolute().parent) as folder:
        pages, site, config = folder / "pages", folder / "site", folder / "mkdocs.yml"
        _assemble(root, pages)
        # YAML contains JSON; the one value that JSON cannot state is a function.
        text = msgspec.json.encode(_config(root, pages, site)).decode()
        slugs = "!!python/object/apply:pymdownx.slugs.slugify {kwds: {case: lower}}"
        config.write_text(text.replace('"SLUGS"', slugs))
        ran = subprocess.run(
            [sys.executable, "-m", "mkdocs", "build", "--strict", "-f", str(config)],
            capture_output=True,
            text=True,
            check=False,
            env=os.environ | {"NO_MKDOCS_2_WARNING": "1", "DISABLE_MKDOCS_2_WARNING": "true"},
        )
        if ran.returncode:
            told = f"{ran.stdout}{ran.stderr}".strip().splitlines()
            wrong = [line for line in told if line.startswith(("WARNING", "ERROR"))]
            raise SettingError(
                "the site",
                got="\n".join(wrong or told),
                expected="pages whose links lead somewhere",
            )
        try:
            if out.exists():
                shutil.rmtree(out)
            site.rename(out)
        except OSError as error:
            raise unwritable(out, error) from error


def _assemble(root: Path, pages: Path) -> None:
    """Copy all pages to where they are in the site, with links that fit."""
    shutil.copytree(root / "docs", pages, ignore=shutil.ignore_patterns("*.md"))
    _leaderboard(root, pages / "leaderboard")
    sources: set[str] = set()
    for path in _read(root):
        text = _linked(root, path, sources)
        if path.endswith(".ipynb"):
            link = f"[Download this notebook]({Path(path).name}){{ download }}"
            text = text.replace("\n\n", f"\n\n{link}\n\n", 1)
        _write(pages / place_of(path), text)
    for path in sorted(sources):
        language = LANGUAGES.get(Path(path).suffix, "text")
        code = (root / path).read_text(encoding="utf-8")
        _write(pages / place_of(path), f"# {path}\n\n````{language}\n{code}````\n")
    for name, text in reference.pages().items():
        _write(pages / name, text)
    for scene, shown in players(root / "leaderboard").items():
        page = pages / "results" / f"{scene}.md"
        if page.is_file():
            moving = f"\n## A minute of the crowds\n\n{MOVING}\n\n{shown}\n\n## "
            _write(page, page.read_text(encoding="utf-8").replace("\n## ", moving, 1))
    _write(pages / "player.js", SCRIPT)
    style = (Path(__file__).parent / "site.css").read_text(encoding="utf-8")
    _write(pages / "style.css", style + STYLE)


def _leaderboard(root: Path, folder: Path) -> None:
    """Write the pages of the leaderboard, whose rules are a page of the site, with links to it."""
    build(root / "leaderboard", folder, definitions="../../metrics.html")
    (folder / "pages" / "RULES.md").unlink()
    index = folder / "index.html"
    text = index.read_text(encoding="utf-8").replace('href="pages/RULES.md', 'href="../rules.html')
    start = '<p class="kicker">crowdbench</p>'
    _write(index, text.replace(start, start.replace("crowdbench", _HOME)))


def _read(root: Path) -> Iterator[str]:
    """Paths of all pages in the repository."""
    yield from (path for path in PAGES if path.endswith(".md"))
    for path in sorted([*(root / "docs").rglob("*.md"), *(root / "docs").rglob("*.ipynb")]):
        name = path.relative_to(root).as_posix()
        if name not in PAGES:
            yield name


def place_of(path: str) -> str:
    """Where a file of the repository is in the site; both are relative paths."""
    if path in PAGES:
        return PAGES[path]
    if path.startswith(SUBMISSION):
        return f"leaderboard/pages/{path.removeprefix(SUBMISSION)}.html"
    if path.startswith("docs/"):
        return path.removeprefix("docs/").replace(".ipynb", ".md")
    return f"{SOURCE}/{path.lstrip('.')}.md"  # MkDocs hides what begins with a dot


def _linked(root: Path, path: str, sources: set[str]) -> str:
    """A page whose links fit the site; files that it links to as sources are added to `sources`."""
    here = dirname(place_of(path))

    def link(found: re.Match[str]) -> str:
        to, rest = found["to"], found["rest"] or ""
        if not to or ":" in to:
            return found[0]
        target = normpath(f"{dirname(path)}/{to}").lstrip("/")
        if (root / target).is_dir() and not target.startswith(SUBMISSION):
            inner = [
                name for name in ("README.md", "pyproject.toml") if (root / target / name).is_file()
            ]
            target = f"{target}/{inner[0]}" if inner else target
        if not (root / target).is_file() and not target.startswith(SUBMISSION):
            return found[0]  # MkDocs names links to nothing
        place = place_of(target)
        if place.startswith(SOURCE):
            sources.add(target)
        return f"{found['before']}{relpath(place, here or '.')}{rest}"

    text = _BADGE.sub("", _text(root / path))
    parts, end = [], 0
    for fence in _FENCE.finditer(text):  # code has no links
        parts += [_LINK.sub(link, text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, _LINK.sub(link, text[end:])])


def _text(path: Path) -> str:
    """The Markdown of a page; of a notebook, with its code in blocks."""
    text = path.read_text(encoding="utf-8")
    if path.suffix != ".ipynb":
        return text
    cells = msgspec.json.decode(text)["cells"]
    parts = []
    for cell in cells:
        source = "".join(cell["source"])
        code = cell["cell_type"] == "code"
        language = "sh" if source.startswith(("!", "%")) else "python"
        parts.append(f"```{language}\n{source.lstrip('!%')}\n```" if code else source)
    return "\n\n".join(parts) + "\n"


def _write(path: Path, text: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")


def _config(root: Path, pages: Path, site: Path) -> dict[str, Any]:
    """The configuration of MkDocs."""
    options = {
        "show_root_heading": True,
        "show_source": False,
        "show_signature_annotations": True,
        "separate_signature": True,
        "members_order": "source",
        "heading_level": 2,
        "docstring_section_style": "list",
        "docstring_options": {"warnings": False},  # compiled functions have no annotations
        "merge_init_into_class": True,
        "signature_crossrefs": True,
    }
    return {
        "site_name": "crowdbench",
        "docs_dir": str(pages),
        "site_dir": str(site),
        "use_directory_urls": False,
        "theme": {
            "name": "material",
            "font": False,  # those of the reader's system: no network
            "features": [
                "navigation.tabs", "navigation.indexes", "navigation.top", "content.code.copy",
                "search.suggest", "search.highlight", "toc.follow",
            ],
            "palette": [
                {
                    "media": f"(prefers-color-scheme: {name})",
                    "scheme": scheme,
                    "primary": "blue grey",
                    "toggle": {"icon": f"material/weather-{icon}", "name": f"turn {other}"},
                }
                for name, scheme, icon, other in (
                    ("light", "default", "night", "dark"),
                    ("dark", "slate", "sunny", "light"),
                )
            ],
        },
        "extra_css": ["style.css"],
        "extra_javascript": ["player.js"],
        "plugins": [
            "search",
            {"mkdocstrings": {"handlers": {"python": {"paths": [str(root)], "options": options}}}},
        ],
        "markdown_extensions": [
            "tables", "attr_list", "md_in_html", "admonition", "pymdownx.superfences",
            "pymdownx.highlight", {"toc": {"permalink": True, "slugify": "SLUGS"}},
        ],
        "validation": {
            "anchors": "warn",
            "links": {"not_found": "warn"},
            "omitted_files": "ignore",
        },
        "nav": _navigation(root),
    }  # fmt: skip


def _navigation(root: Path) -> list[dict[str, Any]]:
    """The sections of `docs/README.md`, whose tables list all pages, and what is around them."""
    nav: list[dict[str, Any]] = [
        {"Start": ["index.md", {"All pages": "pages.md"}, {"Changes": "changelog.md"}]}
    ]
    text = (root / "docs/README.md").read_text(encoding="utf-8")
    for section in text.split("\n## ")[1:]:
        title, _, body = section.partition("\n")
        listed = [
            {row["title"]: place_of(normpath(f"docs/{row['to']}"))} for row in _ROW.finditer(body)
        ]
        if listed:
            nav.append({title: listed})
    nav.append({"Leaderboard": ["leaderboard/index.html", {"As a table": "standings.md"}]})
    nav.append({"Reference": [{title: name} for name, title in reference.TITLES.items()]})
    return nav
