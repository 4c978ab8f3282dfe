"""Scores for other programs: `--json` of `evaluate` and `score`, and scores of foreign rollouts."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from crowdbench import rollout, score, score_rollouts, write_parquet
from crowdbench.cli import main
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SettingError
from crowdbench.scene import load_scene
from crowdbench.scoring.ranking import score_rows
from crowdbench.spawn.areas import read_areas

KEYS = {
    *("spawn", "policy", "protocol", "kind", "families", "crowd", "walk", "overall", "rank"),
    *("rollouts", "distances", "mean_speed_mps", "at_goal", "gate"),
}
CROWD = ("arrivals", "presence", "trips", "space")


@pytest.fixture(scope="module")
def crowds() -> list[Trajectories]:
    return [rollout("plaza-v0", "poisson-gmm", "straight", seed=k) for k in (5, 6)]


@pytest.fixture(scope="module")
def files(crowds: list[Trajectories], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("crowds")
    paths = [folder / f"{k}.parquet" for k in range(len(crowds))]
    for path, crowd in zip(paths, crowds, strict=True):
        write_parquet(crowd, path)
    return paths


def printed(arguments: list[str], capsys: pytest.CaptureFixture[str]) -> list[dict[str, Any]]:
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["ranked_by"] in ("crowd", "walk", "overall")
    rows: list[dict[str, Any]] = found["rows"]
    assert all(set(row) == KEYS for row in rows)
    return rows


def test_several_rollouts_are_scored_beside_the_anchors(
    files: list[Path], crowds: list[Trajectories], capsys: pytest.CaptureFixture[str]
) -> None:
    rows = printed(["score", "plaza-v0", *map(str, files), "--json", "-"], capsys)
    mine, *others = rows
    assert (mine["spawn"], mine["policy"], mine["kind"]) == ("trajectories",) * 2 + ("entry",)
    assert {row["kind"] for row in others} == {"baseline"}
    assert set(CROWD) <= set(mine["families"])
    assert mine["rollouts"] == 2
    assert mine["walk"] is None  # people did not enter as recorded
    low, high = mine["crowd"]["interval"]
    assert low <= mine["crowd"]["score"] <= high
    assert mine["crowd"]["score"] == pytest.approx(0, abs=0.2)  # it is the anchor's model
    alone = [score("plaza-v0", crowd) for crowd in crowds]
    for name, found in mine["distances"].items():
        assert found == pytest.approx(np.mean([each[name].distance for each in alone]))
    # Ways are equally long for slow and fast people, who are there for as long as they walk.
    speeds = read_areas(load_scene("plaza-v0")).speed_quantiles
    assert mine["mean_speed_mps"] == pytest.approx(1 / np.mean(1 / speeds), abs=0.03)
    assert 0.9 < mine["at_goal"] <= 1
    assert mine["gate"] == []


def test_one_rollout_has_distances_and_no_score(
    files: list[Path], capsys: pytest.CaptureFixture[str]
) -> None:
    mine, *_ = printed(["score", "plaza-v0", str(files[0]), "--json", "-"], capsys)
    assert mine["crowd"] is None
    assert mine["families"] == {}
    assert mine["distances"]["inter_spawn"] > 0


def test_a_file_gets_the_same_and_the_tables_are_printed(
    files: list[Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ["score", "plaza-v0", *map(str, files)]
    rows = printed([*asked, "--json", "-"], capsys)
    assert main([*asked, "--json", str(tmp_path / "found.json")]) == 0
    assert "trajectories × trajectories" in capsys.readouterr().out
    assert json.loads((tmp_path / "found.json").read_text())["rows"] == rows


def test_recorded_arrivals_are_scored_by_how_people_walk() -> None:
    crowds = [rollout("plaza-v0", "replay", "random", seed=k) for k in (1, 2)]
    card = score_rollouts("plaza-v0", crowds, recorded_arrivals=True)
    mine, *_ = score_rows(card)["rows"]
    assert mine["spawn"] == "replay"
    assert {"motion", "interaction"} <= set(mine["families"])
    anchor = next(r for r in score_rows(card)["rows"][1:] if r["policy"] == "random")
    assert mine["walk"]["score"] == pytest.approx(anchor["walk"]["score"], abs=0.1)


def test_crowds_that_do_not_fit_are_rejected(crowds: list[Trajectories]) -> None:
    with pytest.raises(SettingError, match="one or more rollouts"):
        score_rollouts("plaza-v0", [])
    with pytest.raises(RecordingError, match="crowd scored on eth-v0"):
        score_rollouts("eth-v0", crowds)


@pytest.mark.long
@pytest.mark.usefixtures("no_report")
def test_an_evaluation_of_policies_alone_ranks_them_by_walk(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("mine.py").write_text(
        "import crowdbench.policies\n\n\nclass Slow(crowdbench.policies.SocialForce):\n"
        "    name = 'slow'\n"
    )
    policies = ["straight", "social-force", "mine:Slow"]
    asked = ["evaluate", "plaza-v0", "--spawn", "replay", "--policy", *policies]
    rows = printed([*asked, "--seeds", "2", "--workers", "1", "--out", "x", "--json", "-"], capsys)
    mine = {row["policy"]: row for row in rows if row["kind"] == "entry"}
    assert list(mine) == policies
    assert mine["social-force"]["rank"] == mine["mine:Slow"]["rank"] == 1
    assert mine["straight"]["rank"] == 3
    assert mine["straight"]["walk"]["score"] == pytest.approx(0, abs=1e-12)
