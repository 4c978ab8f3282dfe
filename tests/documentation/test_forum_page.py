"""The page on other days of the Forum: its command, on an hour published as another day."""

import io
import re
import shlex
import zipfile
from pathlib import Path

import pages
import pytest
from servers import serving

from crowdbench.cli import main
from crowdbench.data.recordings import catalogue
from crowdbench.data.recordings.catalogue import SOURCES
from crowdbench.registry import recording_of
from crowdbench.scene import load_scene
from crowdbench.scoring import power
from crowdbench.scoring.scorecard import read_anchors

pytestmark = pytest.mark.long

FPS = 9
HOURS = (4, 5)


def another_day(text: str) -> str:
    """Those who come and go within some hours of a day's file, as if the day began with these."""
    begin, end = (hour * 3600 * FPS for hour in HOURS)
    tracks = []
    for number, body in re.findall(r"TRACK\.R(\d+)=\[(.*)\];", text):
        rows = [[int(value) for value in row.split()] for row in re.findall(r"\[([^\]]+)", body)]
        if begin <= rows[0][2] and rows[-1][2] < end:
            points = ";".join(f"[{x} {y} {t - begin}]" for x, y, t in rows)
            times = f"{len(rows)} {rows[0][2] - begin} {rows[-1][2] - begin}"
            tracks.append(f"Properties.R{number}=[{times} ];\n TRACK.R{number}=[{points}];\n")
    return f"% Total number of trajectories in file are  {len(tracks)} \n" + "\n".join(tracks)


@pytest.mark.nightly
@pytest.mark.usefixtures("no_report", "unadjusted", "brief_networks")
def test_a_scene_of_another_day_is_made_by_the_command_of_the_page(
    tmp_path: Path,
    home: Path,
    opentraj: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(power, "SYNTHETIC", 10)
    zipped = io.BytesIO()
    with zipfile.ZipFile(zipped, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("tracks", another_day((opentraj / SOURCES["forum"].path).read_text()))
    (block,) = pages.blocks((pages.ROOT / "docs/forum.md").read_text(), "sh")
    command = block.strip().replace("\\\n", "")
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    # Fewer fits and rollouts than a benchmark needs, for the test's sake.
    brief = "--fits 1 --rollouts-per-fit 2 --workers 1"
    with serving() as published:
        published.files["/Jul.14.zip"] = zipped.getvalue()
        monkeypatch.setattr(catalogue, "_FORUM_DAYS", published.address)
        assert main(shlex.split(f"{command} {brief}")[1:]) == 0
    said = capsys.readouterr().out
    assert "stored at first use; the publisher states none" in said
    assert "Cite: " in said
    folder = Path("forum14jul-v0")
    made, known = load_scene(folder), load_scene("forum-v0")
    assert made.title == "Informatics Forum, Edinburgh, 14 July"
    assert made.recording.name == "forum-14jul"
    assert made.recording.frames == recording_of(made).frames < 8100
    assert (made.bounds, made.walls, made.walking) == (known.bounds, known.walls, known.walking)
    assert (made.protocol.fits, made.protocol.rollouts_per_fit) == (1, 2)
    assert set(made.protocol.scored) != set(known.protocol.scored)
    assert set(read_anchors(made).protocols) == {"full", "heldout"}
    evaluate = "crowdbench evaluate ./forum14jul-v0 --policy straight --spawn renewal-gmm --seeds 1"
    assert main(shlex.split(evaluate)[1:]) == 0


def test_options_that_the_other_scene_determines_are_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    like = ["scene", "create", "day-v0", "--recording", "forum-14jul", "--like", "forum-v0"]
    assert main([*like, "--dt-s", "0.4"]) == 2
    assert "--like without --dt-s" in capsys.readouterr().err
    assert main(["scene", "create", "day-v0", "--recording", "here.csv"]) == 2
    assert "neither --format nor --like" in capsys.readouterr().err
