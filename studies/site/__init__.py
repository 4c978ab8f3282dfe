"""The leaderboard's tables and pages, drawn from the entries alone.

The same entries give the same bytes. Only means over families and scenes are computed here, and
ranks on the resamples that entries share.
"""

from pathlib import Path

from markupsafe import Markup

from crowdbench.errors import SettingError
from crowdbench.files import read_bytes, unwritable, write_text
from crowdbench.leaderboard.verification.entry import entry_paths, shipped_leaderboard
from studies.clips import read_clips
from studies.site.entry_page import entry_page
from studies.site.excerpt import with_excerpt
from studies.site.index import index_page
from studies.site.players import scene_players
from studies.site.readme import readme
from studies.site.standings import TRACKS, read_entries, standing

RULES = "RULES.md"


def build(root: Path, site: Path | None = None, *, definitions: str = "") -> list[Path]:
    """Write the tables of the entries in `root/entries`, or with `site` the pages of a site.

    The tables are `README.md` and `index.html` in `root`, and those in `README.md` and
    `docs/results.md` of its parent folder, if these contain the comments of `excerpt`. They link to
    the submissions. A site has `index.html`, a page per entry, `pages/ID.html`, and the rules;
    pages of removed entries are deleted.

    `definitions` is the address of the page that defines the metrics, from a page in `pages`.

    A folder without `RULES.md` is a preview: its entries are shown among those that come with
    crowdbench, in tables and pages in `root`, or in `site`.

    Returns:
        Paths of the written tables and pages.

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
    yours = frozenset(entry_paths(root / "entries")) if preview else None
    paged = preview or site is not None
    standings = [standing(track, entries, yours, paged=paged) for track in TRACKS]
    out = root if site is None else site
    pages = {out / "index.html": index_page(standings)}
    if site is None:
        pages[out / "README.md"] = readme(standings)
    if paged:
        beside = [root] if not preview else [shipped, root]
        shown = [line.entry for each in standings for line in (*each.lines, *each.listed)]
        clips = {e.id: found for e in shown for r in beside if (found := read_clips(e, r)).scenes}
        rules = read_bytes((shipped if preview else root) / RULES, SettingError, "Restore it.")
        pages[out / "pages" / RULES] = rules.decode()
        for each in standings:
            for line in (*each.lines, *each.listed):
                pages[out / "pages" / f"{line.entry.id}.html"] = entry_page(
                    line, each, clips, definitions=definitions
                )
    for path, text in pages.items():
        write_text(path, text)
    for name in () if paged else ("README.md", "docs/results.md"):
        outside = root.absolute().parent / name
        if outside.is_file():
            page = outside.read_text(encoding="utf-8")
            if (new := with_excerpt(page, standings)) != page:
                write_text(outside, new)
    for path in (out / "pages").glob("*.html"):
        if path not in pages:
            _remove(path)
    return list(pages)


def players(root: Path) -> dict[str, Markup]:
    """A player for each scene, with the crowds of the leaderboard `root`; see `scene_players`."""
    entries = read_entries(root / "entries")
    return scene_players([standing(track, entries) for track in TRACKS], root)


def _remove(path: Path) -> None:
    try:
        path.unlink()
    except OSError as error:
        raise unwritable(path, error) from error


__all__ = ["build", "players"]
