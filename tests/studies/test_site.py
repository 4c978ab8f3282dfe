"""The leaderboard's pages: made of entries alone, complete, honest about ties, and safe to open."""

import itertools
import os
import re
import subprocess
import textwrap
from collections.abc import Iterator
from html.parser import HTMLParser
from pathlib import Path

import msgspec
import numpy as np
import pytest
from browser import Browser, browsing
from entries import everyone, made_up, put
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from PIL import Image

from crowdbench.cli.leaderboard import print_entry
from crowdbench.errors import SettingError, WeightsError
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.submission.schema import SCENES, Trained
from crowdbench.leaderboard.verification.entry import (
    SCORER,
    Curve,
    Entry,
    Flag,
    ScoreCard,
    entry_paths,
    read_entry,
)
from crowdbench.leaderboard.verification.flags import trip_limit
from crowdbench.metrics import WALK
from crowdbench.report.text.words import with_interval
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.score import Score, combined, ranks
from studies.__main__ import main as studies_main
from studies.site import build
from studies.site.axis import NARROW, bar
from studies.site.curves import figure
from studies.site.entry_page import entry_page
from studies.site.excerpt import (
    BEGIN,
    END,
    PAPER_BEGIN,
    paper_metrics,
    with_excerpt,
)
from studies.site.index import index_page
from studies.site.readme import readme
from studies.site.standings import TRACKS, read_entries, standing
from studies.site.text import in_html, in_markdown, link

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
ROOT = Path(__file__).parents[2] / "leaderboard"
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A leaderboard of all kinds of entries, built."""
    root = put(everyone(), tmp_path_factory.mktemp("leaderboard"))
    build(root)
    build(root, root)
    return root


def contents(root: Path) -> dict[str, bytes]:
    put_there = ("RULES.md",)
    made = (p for p in root.rglob("*") if p.is_file() and p.suffix != ".gz")
    made = (p for p in made if p.name not in put_there)
    return {str(p.relative_to(root)): p.read_bytes() for p in made}


# Standings.


def test_scores_combine_families_then_scenes() -> None:
    entry = next(e for e in everyone() if e.id == "ntpp-gmm-bc")
    found = scores(entry)
    each = []
    for name in SCENES:
        families = {f: card.score() for f, card in entry.scenes[name].families.items()}
        crowd = [score for f, score in families.items() if f not in WALK]
        walk = [score for f, score in families.items() if f in WALK]
        assert len(walk) == 2
        value = (np.mean([s.value for s in crowd]) + min(s.value for s in walk)) / 2
        resampled = np.mean([s.resampled for s in crowd], axis=0)
        resampled = (resampled + np.min([s.resampled for s in walk], axis=0)) / 2
        assert found[View(scene=name)].value == pytest.approx(value)
        np.testing.assert_allclose(found[View(scene=name)].resampled, resampled)
        assert found[View("motion", name)].value == families["motion"].value
        each.append(Score(float(value), resampled))
    assert found[View()].value == pytest.approx(np.mean([score.value for score in each]))
    np.testing.assert_allclose(
        found[View()].resampled, np.mean([score.resampled for score in each], axis=0)
    )
    assert found[View("trips")].value == pytest.approx(
        np.mean([entry.scenes[s].families["trips"].value for s in ("gc-v0", "forum-v0")])
    )


@pytest.mark.parametrize("track", TRACKS)
def test_ranks_of_each_view_are_those_of_its_scores(track: str) -> None:
    found = standing(track, everyone())  # type: ignore[arg-type]
    for view in found.views:
        competing = [
            line
            for line in found.lines
            if line.entry.status == "ranked" and view in scores(line.entry)
        ]
        expected = ranks([scores(line.entry)[view] for line in competing])
        names = [line.entry.id for line in competing]
        alone = len(names) == 1
        assert found.ranks[view] == ({} if alone else dict(zip(names, expected, strict=True)))


def test_who_lacks_a_scene_ranks_on_the_others_alone() -> None:
    found = standing("walk", everyone())
    assert "ppo" not in found.ranks[View()]
    assert "ppo" in found.ranks[View(scene="eth-v0")]
    assert "ppo" not in found.ranks[View(scene="forum-v0")]


def test_a_scene_without_a_family_that_counts_there_has_no_score() -> None:
    entry = made_up("half", "walk", 0.5)
    scene = entry.scenes["gc-v0"]
    less = msgspec.structs.replace(scene, families={"motion": scene.families["motion"]})
    scenes = entry.scenes | {"gc-v0": less}
    found = scores(msgspec.structs.replace(entry, scenes=scenes))
    assert View(scene="gc-v0") not in found
    assert View() not in found
    assert View("motion", "gc-v0") in found


def test_crowds_that_came_as_trajectories_are_judged_without_how_people_walk() -> None:
    (line,) = standing("crowd", everyone()).listed
    assert line.kind == "model-based, trajectories"
    each = []
    for name in SCENES:
        families = {f: card.score() for f, card in line.entry.scenes[name].families.items()}
        whole = combined(list(families.values()))
        assert whole is not None
        assert set(families) <= {"arrivals", "presence", "trips", "space"}
        assert line.scores[View(scene=name)].value == pytest.approx(whole.value)
        each.append(whole.value)
    assert line.scores[View()].value == pytest.approx(np.mean(each))
    assert View("motion") not in line.scores
    # A model without these families, or a walk without a family, has no score.
    for entry in (line.entry, made_up("walk", "walk", 0.5)):
        scenes = {
            name: msgspec.structs.replace(
                scene, families={f: c for f, c in scene.families.items() if f != "motion"}
            )
            for name, scene in entry.scenes.items()
        }
        less = msgspec.structs.replace(entry, scenes=scenes, artefacts={"submission.toml": ""})
        assert scores(less).keys() & {View(), *(View(scene=name) for name in SCENES)} == set()


def test_entries_that_cannot_be_told_apart_share_a_rank() -> None:
    found = standing("spawn", everyone())
    by_name = {line.entry.id: found.rank(line, View()) for line in found.lines}
    assert by_name["ntpp-gmm"] == by_name["twin"] == "2\u202f="
    assert by_name["jittered-blocks"] == "1"
    assert by_name["renewal-gmm"] == "4"
    assert by_name["block-replay"] == ""


def test_references_stand_below_all_who_score_as_much() -> None:
    order = [line.entry.id for line in standing("spawn", everyone()).ordered(View())]
    assert order == [
        "jittered-blocks", "ntpp-gmm", "twin", "block-replay", "renewal-gmm", "poisson-gmm",
    ]  # fmt: skip


def test_listed_entries_and_references_do_not_compete() -> None:
    with_all = standing("spawn", everyone())
    alone = standing("spawn", [e for e in everyone() if e.status == "ranked"])
    assert with_all.ranks == alone.ranks


# Files.


def test_the_same_entries_give_the_same_bytes(board: Path, tmp_path: Path) -> None:
    build(put(list(reversed(everyone())), tmp_path))
    build(tmp_path, tmp_path)
    assert contents(tmp_path) == contents(board)


def test_what_is_committed_is_what_its_entries_make(tmp_path: Path) -> None:
    entries = entry_paths(ROOT / "entries").values()
    put([], tmp_path)
    for path in entries:
        (tmp_path / "entries" / path.name).write_bytes(path.read_bytes())
    build(tmp_path)
    made = contents(tmp_path)
    assert made == {name: (ROOT / name).read_bytes() for name in made}


def test_links_of_what_is_committed_lead_somewhere() -> None:
    assert dead_links(ROOT / "index.html") == []
    tables = [(ROOT / "README.md").read_text(), (ROOT.parent / "README.md").read_text()]
    links = [
        link
        for text in tables
        for link in re.findall(r"\((?:leaderboard/)?(submissions/.*?)\)", text)
    ]
    assert links
    assert [link for link in links if not (ROOT / link / "submission.toml").is_file()] == []


def test_without_entries_there_are_pages_too(tmp_path: Path) -> None:
    build(put([], tmp_path))
    assert set(contents(tmp_path)) == {"README.md", "index.html"}
    assert (tmp_path / "README.md").read_text().count("No entries yet.") == 4
    assert (tmp_path / "index.html").read_text().count("No entries yet.") == 3


def test_pages_of_entries_that_left_are_removed(tmp_path: Path) -> None:
    put([made_up("one", "walk", 0.5), made_up("two", "walk", 0.4)], tmp_path)
    build(tmp_path, tmp_path / "site")
    (tmp_path / "entries" / "one.json.gz").unlink()
    build(tmp_path, tmp_path / "site")
    assert set(contents(tmp_path / "site")) == {"index.html", "pages/two.html"}


def test_the_command_says_what_it_wrote(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    put([made_up("one", "walk", 0.5)], tmp_path)
    assert studies_main(["leaderboard", "--root", str(tmp_path)]) == 0
    assert capsys.readouterr().out == f"2 files written to {tmp_path}\n"
    site = tmp_path / "site"
    assert studies_main(["leaderboard", "--root", str(tmp_path), "--site", str(site)]) == 0
    assert capsys.readouterr().out == f"3 files written to {site}\n"
    assert (site / "pages" / "RULES.md").is_file()


@pytest.fixture(scope="module")
def preview(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Entries of one's own in a folder without rules: one as good as `bc`, one that is alone."""
    bc = read_entry(ROOT / "entries" / "bc.json.gz")
    declared = msgspec.structs.replace(bc.declared, name="newcomer")
    newcomer = msgspec.structs.replace(bc, id="newcomer", declared=declared)
    lone = made_up("lone", "walk", 0.5, scenes=("plaza-v0",))
    root = put([newcomer, lone], tmp_path_factory.mktemp("preview"))
    (root / "RULES.md").unlink()
    build(root)
    return root


