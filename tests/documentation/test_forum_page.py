"""The page on other days of the Forum: its commands, on an hour published as another day."""

import io
import re
import shlex
import subprocess
import zipfile
from pathlib import Path

import pages
import pytest
from servers import serving

from crowdbench.cli import main
from crowdbench.recordings import catalogue
from crowdbench.recordings.catalogue import SOURCES
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


def test_a_scene_of_another_day_is_made_by_the_commands_of_the_page(
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
    copying = block[block.index("mkdir") : block.index("crowdbench fit")]
    fetching, *making = (line for line in block.splitlines() if line.startswith("crowdbench"))

    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    with serving() as published:
        published.files["/Jul.14.zip"] = zipped.getvalue()
        monkeypatch.setattr(catalogue, "_FORUM_DAYS", published.address)
        assert main(shlex.split(fetching)[1:]) == 0
    here = copying.replace("path/to/crowdbench", shlex.quote(str(pages.ROOT)))
    subprocess.run(["bash", "-euc", here], check=True)
    scene = Path("forum14jul-v0/scene.toml")
    assert load_scene(scene.parent).title == "Informatics Forum, Edinburgh, 14 July"
    assert " 1 July" not in scene.read_text()

    fit = [*shlex.split(making[0])[1:], "--models", "poisson-gmm", "renewal-gmm"]
    capsys.readouterr()
    assert main(fit) == 2
    said = re.search(r"expected recording\.(frames = \d+), recording\.(dwell_p99_s = [\d.]+), as",
                     capsys.readouterr().err)  # fmt: skip
    assert said is not None
    text = scene.read_text()
    for line in said.groups():
        text = re.sub(rf"^{line.split()[0]} = .*", line, text, flags=re.MULTILINE)
    # Fewer rollouts than a benchmark needs, for the test's sake.
    scene.write_text(text.replace("fits = 5", "fits = 1").replace("_fit = 6", "_fit = 2"))
    evaluate = "crowdbench evaluate ./forum14jul-v0 --policy straight --spawn renewal-gmm --seeds 1"
    for command in (shlex.join(["crowdbench", *fit]), *making[1:], evaluate):
        assert main(shlex.split(command)[1:]) == 0, f"{command}: {capsys.readouterr().err}"
    made = load_scene(scene.parent)
    assert set(made.protocol.scored) != set(load_scene("forum-v0").protocol.scored)
    assert set(read_anchors(made).protocols) == {"full", "heldout"}
