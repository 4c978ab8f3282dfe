"""The report: one page that needs nothing else, on a phone and on a desktop."""

import re
import shutil
import subprocess
from dataclasses import dataclass, field
from html import escape, unescape
from html.parser import HTMLParser
from importlib import import_module
from importlib.util import find_spec
from itertools import pairwise
from pathlib import Path

import msgspec
import pytest
from conftest import need
from PIL import Image

from crowdbench import __version__
from crowdbench.metrics import METRICS
from crowdbench.registry import policy, spawn_model
from crowdbench.report.html import write_report
from crowdbench.report.plots.plot_data import Crowds
from crowdbench.report.text.words import plainly
from crowdbench.run.rollout import rollout
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.ranking import rows
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import SCHEMA, PairResult, Scorecard, read_anchors

ETH = load_scene("eth-v0")
REFERENCE = read_reference(ETH)
EVIL = '<script>alert("&")</script>'
LONG = "a_package.with_a.very_long_module_name:AClassWhoseNameDoesNotFitOnAnyPhoneWhateverItsSize"
SIZES = [(390, 844), (1280, 900)]
UNDRAWN: Crowds = {}
"""No rollouts: pages without pictures, which take longest."""


@pytest.fixture(scope="module")
def crowds() -> Crowds:
    """Two rollouts of two pairs."""
    spawn = spawn_model("poisson-gmm", ETH)
    return {
        ("poisson-gmm", name, seed): rollout(ETH, spawn, policy(name, ETH), seed=seed)
        for name in ("straight", "random")
        for seed in (0, 1)
    }


def card_of(*entries: PairResult, protocol: str = "full", rollouts: int = 30) -> Scorecard:
    """A scorecard of these entries."""
    return Scorecard(
        schema=SCHEMA,
        crowdbench=__version__,
        scene=ETH.id,
        made_from="0123456789abcdef",
        protocol=protocol,  # type: ignore[arg-type]
        horizon_s=ETH.horizon_s,
        blocks=len(REFERENCE.blocks),
        fits=ETH.protocol.fits,
        rollouts=rollouts,
        resamples=RESAMPLES,
        scored=list(ETH.protocol.scored),
        gate=ETH.gate,
        scale=read_anchors(ETH).protocols[protocol],
        entries=list(entries),
    )


def anchor(spawn: str, policy: str, **changes: object) -> PairResult:
    """One of the scene's anchors, as if it had been evaluated; random blocks for other crowds."""
    anchors = {(e.spawn, e.policy): e for e in read_anchors(ETH).protocols["full"].anchors}
    found = anchors.get((spawn, policy), anchors["block-replay", "straight"])
    return msgspec.structs.replace(found, spawn=spawn, policy=policy, **changes)


def unscored(entry: PairResult) -> PairResult:
    metrics = {n: msgspec.structs.replace(m, energy=None) for n, m in entry.metrics.items()}
    return msgspec.structs.replace(entry, metrics=metrics)


