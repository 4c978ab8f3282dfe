"""The leaderboard's pages: `README.md`, `index.html` and a page per entry, from the entries alone.

The tables in the repository's README and `docs/results.md` are written too.

The same entries give the same bytes. Only means over families and scenes are computed here, and
ranks on the resamples that entries share.
"""

from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.files import read_bytes, unwritable, write_text
from crowdbench.leaderboard.pages.entry_page import entry_page
from crowdbench.leaderboard.pages.excerpt import with_excerpt
from crowdbench.leaderboard.pages.index import index_page
from crowdbench.leaderboard.pages.readme import readme
from crowdbench.leaderboard.pages.standings import TRACKS, read_entries, standing

RULES = "RULES.md"


def build(root: Path) -> list[Path]:
    """Write the pages of `root/entries/*.json` into `root`; pages of removed entries are deleted.

    A folder without `RULES.md` becomes a preview: its entries are shown among those that come with
    crowdbench, and the rules are copied into `pages/`. Otherwise the tables in `README.md` and
    `docs/results.md` of the parent folder are updated too, if these contain the comments of
    `excerpt`.

    Returns:
        Paths of the written pages: `README.md`, `index.html`, then `pages/ID.html` by track.

    Raises:
        SettingError: `root` is not the folder of a leaderboard.
        WeightsError: an entry is broken, or cannot be compared with the others.
        OutputError: a file cannot be written.
    """
    # Other folders have a README.md or an index.html too, which must not be overwritten.
    preview = not (root / RULES).is_file()
    if preview and not (root / "entries").is_dir():
        raise SettingError(
            root,
            got="a folder without entries/ and RULES.md",
            expected="the folder of a leaderboard",
            hint="Name it with --root.",
        )
    shipped = shipped_leaderboard()
    entries = read_entries(root / "entries", shipped / "entries" if preview else None)
    yours = frozenset(e.id for e in entries if (root / "entries" / f"{e.id}.json").is_file())
    standings = [standing(track, entries, yours if preview else None) for track in TRACKS]
    pages = {root / "README.md": readme(standings), root / "index.html": index_page(standings)}
    for each in standings:
        for line in (*each.lines, *each.listed):
            pages[root / "pages" / f"{line.entry.id}.html"] = entry_page(line, each)
    for path, text in pages.items():
        write_text(path, text)
    if preview:
        rules = read_bytes(shipped / RULES, SettingError, "Reinstall crowdbench.")
        write_text(root / "pages" / RULES, rules.decode())
    for name in () if preview else ("README.md", "docs/results.md"):
        outside = root.absolute().parent / name
        if outside.is_file():
            page = outside.read_text(encoding="utf-8")
            if (new := with_excerpt(page, standings)) != page:
                write_text(outside, new)
    for path in (root / "pages").glob("*.html"):
        if path not in pages:
            _remove(path)
    return list(pages)


def shipped_leaderboard() -> Path:
    """The folder of the leaderboard that comes with crowdbench."""
    package = Path(__file__).parents[2]
    installed = package / "_leaderboard"  # in an installed wheel
    return installed if installed.is_dir() else package.parent / "leaderboard"


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise unwritable(path, error) from error


__all__ = ["build"]