def test_a_preview_shows_the_shipped_entries_beside_ones_own(preview: Path) -> None:
    lines = (preview / "README.md").read_text().splitlines()
    rows = [line for line in lines if line.startswith("|") and "](pages/" in line]
    ranks = {re.split(r"[][]", row)[1]: row.split("|")[1] for row in rows}
    shipped = set(entry_paths(ROOT / "entries"))
    assert {path.stem for path in (preview / "pages").glob("*.html")} == {
        *shipped, "newcomer", "lone",
    }  # fmt: skip
    assert ranks["newcomer"] == ranks["bc"]
    assert ranks["bc"].strip()
    marked = [row for row in rows if "(yours)" in row]
    assert [re.split(r"[][]", row)[1] for row in marked] == ["newcomer", "lone"]
    assert (preview / "index.html").read_text().count('<span class="yours">') == 3  # and the head
    assert "(yours)" not in (ROOT / "README.md").read_text()
    assert ">yours<" not in (ROOT / "index.html").read_text()


def test_a_lone_entry_has_no_rank(preview: Path) -> None:
    lone = made_up("lone", "walk", 0.5)
    found = standing("walk", [lone])
    assert [found.rank(line, view) for line in found.lines for view in found.views] == [""] * len(
        found.views
    )
    (row,) = (row for row in (preview / "README.md").read_text().splitlines() if "[lone]" in row)
    assert row.startswith("|  | [lone](pages/lone.html) (yours) |")
    assert 'class="rank">–</td>' in (preview / "pages" / "lone.html").read_text()