@pytest.fixture
def undrawn(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pages with captions and empty pictures."""
    # The package has a function of the name of its module `pictures`.
    module = import_module("crowdbench.report.html.pictures")
    monkeypatch.setattr(module, "picture", lambda draw, **of: b"")


SCORED = card_of(
    anchor("poisson-gmm", "straight"),
    anchor("poisson-gmm", "random"),
    anchor("block-replay", "straight"),
    anchor("replay", "straight"),
    anchor("replay", "random"),
)


def page(card: Scorecard, crowds: Crowds, folder: Path) -> str:
    return write_report(card, ETH, REFERENCE, crowds, folder).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def scored(crowds: Crowds, tmp_path_factory: pytest.TempPathFactory) -> str:
    return page(SCORED, crowds, tmp_path_factory.mktemp("report"))


@dataclass
class Parsed(HTMLParser):
    """Tags with their attributes, and the text of each row of each table."""

    tags: list[tuple[str, dict[str, str | None]]] = field(default_factory=list)
    open_: list[str] = field(default_factory=list)
    rows: list[str] = field(default_factory=list)
    text: str = ""

    def __post_init__(self) -> None:
        HTMLParser.__init__(self)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "path", "circle", "input"):
            self.open_.append(tag)
        if tag == "tr":
            self.rows.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag not in ("path", "circle"):
            assert self.open_.pop() == tag

    def handle_data(self, data: str) -> None:
        if not {"style", "script"} & {*self.open_}:
            self.text += data
        if "tr" in self.open_:
            self.rows[-1] += data.replace("\xa0", " ")


def parsed(html: str) -> Parsed:
    parser = Parsed()
    parser.feed(html)
    parser.close()
    assert parser.open_ == []
    return parser


def row_of(html: str, name: str) -> str:
    (found,) = [row for row in parsed(html).rows if name in row and "[" in row][:1]
    return found


@pytest.mark.long
def test_nothing_is_fetched_from_elsewhere(scored: str) -> None:
    assert re.findall(r"https?://|@import|url\(|<link|fetch\(|import\(", scored) == []
    for tag, attributes in parsed(scored).tags:
        for name in ("src", "href", "srcset", "data"):
            value = attributes.get(name) or "#"
            assert value.startswith(("#", "data:image/")), (tag, value[:60])


def test_sections_that_are_linked_exist(scored: str) -> None:
    tags = parsed(scored).tags
    ids = {a["id"] for _, a in tags if "id" in a}
    assert {str(a["href"])[1:] for t, a in tags if t == "a"} <= ids


def test_pictures_say_in_words_what_they_show(scored: str) -> None:
    alts = [a.get("alt") for tag, a in parsed(scored).tags if tag == "img"]
    assert len(alts) > 12
    assert all(alt and len(alt) > 30 for alt in alts)
    assert len(set(alts)) == len(alts)


def test_flow_and_density_are_measured_where_pedpy_is(scored: str) -> None:
    need(find_spec("pedpy"), "the extra pedpy")
    alts = [str(a.get("alt")) for tag, a in parsed(scored).tags if tag == "img"]
    for name in ("poisson-gmm × straight", "poisson-gmm × random"):
        assert any(re.search(rf"Means: {name} \d\.\d\d m/s", alt) for alt in alts)
        assert any(re.search(rf"{name} \d+ people \(0\.\d+ per metre", alt) for alt in alts)
    said = " ".join(parsed(scored).text.split())
    assert "recorded; not shown, because no recording is imported" in said
    assert "One dot for every 3 frames: Voronoi speed over Voronoi density" in said
    assert "in the square of 4 m² around (3.25, 5.00) m" in said


@pytest.mark.usefixtures("undrawn")
def test_without_pedpy_the_page_says_how_to_get_it(
    crowds: Crowds, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("crowdbench.report.flow.find_spec", lambda name: None)
    html = page(card_of(anchor("poisson-gmm", "straight")), crowds, tmp_path)
    assert re.search(r"Not measured\. flow and density: got no pedpy; .*pip install", html)


def test_table_heads_say_what_they_head(scored: str) -> None:
    heads = [a for tag, a in parsed(scored).tags if tag == "th"]
    assert {a.get("scope") for a in heads} == {"col", "colgroup", "row", "rowgroup"}


def test_headings_follow_each_other(scored: str) -> None:
    levels = [int(tag[1]) for tag, _ in parsed(scored).tags if re.fullmatch("h[1-6]", tag)]
    assert levels.count(1) == 1
    assert all(b <= a + 1 for a, b in pairwise(levels))


def test_each_row_of_the_table_has_its_rank_and_its_scores(scored: str) -> None:
    found = parsed(scored).rows
    for row in rows(SCORED):
        name = re.escape(f"{row.spawn} × {row.policy}")
        (text, *_) = [r for r in found if re.match(rf"(\d\W*)?{name}", r)]
        if row.rank is not None:
            assert text.startswith(str(row.rank))
        for score in (*row.families.values(), row.crowd, row.walk, row.overall):
            if score is not None:
                low, high = score.interval
                assert f"{plainly(score.value)}[{plainly(low)}, {plainly(high)}]" in text


def test_each_metric_has_its_definition_its_distances_and_its_scores(scored: str) -> None:
    found = parsed(scored).rows
    for metric in METRICS:
        for entry in SCORED.entries[:3]:
            if metric.name in entry.metrics:
                (line, *_) = [r for r in found if r.startswith(metric.name.replace("_", " "))]
                assert f"d {entry.metrics[metric.name].distance:.3f}" in line
    (gaps,) = [r for r in found if r.startswith("inter spawnscored")]
    assert "Gaps between consecutive arrivals in the whole scene." in gaps


def test_burstiness_and_memory_are_shown_of_the_crowds_that_were_drawn(scored: str) -> None:
    (line,) = [r for r in parsed(scored).rows if r.startswith("burstiness")]
    # recorded, the two pairs that have rollouts, and the one that has none
    assert re.fullmatch(r".*pictures\.0\.\d\d(−?0\.\d\d){2}–\s*", line)


def test_crowds_that_cannot_be_told_apart_are_marked(tmp_path: Path) -> None:
    same = anchor("poisson-gmm", "straight")
    html = page(card_of(same, msgspec.structs.replace(same, spawn="twin")), UNDRAWN, tmp_path)
    for name in ("poisson-gmm × straight", "twin × straight"):
        assert row_of(html, name).startswith("1\u202f=")
    assert "Rank 1: <b>poisson-gmm × straight</b>" in html
    assert "; <b>twin × straight</b>" in html


def test_without_a_recording_walking_reads_needs_recording(tmp_path: Path) -> None:
    card = card_of(anchor("poisson-gmm", "straight"), anchor("block-replay", "straight"))
    html = page(card, UNDRAWN, tmp_path)
    assert row_of(html, "block-replay × straight").count("needs recording") == 4
    assert "No recording imported." in html
    assert "needs recording" not in row_of(html, "replay × replay")


@pytest.mark.usefixtures("undrawn")
def test_a_single_crowd_without_scores(crowds: Crowds, tmp_path: Path) -> None:
    card = card_of(unscored(anchor("poisson-gmm", "straight")), rollouts=2)
    html = page(card, crowds, tmp_path)
    assert (
        "No ranks: a score needs at least two rollouts for each of the 5 fits, that is, 10 of"
        in html
    )
    (line, *_) = [r for r in parsed(html).rows if "poisson-gmm × straight" in r]
    assert line.count("–") == 5
    assert "d 0." in html


def test_a_scene_without_scored_metrics(tmp_path: Path) -> None:
    card = msgspec.structs.replace(card_of(anchor("poisson-gmm", "straight")), scored=[])
    assert "No metric of this scene is scored yet" in page(card, UNDRAWN, tmp_path)


@pytest.mark.usefixtures("undrawn")
def test_only_recorded_arrivals(crowds: Crowds, tmp_path: Path) -> None:
    replayed = {("replay", "straight", 0): crowds["poisson-gmm", "straight", 0]}
    html = page(card_of(anchor("replay", "straight")), replayed, tmp_path)
    assert "--spawn replay --policy straight" in html
    assert "Policies under the recorded arrivals, by rank (walk)" in html


def test_policies_alone_are_ranked_by_walk_and_sorted_by_it(tmp_path: Path) -> None:
    """Straight walkers have no lower crowd score, and the lower walk score."""
    best = msgspec.structs.replace(anchor("replay", "recorded-paths"), policy="theirs")
    html = page(card_of(anchor("replay", "straight"), best), UNDRAWN, tmp_path)
    (line,) = re.findall("<p>Ranked by <b>walk</b>.*?</p>", html, re.S)
    walk = next(row.walk for row in rows(card_of(best)) if row.policy == "theirs")
    assert walk is not None
    assert f"<b>replay × theirs</b> {plainly(walk.value)} [" in line
    assert row_of(html, "replay × theirs").startswith("1")
    assert row_of(html, "replay × straight").startswith("2")
    assert html.index("× theirs</span><small>") < html.index("× straight</span><small>")
    assert "by overall" not in html


@pytest.mark.parametrize(
    ("entries", "by"),
    [
        ([("poisson-gmm", "random"), ("block-replay", "straight")], "crowd"),
        ([("poisson-gmm", "random"), ("replay", "random")], "overall"),
        ([("replay", "random"), ("replay", "straight")], "walk"),
    ],
    ids=["crowds alone", "crowds and policies", "policies alone"],
)
def test_the_page_names_the_score_that_ranks(
    entries: list[tuple[str, str]], by: str, tmp_path: Path
) -> None:
    html = page(card_of(*(anchor(*pair) for pair in entries)), UNDRAWN, tmp_path)
    assert re.findall("Ranked by <b>(.*?)</b>", html) == [by]
    assert f", by rank ({by})" in html


def test_unranked_crowds_follow_the_ranked_ones(scored: str) -> None:
    names = re.findall(r"<span>(\S*)</span> <span>× (\S*)</span><small>", scored)
    assert names[:3] == [
        ("poisson-gmm", "straight"),
        ("poisson-gmm", "random"),
        ("block-replay", "straight"),
    ]


def test_replays_alone_are_not_said_to_lack_scores(tmp_path: Path) -> None:
    html = page(card_of(anchor("replay", "replay")), UNDRAWN, tmp_path)
    assert "No ranks: replays of the recording are not ranked." in html


def test_each_row_has_the_number_of_its_own_rollouts(scored: str) -> None:
    found = [row for row in parsed(scored).rows if "[" in row]
    for pair, made in (
        ("poisson-gmm × random", "15 rollouts"),
        ("replay × random", "8 rollouts"),
        ("replay × straight", "1 rollout"),
    ):
        (row, *_) = [row for row in found if re.match(rf"(\d\W*)?{pair}", row)]
        assert row.partition(pair)[2].startswith(made)
    assert "1 to 15 rollouts of each pair" in " ".join(scored.split())
    assert "15 of each crowd" not in scored


def test_the_gate_says_limit_value_and_the_score_without_it(scored: str, tmp_path: Path) -> None:
    assert "The gate does not change walk: it is −1.00 with and without it." in scored
    runner = msgspec.structs.replace(
        anchor("replay", "recorded-paths"), policy="<runner>", speed_mps=2.0
    )
    html = page(card_of(anchor("poisson-gmm", "straight"), runner), UNDRAWN, tmp_path)
    said = "&lt;runner&gt; does not pass the gate: mean speed 2.00 m/s"
    assert said in html
    assert re.search(
        r"limit: 15 %\)\. Therefore walk is 0\.00; without the gate, it would be 0\.9", html
    )


def test_the_command_asks_for_what_was_asked_for(scored: str) -> None:
    wanted = (
        "crowdbench evaluate eth-v0 --spawn poisson-gmm block-replay --policy straight random "
        "--protocol full --seeds 30"
    )
    assert wanted in unescape(scored)


@pytest.mark.usefixtures("undrawn")
def test_held_out_blocks_are_shown_in_the_first_fold(crowds: Crowds, tmp_path: Path) -> None:
    heldout = card_of(anchor("poisson-gmm", "straight"), protocol="heldout")
    html = page(heldout, crowds, tmp_path)
    assert "of the first fold, in its time blocks" in html
    assert "three interleaved folds" in html


@pytest.mark.usefixtures("undrawn")
def test_names_are_escaped(crowds: Crowds, tmp_path: Path) -> None:
    evil = msgspec.structs.replace(anchor("poisson-gmm", "straight"), spawn=EVIL, policy="<b>&")
    drawn = {(EVIL, "<b>&", 0): crowds["poisson-gmm", "straight", 0]}
    html = page(card_of(evil), drawn, tmp_path)
    found = parsed(html)
    scripts = [attributes for tag, attributes in found.tags if tag == "script"]
    assert scripts == [{"type": "application/json"}, {}]  # the clips, and the player
    assert f"{EVIL} × <b>&" in found.text
    assert any(EVIL in str(a.get("alt")) for tag, a in found.tags if tag == "img")


def test_the_same_evaluation_gives_the_same_bytes(
    scored: str, crowds: Crowds, tmp_path: Path
) -> None:
    assert page(SCORED, crowds, tmp_path) == scored


def test_the_page_is_no_larger_than_a_photograph(scored: str) -> None:
    assert len(scored.encode()) < 3e6


def browse(html: Path, *asked: str, size: tuple[int, int]) -> str:
    """What headless Chromium answers."""
    browser = shutil.which("chromium")
    need(browser, "chromium")
    command = [
        str(browser), "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic",
        "--no-first-run", "--disable-background-networking", "--disable-component-update",
        "--disable-sync", f"--user-data-dir={html.parent / 'profile'}", "--hide-scrollbars",
        f"--window-size={size[0]},{size[1]}", *asked, html.as_uri(),
    ]  # fmt: skip
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=True)
    return done.stdout


@pytest.fixture(scope="module")
def long_names(crowds: Crowds, tmp_path_factory: pytest.TempPathFactory) -> str:
    """A page whose names do not fit."""
    entry = msgspec.structs.replace(anchor("poisson-gmm", "straight"), spawn=LONG, policy=LONG)
    drawn = {(LONG, LONG, seed): crowds["poisson-gmm", "straight", seed] for seed in (0, 1)}
    return page(
        card_of(entry, anchor("replay", "straight")), drawn, tmp_path_factory.mktemp("long")
    )


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}px")
@pytest.mark.parametrize("which", ["scored", "long_names"])
def test_the_page_does_not_scroll_sideways(
    which: str, size: tuple[int, int], request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    html: str = request.getfixturevalue(which)
    # A frame, because the browser's own window is never narrower than 500 px.
    wrapper = tmp_path / "wrapper.html"
    wrapper.write_text(
        f'<!doctype html><meta charset="utf-8"><title></title><iframe width="{size[0]}" '
        f'height="{size[1]}" style="border: 0" srcdoc="{escape(html)}"></iframe><script>'
        "onload = () => { const page = frames[0].document.documentElement;"
        "document.title = `${page.scrollWidth} of ${frames[0].innerWidth}`; }</script>",
        encoding="utf-8",
    )
    dom = browse(wrapper, "--dump-dom", size=SIZES[-1])
    (title,) = re.findall("<head>.*?<title>(.*?)</title>", dom, flags=re.S)[:1]
    assert title == f"{size[0]} of {size[0]}"


@pytest.mark.parametrize("size", SIZES, ids=lambda s: f"{s[0]}px")
def test_the_page_can_be_looked_at(scored: str, size: tuple[int, int], tmp_path: Path) -> None:
    (tmp_path / "report.html").write_text(scored, encoding="utf-8")
    shot = tmp_path / "shot.png"
    browse(tmp_path / "report.html", f"--screenshot={shot}", size=size)
    with Image.open(shot) as image:
        assert image.size == size
        colours = image.convert("RGB").getcolors(maxcolors=2**24)
    assert colours is not None
    assert len(colours) > 50
    assert max(count for count, _ in colours) < 0.95 * size[0] * size[1]
