"""The leaderboard's pages: `README.md`, `index.html` and a page per entry, from the entries alone.

The same entries give the same bytes. Nothing is computed here but means over families and scenes,
and ranks on the resamples that entries share.
"""

from pathlib import Path

from crowdbench.errors import SettingError
from crowdbench.files import unwritable, write_text
from crowdbench.leaderboard.pages.entry_page import entry_page
from crowdbench.leaderboard.pages.index import index_page
from crowdbench.leaderboard.pages.readme import readme
from crowdbench.leaderboard.standings import TRACKS, read_entries, standing


def build(root: Path) -> list[Path]:
    """Write the pages of `root/entries/*.json` into `root`; pages of entries that left are removed.

    Returns:
        What was written: `README.md`, `index.html`, then `pages/ID.html` by track.

    Raises:
        SettingError: `root` is no folder of a leaderboard.
        WeightsError: an entry is broken, or cannot be compared with the others.
        OutputError: a file cannot be written.
    """
    # README.md and index.html are names that other folders have, too.
    if not (root / "entries").is_dir() and not (root / "RULES.md").is_file():
        raise SettingError(
            root,
            got="neither entries/ nor RULES.md in it",
            expected="the folder of a leaderboard",
            mend="Name it with --root.",
        )
    entries = read_entries(root / "entries")
    standings = [standing(track, entries) for track in TRACKS]
    pages = {root / "README.md": readme(standings), root / "index.html": index_page(standings)}
    for each in standings:
        for line in (*each.lines, *each.listed):
            pages[root / "pages" / f"{line.entry.id}.html"] = entry_page(line, each)
    for path, text in pages.items():
        write_text(path, text)
    for path in (root / "pages").glob("*.html"):
        if path not in pages:
            _remove(path)
    return list(pages)


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise unwritable(path, error) from error


__all__ = ["build"]