def dead_links(page: Path) -> list[str]:
    """Relative addresses in a page that lead to nothing."""
    hrefs = {attrs.get("href") for tag, attrs in Text(page.read_text()).tags if tag == "a"}
    relative = {h.split("#")[0] for h in hrefs if h and not h.startswith(("#", "https:"))}
    return [h for h in relative if not (page.parent / h).exists()]


def test_links_of_a_preview_lead_somewhere(preview: Path) -> None:
    for page in (preview / "index.html", *(preview / "pages").glob("*.html")):
        assert dead_links(page) == []
    assert (preview / "pages" / "RULES.md").read_text() == (ROOT / "RULES.md").read_text()
    text = " ".join((preview / "README.md").read_text().split())
    assert "[The rules](pages/RULES.md)" in text


def test_a_folder_that_is_no_leaderboards_keeps_its_files(tmp_path: Path) -> None:
    (tmp_path / "README.md").write_text("mine")
    with pytest.raises(SettingError, match="Name it with --root"):
        build(tmp_path)
    assert (tmp_path / "README.md").read_text() == "mine"


def replaced(entry: Entry, **changes: object) -> Entry:
    scene = msgspec.structs.replace(entry.scenes["eth-v0"], **changes)
    return msgspec.structs.replace(entry, scenes={"eth-v0": scene})


ONE = made_up("one", "walk", 0.5)
UNEVEN = Curve(x_label="x", y_label="y", x=[0.0, 1.0], recorded=[1.0], simulated=[1.0, 2.0])
NOTHING = ScoreCard(value=0.0, resampled=bytes(4 * RESAMPLES))
NO_NUMBER = ScoreCard(value=0.0, resampled=np.full(RESAMPLES, np.nan, "<f4").tobytes())
HUGE = Curve(x_label="x", y_label="y", x=[0.0, 1.7e308], recorded=[0.0, 1.0], simulated=[0.0, 1.0])
LONG = Curve(x_label="x", y_label="y", **dict.fromkeys(("x", "recorded", "simulated"), [0.0] * 101))  # type: ignore[arg-type]
SPEED = ONE.scenes["eth-v0"].metrics["speed"]
FLAG = Flag(what="too good", scene="eth-v0", value=2.0, limit=1.0, text="It is.")
BAD = {
    "a name of 10,000 letters": (made_up("n" * 10_000, "walk", 0.5), "length <= 200"),
    "an older scorer": (msgspec.structs.replace(ONE, scorer=0), "Run `python -m studies rescore`"),
    "another scene": (replaced(ONE, made_from="0"), "with the hash 0"),
    "an unknown family": (replaced(ONE, families={"style": NOTHING}), "an unknown family, 'style'"),
    "a scene like a path": (msgspec.structs.replace(ONE, scenes={"../x": ONE.scenes["eth-v0"]}),
                            "an unknown scene, "),
    "a scene of nobody's": (made_up("one", "walk", 0.5, scenes=("moon-v0",)), "scene, 'moon-v0'"),
    "a scene that was not submitted": (msgspec.structs.replace(
        ONE, declared=msgspec.structs.replace(ONE.declared, scenes=["gc-v0"])), "one of gc-v0"),
    "an uneven curve": (replaced(ONE, curves={"Speed": UNEVEN}), "not have the length of its axis"),
    "an endless curve": (replaced(ONE, curves={"Speed": HUGE}), "`float` <= 1000000000000.0"),
    "a long curve": (replaced(ONE, curves={"Speed": LONG}), "`array` of length <= 100"),
    "a curve of nobody's": (replaced(ONE, curves={"c": ONE.scenes["eth-v0"].curves["Speed"]}),
                            "an unknown curve, 'c'"),
    "a score that is no number": (replaced(ONE, families={"motion": NO_NUMBER}), "numbers up to"),
    "a score without end": (replaced(ONE, families={"motion": msgspec.structs.replace(
        NOTHING, value=-1e300)}), "`float` >= -1000000000000.0"),
    "persons without end": (replaced(ONE, persons=10**15), "`int` <= 1000000000000"),
    "a split of nobody's": (replaced(ONE, metrics={"speed": msgspec.structs.replace(
        SPEED, splits={"x" * 1000: [0.0]})}), "full|fold0|fold1|fold2"),
    "a flag a hundred times": (msgspec.structs.replace(ONE, flags=[FLAG] * 100), "at most once"),
    "a flag of another scene": (msgspec.structs.replace(
        ONE, flags=[msgspec.structs.replace(FLAG, scene="zara1-v0")]), "of a flag, 'zara1-v0'"),
    "more files than there may be": (msgspec.structs.replace(
        ONE, artefacts={f"{k}": "" for k in range(401)}), "of length <= 400"),
    "a metric of nobody's": (replaced(ONE, metrics={"m": ONE.scenes["eth-v0"].metrics["speed"]}),
                             "an unknown metric"),
}  # fmt: skip


@pytest.mark.parametrize("what", BAD)
def test_a_bad_entry_is_named_and_nothing_is_lost(what: str, tmp_path: Path) -> None:
    put([made_up("zzz", "walk", 0.5)], tmp_path)
    build(tmp_path)
    before = contents(tmp_path)
    entry, message = BAD[what]
    put([msgspec.structs.replace(entry, id="bad")], tmp_path)
    with pytest.raises(WeightsError, match=re.escape(message)):
        build(tmp_path)
    assert contents(tmp_path) == before


# Text stays text.


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
        name=text, authors=[text, text], contact=text, link=text, licence=text,
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


TAGS_OF_A_PAGE = {tag for page in pages_of(hostile("x"))[1:] for tag, _ in Text(page).tags}


