"""A minute of each entry's crowd: made by its models, and no recording in it."""

import re
from pathlib import Path

import msgspec
import pytest
from entries import made_up
from sites import LEADERBOARD

from crowdbench.errors import WeightsError
from crowdbench.files import write_json
from crowdbench.leaderboard.scores import View
from crowdbench.leaderboard.submission.submission import read_submission
from crowdbench.leaderboard.verification.entry import Flag, entry_paths, read_entry
from crowdbench.report.html.player import Clip
from crowdbench.scene import load_scene
from studies import clips
from studies.clips import Clips, pair_of, read_clips, write_clips
from studies.site import build, players
from studies.site.entry_page import entry_page
from studies.site.headline import headline
from studies.site.standings import Standing, read_entries, standing

ENTRIES = sorted(entry_paths(LEADERBOARD / "entries"))
SUBMITTED = [name for name in ENTRIES if (LEADERBOARD / "submissions" / name).is_dir()]
"""Entries without models of other simulators, which have an environment of their own."""
LARGEST_PAGE = 400_000


def clip(label: str) -> Clip:
    return Clip(start_s=float(len(label)), frames=2, unobserved=[], data="AwA=")


@pytest.mark.parametrize("entry_id", SUBMITTED)
def test_each_entry_ships_clips_of_its_scenes(entry_id: str) -> None:
    entry = read_entry(LEADERBOARD / "entries" / f"{entry_id}.json.gz")
    found = read_clips(entry, LEADERBOARD).scenes
    submission = read_submission(LEADERBOARD / "submissions" / entry_id)
    wanted = [scene for scene in entry.scenes if pair_of(submission, scene)]
    assert list(found) == wanted
    assert bool(wanted) == (entry_id not in ("replay", "block-replay", "random"))
    for scene, each in found.items():
        place = load_scene(scene)
        assert each.frames == round(60 / place.dt_s) + 1


def test_nobody_enters_as_recorded() -> None:
    for entry_id in SUBMITTED:
        submission = read_submission(LEADERBOARD / "submissions" / entry_id)
        for scene in submission.declared.scenes:
            pair = pair_of(submission, scene)
            assert pair is None or pair[0] not in ("replay", "block-replay")


def test_the_same_submission_gives_the_same_clip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "submissions" / "mine"
    folder.mkdir(parents=True)
    text = (LEADERBOARD / "submissions" / "straight" / "submission.toml").read_text()
    (folder / "submission.toml").write_text(re.sub(r"scenes = .*", 'scenes = ["eth-v0"]', text))
    monkeypatch.setattr(clips, "HORIZON_S", 120.0)
    path = write_clips("mine", tmp_path)
    first = path.read_bytes()
    assert list(read_clips(made_up("mine", "walk", 0.5), tmp_path).scenes) == ["eth-v0"]
    assert write_clips("mine", tmp_path).read_bytes() == first


def test_a_broken_file_says_how_to_make_it_again(tmp_path: Path) -> None:
    (tmp_path / "clips").mkdir()
    mine = made_up("mine", "walk", 0.5)
    damaged = msgspec.structs.replace(clip("mine"), data="AAAA")
    (tmp_path / "clips" / "mine.json.gz").write_bytes(b"{}")
    with pytest.raises(WeightsError, match="python -m studies clips mine"):
        read_clips(mine, tmp_path)
    write_json(tmp_path / "clips" / "mine.json.gz", Clips({"eth-v0": damaged}))
    with pytest.raises(WeightsError, match="python -m studies clips mine"):
        read_clips(mine, tmp_path)
    assert read_clips(made_up("yours", "walk", 0.5), tmp_path) == Clips()


def test_nothing_is_shown_of_who_is_flagged_for_copying() -> None:
    orca = read_entry(LEADERBOARD / "entries" / "orca.json.gz")
    assert read_clips(orca, LEADERBOARD).scenes
    flag = Flag(what="copied trips", scene="gc-v0", value=0.5, limit=0.05, text="copied")
    flagged = msgspec.structs.replace(orca, flags=[flag])
    assert read_clips(flagged, LEADERBOARD) == Clips()


def test_a_page_shows_its_entry_beside_the_best_other_and_the_anchor() -> None:
    found = standing("walk", read_entries(LEADERBOARD / "entries"))
    names = {line.entry.id for line in found.lines} - {"replay"}
    shown = {name: Clips({"gc-v0": clip(f"clip of {name}")}) for name in names}
    line = next(line for line in found.lines if line.entry.id == "gail")
    html = entry_page(line, found, shown)
    labels = re.findall(r"<option value=\"\d\"[^>]*>(.*?)</option>", html)
    names = ("gail", "anticipate", "straight")
    assert labels[:3] == [f"{name}, arrivals of cox-plans" for name in names]
    assert "script-src 'sha256-" in html
    assert "script-src" not in entry_page(line, found)


def test_pages_of_entries_are_small_and_complete(tmp_path: Path) -> None:
    build(LEADERBOARD, tmp_path, definitions="../../metrics.html")
    for entry_id in ENTRIES:
        page = (tmp_path / "pages" / f"{entry_id}.html").read_text()
        assert len(page.encode()) <= LARGEST_PAGE
        entry = read_entry(LEADERBOARD / "entries" / f"{entry_id}.json.gz")
        shown = read_clips(entry, LEADERBOARD).scenes
        assert page.count('<figure class="player"') == len(shown)
        assert 'href="../../metrics.html#' in page


def test_each_recorded_scene_has_a_player() -> None:
    found = players(LEADERBOARD)
    assert set(found) == {"eth-v0", "gc-v0", "forum-v0", "hotel-v0", "zara1-v0"}
    assert all("cox-plans + anticipate" in html for html in found.values())


def text_of(found: Standing) -> str:
    return " ".join(re.sub(r"<[^>]*>", "", headline(found)).replace("&nbsp;", " ").split())


def test_the_headline_says_who_leads_and_by_how_much() -> None:
    alone = [made_up("best", "walk", 0.7), made_up("second", "walk", 0.2)]
    found = standing("walk", alone)
    best, second = (line.scores[View()].value for line in found.ordered(View()))
    text = text_of(found)
    begin = f"Overall, best ({best:.2f}) leads. The next: second ({second:.2f}). best is ahead of"
    assert text.startswith(f"{begin} second by {best - second:.2f} (95 % interval ")
    assert text.endswith(f"has a score of 1, which is {1 - best:.2f} more than best has.")
    twins = [msgspec.structs.replace(made_up("twin", "walk", 0.7), id=name) for name in "ab"]
    found = standing("walk", twins)
    (value,) = {line.scores[View()].value for line in found.lines}
    assert text_of(found) == (
        f"Overall, twin ({value:.2f}) and twin ({value:.2f}) share the lead; they do not differ "
        "significantly. The recording itself has a score of 1, which is "
        f"{1 - value:.2f} more than twin has."
    )
    assert text_of(standing("walk", alone[:1])) == ""
