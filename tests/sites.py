"""A leaderboard that is built, and the text and tags of its pages."""

from html.parser import HTMLParser
from pathlib import Path

import msgspec
from entries import everyone, made_up, put

from crowdbench.leaderboard.verification.entry import Entry, Flag
from studies.site import build
from studies.site.entry_page import entry_page
from studies.site.index import index_page
from studies.site.readme import readme
from studies.site.standings import TRACKS, standing

HOSTILE = (
    "<script>document.title = 'ran'</script>",
    "<img src=https://example.com/x.png onerror=alert(1)>",
    "[x](javascript:alert(1))",
    "![x](https://example.com/x.png)",
    "a | b | c",
    "`code` **bold** _soft_ ~~gone~~",
    '"><b onclick="alert(1)">',
    "</title></style></script><h1>Mine</h1>",
    "\u202egnp.exe\u202c and \x00\x1b[31m",
    "line\nbreak\n\n# heading",
    "&lt;script&gt; &#60;",
    "https://example.com www.example.com",
)
LEADERBOARD = Path(__file__).parents[1] / "leaderboard"


def built(root: Path) -> Path:
    """A leaderboard of all kinds of entries, with tables and pages in its folder."""
    put(everyone(), root)
    build(root)
    build(root, root)
    return root


class Text(HTMLParser):
    """The text of a page, and its tags."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.text, self.tags = "", [("", dict[str, str | None]())]
        self.feed(html)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def hostile(text: str, status: str = "ranked") -> Entry:
    """Everything that somebody else writes is this text."""
    flag = Flag(what="too good", scene="eth-v0", value=2.0, limit=1.0, text=text)
    entry = made_up("hostile", "walk", 0.5, status=status, flags=(flag,))  # type: ignore[arg-type]
    scene = entry.scenes["eth-v0"]
    curve = next(iter(scene.curves.values()))
    drawn = {text: msgspec.structs.replace(curve, x_label=text, y_label=text)}
    declared = msgspec.structs.replace(
        entry.declared,
        name=text, authors=[text, text], contact=text, link=text, licence=text, date=text,
        shipped_policy=text, shipped_spawn=text,
        training=msgspec.structs.replace(entry.declared.training, data=text),
    )  # fmt: skip
    return msgspec.structs.replace(
        entry,
        declared=declared,
        artefacts={text: text},
        crowdbench=text,
        scenes=entry.scenes
        | {"eth-v0": msgspec.structs.replace(scene, curves=drawn, outcomes={text: 3})},
    )


def pages_of(*entries: Entry) -> tuple[str, str, str]:
    """`README.md`, `index.html` and the first entry's page."""
    standings = [standing(track, entries) for track in TRACKS]
    lines = (*standings[0].lines, *standings[0].listed)
    return readme(standings), index_page(standings), entry_page(lines[0], standings[0])