def check_html(page: str, text: str) -> None:
    found = Text(page)
    assert {tag for tag, _ in found.tags} <= TAGS_OF_A_PAGE
    assert sum(tag == "script" for tag, _ in found.tags) <= 1
    for tag, attributes in found.tags:
        assert not any(name.startswith("on") for name in attributes), tag
        assert set(attributes) & {"src", "srcset", "action"} == set()
        href = attributes.get("href")
        if tag == "a" and not re.match(r"[#.\w/-]+\.(html|md)\b|#|submissions/[\w-]+$", str(href)):
            assert href == text
            assert text.startswith("https://")
            assert attributes["rel"] == "nofollow noopener"


def check_markdown(page: str) -> None:
    tokens = MarkdownIt("commonmark").enable("table").parse(page)
    rows = [
        len([t for t in group if t.type in ("td_open", "th_open")])
        for group in (
            list(itertools.takewhile(lambda t: t.type != "tr_close", tokens[k:]))
            for k, t in enumerate(tokens)
            if t.type == "tr_open"
        )
    ]
    assert len(set(rows)) == 1
    assert [t.content for t in tokens if t.type in ("html_block", "code_block")] == []
    inside = [child for t in tokens if t.type == "inline" for child in t.children or []]
    assert {t.type for t in inside} & {"html_inline", "image", "strong_open"} == set()
    for token in inside:
        if token.type == "link_open":
            assert re.fullmatch(
                r"((pages/)?[\w-]+\.(html|md)(#[\w-]+)?|submissions/[\w-]+)",
                str(token.attrs["href"]),
            )


@pytest.mark.parametrize("status", ["ranked", "listed"])
@pytest.mark.parametrize("text", [*HOSTILE, "n" * 10_000, "spaced " * 1500])
def test_what_others_wrote_stays_text(text: str, status: str) -> None:
    markdown, index, page = pages_of(hostile(text, status))
    check_markdown(markdown)
    check_html(index, text)
    check_html(page, text)
    assert len(markdown) < 10_000
    shown = " ".join("".join(c if c.isprintable() else "\ufffd" for c in text.split("\n")[0])[:60]
                     .split())  # fmt: skip
    assert shown in Text(page).text
    assert shown in "".join(
        child.content
        for token in MarkdownIt("commonmark").enable("table").parse(markdown)
        for child in token.children or []
    )


@given(st.text(max_size=60))
def test_any_text_stays_text(text: str) -> None:
    inline = MarkdownIt("commonmark").parseInline(in_markdown(text))[0].children or []
    assert {token.type for token in inline} <= {"text", "text_special"}
    assert "|" not in in_markdown(text)
    assert {tag for tag, _ in Text(in_html(text)).tags} == {"", "bdi"}


@pytest.mark.parametrize(
    "address",
    [
        "http://example.org/", "javascript:alert(1)", "https://", "https:///x", "//example.org",
        "https://user:secret@example.org/", 'https://example.org/"onclick=', "https://exa mple.org",
        "https://example.org/<b>", "https://b\u00fccher.example/", "HTTPS\n://example.org",
        "https://example.org/" + "x" * 200, "mailto:a@example.org",
    ],
)  # fmt: skip
def test_what_is_no_plain_link_is_none(address: str) -> None:
    assert "<a" not in link(address)


def test_a_plain_link_is_one() -> None:
    address = "https://example.org:8080/a/b.pdf?v=1&w=2#page"
    (tag,) = [a for t, a in Text(link(address)).tags if t == "a"]
    assert tag == {"href": address, "rel": "nofollow noopener"}


# What is on the pages.


def test_the_table_in_markdown_has_ranks_scores_and_flags(board: Path) -> None:
    text = (board / "README.md").read_text()
    (line,) = [row for row in text.splitlines() if "(submissions/ntpp-gmm)" in row]
    score = scores(next(e for e in everyone() if e.id == "ntpp-gmm"))[View()]
    assert line.startswith("| 2\u202f= | [ntpp-gmm](submissions/ntpp-gmm) | learned |  |")
    assert f"| {with_interval(score)} |" in line
    (flagged,) = [row for row in text.splitlines() if "submissions/jittered-blocks" in row]
    assert "(submissions/jittered-blocks) | learned | copied arrivals |" in flagged
    (reference,) = [row for row in text.splitlines() if "submissions/block-replay" in row]
    assert reference.startswith("|  | *[block-replay]")
    assert text.index("submissions/theirs") > text.index("## Listed")


def test_the_page_of_an_entry_has_all_that_is_known(board: Path) -> None:
    entry = next(e for e in everyone() if e.id == "jittered-blocks")
    text = Text((board / "pages" / "jittered-blocks.html").read_text()).text.replace("\xa0", " ")
    for known in (
        *entry.declared.authors, entry.declared.contact, entry.declared.licence, "21,508",
        entry.flags[0].text, *entry.artefacts, *entry.artefacts.values(),
        "30 rollouts in each fold",
        "goal 91.8 %", entry.scenes["gc-v0"].made_from, "at most 0.46 without copying",
        "crowdbench leaderboard verify leaderboard/submissions/jittered-blocks --out verified",
        "Ada Example, Ben Beispiel: jittered-blocks. crowdbench leaderboard, track\nspawn, scorer "
        f"{SCORER} (crowdbench 0.1.0):\noverall {with_interval(scores(entry)[View()])}; eth-v0 ",
    ):  # fmt: skip
        assert known in text
    for scene in entry.scenes.values():
        for metric in scene.metrics.values():
            assert f"{metric.distance:.3f}" in text
            for fits in metric.splits.values():
                shown = [f"{fit:.2f}".replace("-", "−") for fit in fits if fit is not None]
                assert "\u2002".join(shown) in text


