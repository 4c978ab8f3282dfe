"""What is on the leaderboard's pages, and that what others wrote stays text there."""

import itertools
import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from entries import everyone, made_up, put
from hypothesis import given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from sites import HOSTILE, LEADERBOARD, Text, built, hostile, pages_of

from crowdbench.cli.leaderboard import print_entry
from crowdbench.leaderboard.scores import View, scores
from crowdbench.leaderboard.submission.schema import Trained
from crowdbench.leaderboard.verification.entry import SCORER, Curve, Entry, entry_paths, read_entry
from crowdbench.leaderboard.verification.flags import trip_limit
from crowdbench.report.text.words import with_interval
from studies.site import build
from studies.site.axis import NARROW, bar
from studies.site.curves import figure
from studies.site.text import in_html, in_markdown, link


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("leaderboard"))


# Text stays text.

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
                r"((pages/|\.\./docs/)?[\w-]+\.(html|md)(#[\w-]+)?|submissions/[\w-]+)",
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


def test_the_page_of_an_entry_names_the_tests_that_its_policy_passes(tmp_path: Path) -> None:
    entries = [made_up("walker", "walk", 0.5), made_up("model", "spawn", 0.5)]
    build(put(entries, tmp_path), tmp_path)
    page = (tmp_path / "pages" / "walker.html").read_text()
    assert "Passed (2)" in page
    assert "Walking speed in a corridor (RiMEA 1); Flow through a door (ISO 20414 11)" in page
    assert "Failed (1)" in page
    assert "engineers’ guidelines" not in (tmp_path / "pages" / "model.html").read_text()
    index = (tmp_path / "index.html").read_text()
    assert "2 of 3" in index
    assert index.count("<span>exam</span>") == 1  # on track walk, where somebody was examined


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
    # Nothing is fitted to recorded arrivals.
    assert re.search(
        r"heldout: 30 rollouts, scored fold by fold, [\d,]+ simulated", texts["trained"]
    )
    assert re.search(r"heldout: 1 rollout, scored fold by fold, [\d,]+ simulated", texts["once"])
    assert "1 rollout in each fold" not in texts["once"]
    assert "heldout: 30 rollouts in each fold, 5 fits" in texts["crowd"]
    assert "Motion and interaction: further rollouts of the recorded people" in texts["crowd"]
    assert "further rollouts" not in texts["trained"]


@pytest.mark.parametrize(
    "path", entry_paths(LEADERBOARD / "entries").values(), ids=lambda p: p.name
)
def test_the_persons_of_an_entry_are_those_of_its_rollouts(path: Path) -> None:
    """Who walks the recorded people walks all of them in each rollout, which serves all folds.

    Models of other simulators with calibrated parameters walk once for each fold.
    """
    entry = read_entry(path)
    if entry.declared.track != "walk":
        return
    people = {"eth-v0": 360, "hotel-v0": 390, "zara1-v0": 148, "gc-v0": 12_671, "forum-v0": 1160}
    times = 3 if entry.id.endswith("-calibrated") else 1
    for name, scene in entry.scenes.items():
        everyone = times * scene.rollouts * people[name]
        # Who enters elsewhere than in the recording may find the place taken for too long.
        assert scene.persons == pytest.approx(everyone, rel=1e-4 * (entry.status == "ranked"))


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
