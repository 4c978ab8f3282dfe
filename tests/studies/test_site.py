"""The leaderboard's files: made of entries alone, complete, and none of a broken entry."""

import re
from pathlib import Path

import msgspec
import numpy as np
import pytest
from entries import everyone, made_up, put
from sites import LEADERBOARD, Text, built

from crowdbench.errors import SettingError, WeightsError
from crowdbench.leaderboard.submission.schema import SCENES
from crowdbench.leaderboard.verification.entry import (
    Curve,
    Entry,
    ExamEntry,
    Flag,
    ScoreCard,
    entry_paths,
    read_entry,
)
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.scorecard import pack
from studies.__main__ import main as studies_main
from studies.site import build
from studies.site.excerpt import BEGIN, END, PAPER_BEGIN, paper_metrics, with_excerpt
from studies.site.standings import TRACKS, read_entries, standing


@pytest.fixture(scope="module")
def board(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return built(tmp_path_factory.mktemp("leaderboard"))


def contents(root: Path) -> dict[str, bytes]:
    put_there = ("RULES.md",)
    made = (p for p in root.rglob("*") if p.is_file() and p.suffix != ".gz")
    made = (p for p in made if p.name not in put_there)
    return {str(p.relative_to(root)): p.read_bytes() for p in made}


def test_the_same_entries_give_the_same_bytes(board: Path, tmp_path: Path) -> None:
    build(put(list(reversed(everyone())), tmp_path))
    build(tmp_path, tmp_path)
    assert contents(tmp_path) == contents(board)


def test_what_is_committed_is_what_its_entries_make(tmp_path: Path) -> None:
    entries = entry_paths(LEADERBOARD / "entries").values()
    put([], tmp_path)
    for path in entries:
        (tmp_path / "entries" / path.name).write_bytes(path.read_bytes())
    build(tmp_path)
    made = contents(tmp_path)
    assert made == {name: (LEADERBOARD / name).read_bytes() for name in made}


def test_links_of_what_is_committed_lead_somewhere() -> None:
    assert dead_links(LEADERBOARD / "index.html") == []
    tables = [
        (LEADERBOARD / "README.md").read_text(),
        (LEADERBOARD.parent / "README.md").read_text(),
    ]
    links = [
        link
        for text in tables
        for link in re.findall(r"\((?:leaderboard/)?(submissions/.*?)\)", text)
    ]
    assert links
    assert [link for link in links if not (LEADERBOARD / link / "submission.toml").is_file()] == []


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
    bc = read_entry(LEADERBOARD / "entries" / "bc.json.gz")
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
    shipped = set(entry_paths(LEADERBOARD / "entries"))
    assert {path.stem for path in (preview / "pages").glob("*.html")} == {
        *shipped, "newcomer", "lone",
    }  # fmt: skip
    assert ranks["newcomer"] == ranks["bc"]
    assert ranks["bc"].strip()
    marked = [row for row in rows if "(yours)" in row]
    assert [re.split(r"[][]", row)[1] for row in marked] == ["newcomer", "lone"]
    assert (preview / "index.html").read_text().count('<span class="yours">') == 3  # and the head
    assert "(yours)" not in (LEADERBOARD / "README.md").read_text()
    assert ">yours<" not in (LEADERBOARD / "index.html").read_text()


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
    assert (preview / "pages" / "RULES.md").read_text() == (LEADERBOARD / "RULES.md").read_text()
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
NOTHING = ScoreCard(value=0.0, resampled=pack(0.0, np.zeros(RESAMPLES)))
NO_NUMBER = ScoreCard(value=0.0, resampled=np.float32(np.nan).tobytes() + bytes(2 * RESAMPLES))
HUGE = Curve(x_label="x", y_label="y", x=[0.0, 1.7e308], recorded=[0.0, 1.0], simulated=[0.0, 1.0])
LONG = Curve(x_label="x", y_label="y", **dict.fromkeys(("x", "recorded", "simulated"), [0.0] * 101))  # type: ignore[arg-type]
SPEED = ONE.scenes["eth-v0"].metrics["speed"]
FLAG = Flag(what="too good", scene="eth-v0", value=2.0, limit=1.0, text="It is.")
EXAM = ExamEntry(scene="eth-v0", body_radius_m=0.15, passed=["door"], failed=["rimea-9"])
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
    "an exam of another scene": (msgspec.structs.replace(
        ONE, exam=msgspec.structs.replace(EXAM, scene="zara1-v0")), "of an exam, 'zara1-v0'"),
    "a test passed and failed": (msgspec.structs.replace(
        ONE, exam=msgspec.structs.replace(EXAM, failed=EXAM.passed)), "each test once"),
    "a test with a long name": (msgspec.structs.replace(
        ONE, exam=msgspec.structs.replace(EXAM, failed=["x" * 999])), "matching regex"),
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


# The table in the repository's README.


@pytest.mark.parametrize("name", ["README.md", "docs/results.md"])
def test_pages_have_the_tables_of_the_entries_that_are_there(name: str) -> None:
    page = (LEADERBOARD.parent / name).read_text()
    entries = read_entries(LEADERBOARD / "entries")
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