def on_gc(entry: Entry, **changes: object) -> Entry:
    """The entry with a changed result in Grand Central."""
    scene = msgspec.structs.replace(entry.scenes["gc-v0"], **changes)
    return msgspec.structs.replace(entry, scenes=entry.scenes | {"gc-v0": scene})


def test_the_gate_says_limit_value_and_the_score_without_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    entry = on_gc(made_up("slow", "walk", 0.5), fails=["speed", "arrivals"], speed_mps=1.0,
                  at_goal=0.9)  # fmt: skip
    without = scores(made_up("slow", "walk", 0.5))[View(scene="gc-v0")]
    assert scores(entry)[View(scene="gc-v0")].value == 0 < without.value
    said = (
        "The policy does not pass the gate: mean speed 1.00 m/s, 24.8 % below that of recorded "
        "people walked (1.33 m/s; limit: 15 %); 90.0 % at goal, which is 90.0 % of the share of "
        "recorded people walked (100.0 %; limit: at least 95 %). Therefore the score is 0.00; "
        f"without the gate, it would be {without.value:.2f}."
    )
    build(put([entry], tmp_path), tmp_path)
    page = Text((tmp_path / "pages" / "slow.html").read_text()).text
    assert page.count("does not pass the gate") == 1
    assert said in page
    print_entry(entry)
    assert f"gc-v0: {said}" in capsys.readouterr().out


def test_a_gate_that_changes_no_score_says_so(tmp_path: Path) -> None:
    entry = on_gc(made_up("slow", "crowd", -0.3), fails=["speed"], speed_mps=1.0)
    score = scores(entry)[View(scene="gc-v0")]
    build(put([entry], tmp_path), tmp_path)
    page = Text((tmp_path / "pages" / "slow.html").read_text()).text
    value = f"{score.value:.2f}".replace("-", "−")
    assert (
        "The gate does not change the score (the mean of crowd and walk): it is "
        f"{value} with and without it."
    ) in page


