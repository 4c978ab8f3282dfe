"""The page about models of other simulators."""

import json
from pathlib import Path

import msgspec
import pytest
from entries import made_up, put

from crowdbench.errors import SettingError
from crowdbench.leaderboard.verification.entry import Entry
from studies import peers

SCENES = peers.SCENES


def external(name: str, level: float, *, fails: bool = False) -> Entry:
    entry = made_up("other", "walk", level, status="external", scenes=SCENES)
    declared = msgspec.structs.replace(entry.declared, name=name)
    of = entry.scenes["gc-v0"]
    if fails:
        of = msgspec.structs.replace(of, fails=["speed"], speed_mps=0.4)
    scenes = entry.scenes | {"gc-v0": of}
    own = name.lower().replace(" ", "-").replace(",", "")
    return msgspec.structs.replace(entry, id=own, declared=declared, scenes=scenes)


@pytest.fixture
def everything(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder of entries: two models, one of them calibrated too, and policies of crowdbench."""
    folder = tmp_path / "entries"
    ours = [made_up("straight", "walk", 0.0, status="reference"), made_up("orca", "walk", 0.1)]
    own = [
        external("Better", 0.4),
        external("Worse", -0.2, fails=True),
        external("Worse, calibrated", 0.6),
    ]
    put([*ours, *own], tmp_path)
    source = tmp_path / "peers"
    source.mkdir()
    counts = dict.fromkeys(("entered", *peers.COUNTS), 3.0)
    (source / "counts.json").write_text(json.dumps({"better": {"eth-v0": counts}}))
    parameters = {"worse": {"eth-v0": {"fold0": {"time_gap": 0.51234}}}}
    told = {"trials": 40, "seconds": {"gc-v0": 267.0}, "parameters": parameters}
    (source / "calibrated.json").write_text(json.dumps(told))
    monkeypatch.setattr(peers, "PEERS", source)
    return folder


def test_the_page_shows_each_model_as_published_and_calibrated(
    everything: Path, tmp_path: Path
) -> None:
    out = tmp_path / "docs" / "peers.md"
    out.parent.mkdir()
    peers.write_page(out, everything)
    text = out.read_text()
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    overview = [row for row in rows if row.count("→") > 1]
    assert [row.split("|")[1].strip() for row in overview] == ["Better", "Worse"]
    gc = 2 + SCENES.index("gc-v0")
    assert "! →" in overview[1].split("|")[gc]  # beyond the gate: at most 0
    assert overview[0].split("|")[gc].strip().endswith("→ –")
    assert "*orca*" in text
    (found,) = [line for line in text.splitlines() if line.startswith("- eth-v0")]
    assert "raises walk of 1 of 1 models" in found
    assert "40 trials" in text
    assert "267 s of Grand Central" in text
    assert "| eth-v0 | fold0 | 0.512 |" in text
    assert "| Better | eth-v0 | 3 |" in text
    assert (tmp_path / "docs/peers/exam.png").stat().st_size > 5000
    nobody = [msgspec.structs.replace(e, exam=None) for e in peers.read_entries(everything)]
    put(nobody, tmp_path)
    peers.write_page(out, everything)
    assert "exam.png" not in out.read_text()


def test_without_other_simulators_it_says_how_to_run_them(tmp_path: Path) -> None:
    put([made_up("orca", "walk", 0.1)], tmp_path)
    with pytest.raises(
        SettingError, match=r"no entry of another simulator.*examples.peers entries"
    ):
        peers.models_of(peers.read_entries(tmp_path / "entries"))
