"""`python -m studies figures`: each figure is drawn, and its numbers say what the rollouts do."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest

from crowdbench.data.storage import read_own
from crowdbench.errors import CrowdbenchError, RecordingError, SettingError
from crowdbench.registry import import_recording, recording_of
from crowdbench.report.plots.panels import CELL_M
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference
from crowdbench.spawn.areas import Gaussians, read_areas
from studies import figures
from studies.__main__ import main as studies_main
from studies.figures import FIGURES, with_areas, write_figures
from studies.figures.flows import DENSITY_PARTS, density, draw_flows
from studies.figures.ways import LEAST_PEOPLE, whole

pytestmark = pytest.mark.long

PLAZA = load_scene("plaza-v0")
AREAS = read_areas(PLAZA)
ROLLOUTS = 2


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """All figures of the plaza, with the rollouts they were drawn from."""
    import_recording("plaza")  # once: else it is generated wherever it is looked at
    folder = tmp_path_factory.mktemp("figures")
    asked = pages.arguments("docs/figures.md", "python -m studies figures")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert studies_main(["figures", *asked, "--seeds", f"{ROLLOUTS}", "--workers", "1"]) == 0
    names = [f"plaza-v0/{figure}.png" for figure in FIGURES[:-1]] + ["sheet.png"]
    assert sorted(folder.glob("docs/figures/**/*.png")) == sorted(
        folder / "docs/figures" / name for name in names
    )
    return folder


def draw(folder: Path, *figures: str) -> list[Path]:
    return write_figures(["plaza-v0"], figures=figures or FIGURES, out=folder / "docs/figures",
                         work=folder / "results", seeds=ROLLOUTS, workers=1)  # fmt: skip


def numbers(folder: Path, figure: str) -> dict[str, Any]:
    where = "" if figure == "sheet" else "plaza-v0/"
    found = json.loads((folder / "docs/figures" / f"{where}{figure}.json").read_bytes())
    assert found["figure"] == figure
    return found


def rollouts(folder: Path, spawn: str) -> list[Path]:
    return sorted(folder.glob(f"results/figures-plaza-v0/rollouts/{spawn}_social-force_*.parquet"))


def distance_in_sd(points: np.ndarray, areas: Gaussians, k: int) -> np.ndarray:
    away = points - areas.mean[k]
    return np.sqrt(np.einsum("...i,ij,...j", away, np.linalg.inv(areas.covariance[k]), away))


def test_pictures_are_small_and_the_same_again(folder: Path, tmp_path: Path) -> None:
    import_recording("plaza")
    shutil.copytree(folder / "results", tmp_path / "results")
    for path in draw(tmp_path):
        before = folder / path.relative_to(tmp_path)
        assert path.read_bytes().startswith(b"\x89PNG")
        assert len(path.read_bytes()) < 200_000, path
        for kind in (".png", ".json"):
            assert path.with_suffix(kind).read_bytes() == before.with_suffix(kind).read_bytes()


def test_policies_walk_the_recorded_people(folder: Path) -> None:
    found = numbers(folder, "policies")
    recording = recording_of(PLAZA)
    assert found["people"] == whole(recording).sum()
    assert set(found["policies"]) == {"straight", "social-force"}
    for policy in found["policies"].values():
        assert policy["arrived"] > 0.99
        assert 0.1 < policy["off_m"] < 1
    assert len(found["ways"]) == 6
    for way in found["ways"]:
        there = (recording.spawn_area == way["spawn_area"]) & whole(recording)
        assert way["people"] == (there & (recording.goal_area == way["goal_area"])).sum()
        assert ("recorded" in way) == (way["people"] >= LEAST_PEOPLE)


def test_flows_are_those_of_the_rollouts(folder: Path) -> None:
    found = numbers(folder, "flows")
    crowds = [read_own(path) for path in rollouts(folder, "cox-plans")]
    assert found["people"] == sum(int(crowd.entered.sum()) for crowd in crowds)
    assert len(found["areas"]) == 4
    assert sum(area["people"] for area in found["areas"]) == found["people"]
    assert found["spawn_areas_left_out"] == 0
    for area in found["areas"]:
        assert sum(flow["share"] for flow in area["flows"]) == pytest.approx(1, abs=1e-4)
        assert sum(flow["people"] for flow in area["flows"]) == area["people"]
        cells = np.array(area["density"])
        assert cells.sum() == pytest.approx(DENSITY_PARTS, rel=0.01)
        assert cells.shape == (20 / CELL_M, 30 / CELL_M)


def test_mean_ways_lead_from_their_spawn_area_to_their_goal_area(folder: Path) -> None:
    ways = 0
    for area in numbers(folder, "flows")["areas"]:
        for flow in area["flows"]:
            for side in ("simulated", "recorded"):
                if side in flow:
                    ways += 1
                    mean = np.array(flow[side]["mean_m"])
                    assert distance_in_sd(mean[0], AREAS.spawn, area["spawn_area"]) < 1.5
                    assert distance_in_sd(mean[-1], AREAS.goal, flow["goal_area"]) < 2
                    assert (np.array(flow[side]["across_m"]) < 5).all()
    assert ways > 10


def test_density_is_where_people_of_an_area_are(folder: Path) -> None:
    crowds = [read_own(path) for path in rollouts(folder, "cox-plans")]
    share = density(crowds, 0, PLAZA)
    assert share.sum() == pytest.approx(1)
    x, y = np.argwhere(share == share.max())[0][::-1] * CELL_M
    theirs = [crowd.xy[(crowd.spawn_area == 0)[crowd.row_person()]] for crowd in crowds]
    inside = np.concatenate(theirs)[:, :, None] - np.array([[x], [y]])
    here = ((inside >= 0) & (inside < CELL_M)).all(axis=1).sum()
    assert here / sum(map(len, theirs)) == pytest.approx(share.max(), rel=0.02)


def test_areas_that_get_no_map_are_counted(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("studies.figures.flows.MOST_AREAS", 3)
    crowds = [read_own(path) for path in rollouts(folder, "cox-plans")]
    _, found = draw_flows(PLAZA, AREAS, crowds, None, "a crowd")
    assert found["spawn_areas_left_out"] == 1
    drawn = sum(area["people"] for area in found["areas"])
    assert found["their_share_of_people"] == pytest.approx(1 - drawn / found["people"], abs=1e-4)
    assert not any("recorded" in flow for area in found["areas"] for flow in area["flows"])


def test_situations_come_with_what_chance_would_give(folder: Path) -> None:
    found = numbers(folder, "situations")
    kinds = [one["situation"] for one in found["situations"]]
    assert kinds == ["large group", "small group", "single walkers", "strong flow"]
    for one in found["situations"]:
        groups = {int(size): n for size, n in one["groups_by_size"].items()}
        assert sum(size * n for size, n in groups.items()) == one["entered"]
        assert one["nearest_recorded"] <= one["median_recorded"]
        for model, shown in (("cox-plans", 2), ("poisson-gmm", 1)):
            of_model = one["simulated"][model]
            assert len(of_model["nearest"]) == shown
            assert len(of_model["nearest_of_each_rollout"]) == ROLLOUTS
            first = of_model["nearest"][0]
            assert first["distance"] == min(of_model["nearest_of_each_rollout"])
            assert first["distance"] < of_model["median"]
            parts = first["ways"] + first["groups"] + first["presence"]
            assert first["distance"] == pytest.approx(parts, abs=0.02)


def test_the_sheet_shows_the_recording_and_both_models(folder: Path) -> None:
    (found,) = numbers(folder, "sheet")["scenes"]
    assert found["scene"] == "plaza-v0"
    assert found["rollouts"] == {"poisson-gmm": ROLLOUTS, "cox-plans": ROLLOUTS}
    over_time = found["agents_over_time"]
    for means in (over_time["recorded_mean"], *over_time["simulated_mean"].values()):
        assert len(means) == len(read_reference(PLAZA).blocks)
    for name in ("inter_spawn", "spawns_per_10_frames", "dwell"):
        assert set(found[name]["simulated"]) == {"poisson-gmm", "cox-plans"}
        for curve in (found[name]["recorded"], *found[name]["simulated"].values()):
            assert len(curve) == len(found[name]["x"])
            assert (np.diff(curve) <= 0).all()
        low, high = np.array(found[name]["band"])
        assert (low <= high).all()


def test_areas_that_a_scene_does_not_have_become_the_likeliest(folder: Path) -> None:
    crowd = read_own(rollouts(folder, "cox-plans")[0])
    wild = replace(crowd, spawn_area=crowd.spawn_area + 99, goal_area=crowd.goal_area - 99)
    known = with_areas(wild, AREAS)
    same = (known.spawn_area == crowd.spawn_area)[crowd.entered]
    assert same.mean() > 0.99
    same = (known.goal_area == crowd.goal_area)[crowd.left]
    assert same.mean() > 0.99


def test_what_cannot_be_drawn_is_said_before_anything_is_rolled_out(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for scenes, names, error, said in (
        ([], FIGURES, SettingError, "no scene"),
        (["plaza-v0"], ["portraits"], SettingError, "policies, flows, situations, sheet"),
        (["plaza-v0", "eth-v0"], FIGURES, RecordingError, "draw only --figure flows sheet"),
    ):
        with pytest.raises(error, match=said):
            write_figures(scenes, figures=names)
    with pytest.raises(SettingError, match="generates new crowds"):
        write_figures(["plaza-v0"], spawn="replay")
    with pytest.raises(CrowdbenchError, match="no-policy"):
        write_figures(["plaza-v0"], figures=["flows"], policy="no-policy")
    (tmp_path / "file").touch()
    with pytest.raises(CrowdbenchError, match="a file in place of a folder"):
        write_figures(["plaza-v0"], figures=["flows"], out=tmp_path / "file" / "docs")
    assert studies_main(["figures", "eth-v0", "--figure", "situations"]) == 2
    assert (
        "its recording, for situations. Run `crowdbench data fetch eth`" in capsys.readouterr().err
    )
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_the_command_draws_what_it_is_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without the recording too, where a figure can be without it."""
    monkeypatch.chdir(tmp_path)
    asked = ["figures", "eth-v0", "--figure", "flows", "--policy", "straight", "--seeds", "1",
             "--spawn", "renewal-gmm", "--workers", "1", "--out", "here"]  # fmt: skip
    assert studies_main(asked) == 0
    assert "written to here/eth-v0/flows.png and flows.json" in capsys.readouterr().out
    found = json.loads((tmp_path / "here/eth-v0/flows.json").read_bytes())
    assert (found["spawn"], found["policy"], found["rollouts"]) == ("renewal-gmm", "straight", 1)
    assert not any("recorded" in flow for area in found["areas"] for flow in area["flows"])


def test_by_default_the_best_policy_that_comes_with_a_scene_walks(tmp_path: Path) -> None:
    def walker(scene: str) -> str:
        of = figures._Shown.of(load_scene(scene), ["flows"], "cox-plans", None, 1, tmp_path)
        (job,) = of.jobs
        return job.policy

    assert walker("eth-v0") == "anticipate"
    assert walker("gc-v0") == "anticipate"
    assert walker("plaza-v0") == "social-force"


def test_situations_of_eth(opentraj: Path, tmp_path: Path) -> None:
    import_recording("eth", opentraj)
    write_figures(["eth-v0"], figures=["situations"], policy="straight", seeds=1, workers=1,
                  out=tmp_path, work=tmp_path)  # fmt: skip
    found = json.loads((tmp_path / "eth-v0/situations.json").read_bytes())
    large = found["situations"][0]
    assert (large["situation"], large["show_it"], large["entered"]) == ("large group", 9, 27)
    # Where nobody annotated there is no window, of the recording: 15 pauses.
    assert found["recorded_windows"] < found["simulated_windows"]["cox-plans"][0]