def test_copied_trips_stand_beside_their_limit(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Where a scene's walkers who cannot copy share more trips, more may be shared."""
    entry = made_up("near", "walk", 0.5, scenes=("eth-v0", "hotel-v0"))
    for name, trips in (("eth-v0", 0.0012), ("hotel-v0", 0.0521)):
        copy = msgspec.structs.replace(entry.scenes[name].copy, trips=trips)
        entry.scenes[name] = msgspec.structs.replace(entry.scenes[name], copy=copy)
    build(put([entry], tmp_path), tmp_path)
    page = (tmp_path / "pages" / "near.html").read_text().replace("\xa0", " ")
    limits = {name: f"{100 * trip_limit(name):.1f} %" for name in entry.scenes}
    assert f"trips 0.1 % (limit {limits['eth-v0']})." in page
    assert f"trips 5.2 % (limit {limits['hotel-v0']})." in page
    assert "copied trips" not in page
    index = (tmp_path / "index.html").read_text().replace("\xa0", " ")
    assert f"5.2 %<small>limit {limits['hotel-v0']}</small></span>" in index
    build(tmp_path)
    (row,) = [
        r for r in (tmp_path / "README.md").read_text().splitlines() if "submissions/near" in r
    ]
    assert row.replace("\xa0", " ").endswith(f"| 5.2 % (limit {limits['hotel-v0']}) |")
    print_entry(entry)
    assert f"5.2 % (limit {limits['hotel-v0']})" in capsys.readouterr().out


def test_rollouts_that_serve_all_folds_are_not_said_to_be_made_in_each(tmp_path: Path) -> None:
    trained = made_up("trained", "walk", 0.5)
    given_once = Trained(data="none", protocol="none", parameters=0)
    once = on_gc(made_up("once", "walk", 0.5, training=given_once), rollouts=1, fits=1)
    crowd = made_up("crowd", "crowd", 0.5)
    build(put([trained, once, crowd], tmp_path), tmp_path)
    texts = {
        name: " ".join(Text((tmp_path / "pages" / f"{name}.html").read_text()).text.split())
        for name in ("trained", "once", "crowd")
    }
    assert "heldout: 30 rollouts in each fold, 5 fits" in texts["trained"]
    assert "heldout: 1 rollout, scored fold by fold, 1 fit" in texts["once"]
    assert "1 rollout in each fold" not in texts["once"]
    assert "Motion and interaction: at most two further rollouts of each fit" in texts["crowd"]
    assert "further rollouts" not in texts["trained"]


@pytest.mark.parametrize("path", entry_paths(ROOT / "entries").values(), ids=lambda p: p.name)
def test_the_persons_of_an_entry_are_those_of_its_rollouts(path: Path) -> None:
    """Who walks the recorded people walks all of them in each rollout, in all folds or once."""
    entry = read_entry(path)
    if entry.declared.track != "walk":
        return
    folds = 3 if entry.declared.training.protocol == "heldout" else 1
    people = {"eth-v0": 360, "hotel-v0": 390, "zara1-v0": 148, "gc-v0": 12_671, "forum-v0": 1160}
    for name, scene in entry.scenes.items():
        assert scene.persons == folds * scene.rollouts * people[name]


def test_earlier_results_are_kept_with_their_reason(board: Path) -> None:
    for page in ("pages/bc.html", "index.html"):
        text = Text((board / page).read_text()).text
        assert "Closest approaches count strangers only." in text
        assert "0.41" in text


def test_bars_lie_on_one_axis_and_point_to_what_lies_beyond() -> None:
    assert f'cx="{NARROW / 4:g}"' in bar(0.0, (-0.1, 0.1), NARROW)
    assert f'cx="{NARROW * 3 / 4:g}"' in bar(1.0, (0.9, 1.1), NARROW)
    beyond = bar(-0.9, (-1.0, -0.6), NARROW)
    assert "circle" not in beyond
    assert "M4 2.5L.5 6L4 9.5" in beyond


@given(st.lists(st.tuples(*[st.floats(-1e6, 1e6, width=32)] * 3), min_size=1, max_size=30))
def test_any_curve_can_be_drawn_inside_its_picture(values: list[tuple[float, ...]]) -> None:
    x, recorded, simulated = (list(column) for column in zip(*values, strict=True))
    curve = Curve(x_label="x (s)", y_label="y", x=sorted(x), recorded=recorded, simulated=simulated)
    svg = figure("Title", curve)
    for name in ("recorded", "simulated"):
        (path,) = re.findall(rf'class="{name}" d="(M[^h"]+)"', svg)
        points = np.array([p.split() for p in path[1:].split("L")], dtype=float)
        assert (points >= -0.1).all()
        assert (points <= [340.1, 200.1]).all()
        assert f">{name}</text>" in svg


def test_shares_that_end_next_to_one_are_drawn_up_to_one() -> None:
    values = [0.0, 0.4, 0.998]
    curve = Curve(x_label="x", y_label="y", x=[0.0, 1.0, 1.99], recorded=values, simulated=values)
    assert figure("Title", curve).count(">1</text>") == 2  # on both axes
    assert ">2</text>" in figure("Title", curve)
    small = msgspec.structs.replace(curve, recorded=[0.0, 0.4, 0.9], simulated=[0.0, 0.4, 0.9])
    assert figure("Title", small).count(">1</text>") == 1


def test_the_workflow_may_read_and_nothing_else() -> None:
    text = (ROOT.parent / ".github" / "workflows" / "leaderboard.yml").read_text()
    said = re.sub(r"^ *#.*$", "", text, flags=re.M)
    assert re.findall(r"^(?:permissions:\n(?:  .*\n)+)", said, flags=re.M) == [
        "permissions:\n  contents: read\n"
    ]
    assert "pull_request_target" not in said
    assert "secrets" not in said
    assert said.count("persist-credentials: false") == said.count("actions/checkout@")
    # What strangers chose is never pasted into a script.
    for script in re.findall(r"run: \|\n((?: {10}.*\n|\n)+)", said):
        assert "${{" not in script


def step(name: str) -> str:
    """The script of a step of the workflow."""
    text = (ROOT.parent / ".github" / "workflows" / "leaderboard.yml").read_text()
    (script,) = re.findall(rf"- name: {name}\n +run: \|\n((?: {{10}}.*\n|\n)+)", text)
    return textwrap.dedent(script)


def git(repository: Path, *arguments: str) -> None:
    who = ("-c", "user.name=A", "-c", "user.email=a@example.org", "-c", "init.defaultBranch=main")
    subprocess.run(["git", *who, *arguments], cwd=repository, check=True, capture_output=True)


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (["leaderboard/submissions/mine/submission.toml"], ""),
        (
            ["leaderboard/submissions/mine/a", "crowdbench/scoring/energy.py"],
            "Other files than those",
        ),
        (["leaderboard/submissions/mine/a", ".github/workflows/leaderboard.yml"], "Other files"),
        (["leaderboard/submissions/mine/a", "leaderboard/entries/mine.json.gz"], "Other files"),
        (["leaderboard/submissions/mine"], "Other files than those"),  # as a link would be
        (["leaderboard/submissions/$(touch ran)/a"], "called by its id"),
        (["leaderboard/submissions/a\nb/c"], "called by its id"),
        (["leaderboard/submissions/-rf/a b", "leaderboard/submissions/mine/\u202e"], ""),
    ],
)
def test_a_pull_request_of_a_submission_changes_nothing_else(
    changed: list[str], told: str, tmp_path: Path
) -> None:
    sent, summary = tmp_path / "sent", tmp_path / "summary"
    sent.mkdir()
    git(sent, "init")
    git(sent, "commit", "--allow-empty", "-m", "before")
    git(sent, "checkout", "-b", "theirs")
    for name in changed:
        (sent / name).parent.mkdir(parents=True, exist_ok=True)
        (sent / name).write_text("x")
    git(sent, "add", "--force", ".")
    git(sent, "commit", "-m", "theirs")
    git(sent, "checkout", "main")
    (sent / "since").write_text("x")  # what the branch has got since is none of theirs
    git(sent, "add", ".")
    git(sent, "commit", "-m", "since")
    git(sent, "merge", "--no-ff", "theirs")
    ran = subprocess.run(
        ["bash", "-e", "-c", step("Nothing but submissions")],
        cwd=tmp_path,
        env=os.environ | {"GITHUB_STEP_SUMMARY": str(summary)},
        capture_output=True,
        text=True,
    )
    assert (ran.returncode, ran.stderr) == (1 if told else 0, "")
    assert told in (summary.read_text() if summary.exists() else "")
    if not told:
        names = {name.split("/")[2] for name in changed}
        assert set((tmp_path / "submissions").read_text().split()) == names
    assert not (tmp_path / "ran").exists()


# In a browser.


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browsing(tmp_path_factory.mktemp("profile")) as one:
        yield one


def names(browser: Browser, track: str) -> list[str]:
    """Of the rows that are shown, in their order."""
    script = (
        f"[...document.querySelectorAll('#{track} table.ranked tbody tr')].filter(r => !r.hidden)"
        ".map(r => r.querySelector('a').textContent)"
    )
    return list(browser.run(script))


def choose(browser: Browser, track: str, what: str, value: str) -> None:
    browser.run(
        f"(() => {{ const s = document.querySelector('#{track} select[name={what}]');"
        f"s.value = '{value}'; s.dispatchEvent(new Event('change', {{bubbles: true}})); }})()"
    )


