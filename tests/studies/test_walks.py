"""The page on how policies walk: everyone under the recorded arrivals, and their pictures."""

import re
from pathlib import Path

import msgspec
import pages
import pytest

from crowdbench.errors import RecordingError, SettingError
from crowdbench.registry import import_recording, recording_of
from crowdbench.report.plots.plot_data import Group, PlotData
from crowdbench.scene import load_scene
from crowdbench.scoring.energy import RESAMPLES
from crowdbench.scoring.reference import read_reference
from crowdbench.scoring.scorecard import SCHEMA, Scorecard, read_anchors
from studies import walks
from studies.__main__ import main as studies_main
from studies.walks import RecordedPaths, pictures, write_walks
from studies.walks.page import Walked, scores

pytestmark = pytest.mark.long

PLAZA = load_scene("plaza-v0")
ORCA = "crowdbench.baselines.orca:ORCA"  # as asked for; shown as `orca`


def section(text: str, title: str) -> list[list[str]]:
    """The cells of the table under a heading."""
    (body,) = re.findall(rf"### {re.escape(title)}\n\n((?:\|.*\n)+)", text)
    return [[cell.strip() for cell in line.split("|")[1:-1]] for line in body.strip().split("\n")]


def test_the_command_of_the_page_on_the_plaza(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # One test, since workers that share its parts would each make all rollouts. Two rollouts
    # suffice for scores under the recorded arrivals.
    monkeypatch.setattr(walks, "FEW", 1)
    import_recording("plaza")  # once: else it is generated wherever it is looked at
    monkeypatch.chdir(tmp_path)
    asked = pages.arguments("docs/walks.md", "python -m studies walks")
    assert studies_main(["walks", *asked, "--seeds", "2", "--workers", "1"]) == 0
    text = Path("docs/walks.md").read_text()
    head, _, *lines = section(text, "Scores, held out")
    assert head[:6] == ["policy", "sees", "rank", "walk", "motion", "interaction"]
    of = {line[0]: line for line in lines}
    assert set(of) == {"random", "straight", "social-force", "orca"}
    assert of["straight"][3] == "0.00 [0.00, 0.00]"
    assert of["social-force"][1:3] == ["state", "1"]
    assert of["orca"][1] == "state"
    assert "No scores" not in text
    head, _, *lines = section(text, "Distances, held out")
    assert head[-4:] == ["random", "straight", "social-force", "orca"]
    assert {line[0] for line in lines} == {"trips", "motion", "interaction"}
    (dwell,) = (line for line in lines if line[1] == "dwell")
    assert float(dwell[-3].split(" ")[0]) < 0.1
    head, _, *lines = section(text, "Do they arrive?")
    assert head[1] == "at goal (recorded)"
    assert head[4] == "at goal (ntpp-gmm)"
    of = {line[0]: line for line in lines}
    assert float(of["straight"][1].rstrip(" %")) > 99
    assert float(of["random"][4].rstrip(" %")) < 5
    assert "shows what a perfect walker scores" in re.sub(r"\s+", " ", text)
    linked = re.findall(r"!\[[^]]+\]\(([^)]+)\)", text)
    assert linked == ["walks/plaza-v0-dwell.png"]
    for name in linked:
        assert Path("docs", name).read_bytes().startswith(b"\x89PNG")
    assert f"python -m studies walks plaza-v0 --policy {ORCA} --seeds 2" in text


def test_where_nobody_has_a_score_the_page_has_no_table_but_says_why() -> None:
    scale = read_anchors(PLAZA).protocols["full"]
    walkers = [e for e in scale.anchors if e.spawn == "replay" and e.policy != "replay"]
    entries = [
        msgspec.structs.replace(
            e, metrics={n: msgspec.structs.replace(m, energy=None) for n, m in e.metrics.items()}
        )
        for e in walkers
    ]
    card = Scorecard(
        schema=SCHEMA, crowdbench="0", scene=PLAZA.id, made_from="", protocol="full",
        horizon_s=PLAZA.horizon_s, blocks=30, fits=5, rollouts=1, resamples=RESAMPLES,
        scored=list(PLAZA.protocol.scored), gate=PLAZA.gate, scale=scale, entries=entries,
    )  # fmt: skip
    names = {e.policy: e.policy for e in entries}
    walked = Walked(PLAZA, names, dict.fromkeys(names, "state"), card, card, {}, {})
    assert scores(walked, card) == (
        "No scores: straight, recorded-paths, random. Rollouts of each policy: 1. Scores need two."
    )


def test_recorded_paths_end_at_their_goals() -> None:
    crowd = recording_of(PLAZA)
    assert RecordedPaths(crowd).name != "replay"  # which rollouts let walk on


def test_what_is_missing_is_said_before_anything_is_walked(tmp_path: Path, capsys) -> None:
    with pytest.raises(SettingError, match="no scene"):
        write_walks([], out=tmp_path)
    with pytest.raises(RecordingError, match="data fetch eth"):
        write_walks(["eth-v0"], out=tmp_path)
    assert studies_main(["walks", "eth-v0", "--out", str(tmp_path)]) == 2
    assert "data fetch eth" in capsys.readouterr().err
    with pytest.raises(SettingError, match="got 0; expected a multiple of 5"):
        write_walks(["plaza-v0"], out=tmp_path / "docs", work=tmp_path / "work", seeds=0)
    assert not list(tmp_path.iterdir())


def test_each_policy_is_drawn_in_its_own_style(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Also where there are more policies than colours."""
    scene = load_scene("plaza-v0")
    groups = [Group("replay", f"p{k}", "", (), [], "") for k in range(10)]
    drawn = []
    monkeypatch.setattr(
        pictures.PlotData,
        "of",
        lambda scene, reference, *_: PlotData(scene, reference, "full", groups),
    )
    monkeypatch.setattr(pictures, "draw_figure", lambda name, plot, *_, **__: drawn.append(plot))
    names = {group.policy: group.policy for group in groups}
    pictures.draw_dwell(scene, read_reference(scene), {}, names, tmp_path)
    styles = {(group.colour, group.dashes) for group in drawn[0].groups}
    assert len(styles) == len(groups)
    assert [group.label for group in drawn[0].groups] == list(names)