def column(browser: Browser, track: str, kind: str) -> list[str]:
    """What a column shows."""
    return list(
        browser.run(
            f"[...document.querySelectorAll('#{track} table.ranked tbody tr')]"
            f".filter(r => !r.hidden).map(r => r.querySelector('td.{kind}').innerText.trim())"
        )
    )


def click(browser: Browser, track: str, label: str) -> str:
    """Click on a head; the column's state afterwards."""
    return str(
        browser.run(
            f"(() => {{ const b = [...document.querySelectorAll('#{track} table.ranked button')]"
            f".find(b => b.innerText.trim().startsWith('{label}')); b.click();"
            "return b.closest('th').getAttribute('aria-sort'); })()"
        )
    )


def test_heads_sort_by_their_column(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    by_rank = ["replay-walk", "bc", "gail", "social-force", "straight", "random", "ppo"]
    assert names(browser, "walk") == by_rank
    assert click(browser, "walk", "gc-v0") == "descending"
    entries = {e.id: scores(e) for e in everyone() if e.declared.track == "walk"}
    by_gc = sorted(entries, key=lambda i: -entries[i][View(scene="gc-v0")].value)
    assert names(browser, "walk") == by_gc
    assert click(browser, "walk", "gc-v0") == "ascending"
    assert names(browser, "walk") == by_gc[::-1]
    assert click(browser, "walk", "entry") == "ascending"
    assert names(browser, "walk") == sorted(by_gc)
    assert click(browser, "walk", "overall") == "descending"
    assert names(browser, "walk")[-1] == "ppo"
    assert click(browser, "walk", "overall") == "ascending"
    assert names(browser, "walk")[-1] == "ppo"
    assert click(browser, "walk", "rank") == "ascending"
    assert names(browser, "walk") == by_rank
    assert names(browser, "spawn")[0] == "jittered-blocks"
    assert browser.run("document.querySelectorAll('#walk [aria-sort]').length") == 1


def test_views_show_their_own_scores_ranks_and_order(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    found = standing("spawn", everyone())
    for view in (View("space", "gc-v0"), View("trips"), View("trips", "eth-v0"), View()):
        choose(browser, "spawn", "family", view.family)
        choose(browser, "spawn", "scene", view.scene)
        order = found.ordered(view)
        assert names(browser, "spawn") == [line.entry.id for line in order]
        assert column(browser, "spawn", "rank") == [found.rank(line, view) for line in order]
        shown = [text.split("\n")[0] for text in column(browser, "spawn", "score")]
        expected = [line.scores.get(view) for line in order]
        assert shown == ["–" if s is None else with_interval(s).split()[0] for s in expected]
    assert browser.run("document.querySelector('#spawn th.score').innerText.trim()") == "overall"


def test_filters_leave_who_fits_and_the_references(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    choose(browser, "walk", "kind", "privileged")
    assert names(browser, "walk") == ["replay-walk", "social-force", "straight", "random"]
    assert browser.run("document.querySelector('#walk output').textContent") == "1 of 4 entries"
    choose(browser, "walk", "kind", "")
    choose(browser, "walk", "scene", "forum-v0")
    assert "ppo" not in names(browser, "walk")
    choose(browser, "walk", "scene", "hotel-v0")
    assert names(browser, "walk") == ["social-force"]
    listed = "document.querySelector('#spawn .listed').hidden"
    assert browser.run(listed) is False
    choose(browser, "spawn", "scene", "gc-v0")
    assert browser.run(listed) is True
    choose(browser, "spawn", "scene", "eth-v0")
    assert browser.run(listed) is False


def test_the_keyboard_reaches_and_turns_everything(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    browser.run("document.querySelector('#walk output').focus()")
    reached = []
    for _ in range(60):
        browser.press("Tab", 9)
        reached.append(
            browser.run(
                "(e => `${e.tagName} ${e.name ?? ''}${e.innerText?.trim() ?? ''}`)"
                "(document.activeElement)"
            )
        )
        if reached[-1].startswith("BUTTON gc-v0"):
            break
    assert [r.split("\n")[0][:12] for r in reached if r.startswith("SELECT")] != []
    assert browser.run("getComputedStyle(document.activeElement).outlineStyle") == "solid"
    browser.press("Enter", 13, "\r")
    sorted_by = "document.activeElement.closest('th').getAttribute('aria-sort')"
    assert browser.run(sorted_by) == "descending"
    browser.press(" ", 32, " ")
    assert browser.run(sorted_by) == "ascending"


def test_without_scripts_the_tables_are_complete(board: Path, browser: Browser) -> None:
    browser.ask("Emulation.setScriptExecutionDisabled", value=True)
    try:
        browser.open(board / "index.html")
        shown = browser.run("document.body.innerText")
        assert "filters" in browser.run("document.querySelector('[hidden]').className")
        assert browser.run("document.querySelectorAll('button').length") == 0
    finally:
        browser.ask("Emulation.setScriptExecutionDisabled", value=False)
    for entry in everyone():
        assert entry.declared.name in shown
        for score in (s for v, s in scores(entry).items() if not v.family):
            assert with_interval(score).split()[0] in shown


def test_pages_of_entries_are_linked_and_link_back(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    hrefs = set(browser.run("[...document.querySelectorAll('.name a')].map(a => a.href)"))
    assert hrefs == {p.as_uri() for p in (board / "pages").glob("*.html")}
    browser.open(board / "pages" / "twin.html")
    assert browser.run("document.querySelector('h1').innerText") == "twin"
    back = browser.run("document.querySelector('.kicker a').href")
    assert back == (board / "index.html").as_uri()


@pytest.mark.parametrize("page", ["index.html", "pages/ntpp-gmm.html"])
def test_no_request_leaves_a_page(page: str, board: Path, browser: Browser) -> None:
    browser.open(board / page)
    asked = {r["request"]["url"] for r in browser.said("Network.requestWillBeSent")}
    assert asked == {(board / page).as_uri()}
    # Nor could one, nor run what is no script of the page's: its own policy refuses both.
    for element in (
        "Object.assign(new Image(), {src: 'https://example.org/x'})",
        "Object.assign(document.createElement('script'), {text: 'document.title = 1'})",
    ):
        refused = browser.run(
            "new Promise(r => { addEventListener('securitypolicyviolation', e => "
            f"r(e.effectiveDirective), {{once: true}}); document.body.append({element}); }})"
        )
        assert refused == ("img-src" if "Image" in element else "script-src-elem")


@pytest.mark.parametrize("text", [HOSTILE[0], HOSTILE[7], "n" * 10_000])
def test_hostile_names_do_nothing_in_a_browser(text: str, tmp_path: Path, browser: Browser) -> None:
    names_of = dict(zip(("readme", "index", "page"), pages_of(hostile(text)), strict=True))
    for name in ("index", "page"):
        path = tmp_path / f"{name}.html"
        path.write_text(names_of[name], encoding="utf-8")
        browser.open(path, **PHONE)  # type: ignore[arg-type]
        assert browser.run("document.title") != "ran"
        assert browser.run("document.querySelectorAll('h1').length") == 1
        assert browser.run("document.documentElement.scrollWidth") == 390
        assert text[:40] in browser.run("document.body.textContent")
        assert browser.said("Runtime.exceptionThrown") == []
    assert browser.run("document.querySelector('h1').getBoundingClientRect().height") < 500


@pytest.mark.parametrize("width", [390, 1280])
@pytest.mark.parametrize("page", ["index.html", "pages/ntpp-gmm-bc.html", "pages/bc.html"])
def test_no_page_scrolls_sideways(page: str, width: int, board: Path, browser: Browser) -> None:
    browser.open(board / page, width=width)
    assert browser.run("document.documentElement.scrollWidth") == width
    assert browser.said("Runtime.exceptionThrown") == []


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("page", ["index.html", "pages/bc.html"])
def test_letters_stand_out_in_light_and_dark(
    page: str, scheme: str, board: Path, browser: Browser, tmp_path: Path
) -> None:
    browser.open(board / page, prefers_color_scheme=scheme)
    with Image.open(browser.screenshot(tmp_path / "shot.png")) as image:
        corner = np.mean(image.convert("L").crop((0, 0, 8, 8)))
    assert (corner > 240) if scheme == "light" else (corner < 40)
    for selector in ("h1", ".n", ".i", "a", ".kicker"):
        colours = browser.run(
            f"[getComputedStyle(document.querySelector('{selector}')).color,"
            "getComputedStyle(document.body).backgroundColor]"
        )
        assert contrast(*colours) > 4.5, selector


def contrast(one: str, other: str) -> float:
    """Of two colours (WCAG 2.1)."""

    def luminance(colour: str) -> float:
        rgb = np.array(re.findall(r"\d+", colour)[:3], dtype=float) / 255
        linear = np.where(rgb <= 0.03928, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        return float(linear @ [0.2126, 0.7152, 0.0722])

    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def test_on_paper_the_controls_are_gone(board: Path, browser: Browser) -> None:
    browser.open(board / "index.html")
    browser.ask("Emulation.setEmulatedMedia", media="print")
    shown = browser.run("getComputedStyle(document.querySelector('.filters')).display")
    browser.ask("Emulation.setEmulatedMedia", media="")
    assert shown == "none"


# The table in the repository's README.


@pytest.mark.parametrize("name", ["README.md", "docs/results.md"])
def test_pages_have_the_tables_of_the_entries_that_are_there(name: str) -> None:
    page = (ROOT.parent / name).read_text()
    entries = read_entries(ROOT / "entries")
    assert with_excerpt(page, [standing(track, entries) for track in TRACKS]) == page
    assert (BEGIN if name == "README.md" else PAPER_BEGIN) in page


def test_the_paper_s_metrics_are_shown_for_all_scenes_and_models_scored_or_not() -> None:
    entries = everyone()
    text = paper_metrics([standing(track, entries) for track in TRACKS])
    rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in text.splitlines()[2:]]
    spawn = standing("spawn", entries)
    for scene in SCENES:
        at = [row[0] for row in rows].index(scene)
        assert rows[at][1] == "*recorded*"
        here = rows[at + 1 : at + 1 + len(spawn.lines)]
        assert {row[1] for row in here} == {line.entry.declared.name for line in spawn.lines}
        for row in here:
            (entry,) = (line.entry for line in spawn.lines if line.entry.declared.name == row[1])
            metrics = entry.scenes[scene].metrics
            for k, metric in enumerate(("agents_over_time", "inter_spawn", "dwell")):
                assert float(row[2 + 2 * k]) == pytest.approx(metrics[metric].simulated, rel=0.006)
                assert float(row[3 + 2 * k]) == pytest.approx(metrics[metric].distance, abs=0.0051)


def test_the_table_is_written_between_its_comments_and_nowhere_else(tmp_path: Path) -> None:
    root = put(everyone(), tmp_path / "leaderboard")
    (tmp_path / "README.md").write_text(f"before\n{BEGIN}old\n{END}\nafter\n")
    build(root)
    before, _, after = (tmp_path / "README.md").read_text().partition(BEGIN)
    assert before == "before\n"
    table, _, after = after.partition(END)
    assert after == "\nafter\n"
    rows = table.strip().splitlines()
    assert rows[0].startswith("| track | entry | rank | overall | speed | at goal | eth-v0 |")
    assert "old" not in table
    (tmp_path / "README.md").write_text("no table")
    build(root)
    assert (tmp_path / "README.md").read_text() == "no table"
