"""Reference statistics: distances from them are distances from the recording."""

import gzip
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from msgspec import structs

from crowdbench.crowds import score
from crowdbench.data.recordings.catalogue import SOURCES, read_published
from crowdbench.data.table import Trajectories
from crowdbench.errors import OutputError, RecordingError, SceneError, SettingError, WeightsError
from crowdbench.files import write_json
from crowdbench.metrics import distance, metrics_for
from crowdbench.policies import Random, Straight
from crowdbench.registry import recording, spawn_model
from crowdbench.run.rollout import rollout
from crowdbench.scene import Scene, load_scene
from crowdbench.scene_building.fit import fit_scene
from crowdbench.scoring.reference import Reference, place_of, read_reference, write_reference
from crowdbench.scoring.scorecard import files_of, read_anchors
from crowdbench.spawn import fit_areas
from crowdbench.spawn.areas import read_areas

ETH, PLAZA = load_scene("eth-v0"), load_scene("plaza-v0")
FITTED = (
    *("areas.json", "poisson-gmm.json", "poisson-groups.json", "reference.json.gz"),
    "renewal-gmm.json",
)
EXACT = ("poisson-gmm", "poisson-groups", "renewal-gmm")  # torch's last bits are the machine's own


@pytest.fixture(scope="module")
def raw(opentraj: Path) -> Trajectories:
    return read_published(SOURCES["eth"], opentraj)


@pytest.fixture(scope="module")
def eth(raw: Trajectories) -> Trajectories:
    """The recording with its persons in the scene's areas."""
    return fit_areas(raw, ETH, ETH.clustering["default"])[1]


def unpacked(path: Path) -> Any:
    return json.loads(gzip.decompress(path.read_bytes()))


def reference_of(crowd: Trajectories, scene: Scene) -> Reference:
    return Reference.of(crowd, scene, read_areas(scene))


@pytest.fixture(scope="module", params=[Straight(), Random()], ids=lambda p: p.name)
def crowd(request: pytest.FixtureRequest) -> Trajectories:
    return rollout(ETH, spawn_model("poisson-gmm", ETH), request.param, seed=1)


@pytest.fixture(scope="module")
def plaza() -> Trajectories:
    return recording("plaza")


def test_distances_from_shipped_statistics_equal_those_from_the_recording(
    eth: Trajectories, crowd: Trajectories
) -> None:
    from_recording = reference_of(eth, ETH).score(crowd)
    shipped = read_reference(ETH).score(crowd)
    assert {n: r.distance for n, r in shipped.items()} == {
        n: r.distance for n, r in from_recording.items()
    }


def test_scores_are_the_metrics_own_distances(eth: Trajectories, crowd: Trajectories) -> None:
    blocks = reference_of(eth, ETH).blocks
    place = place_of(ETH, read_areas(ETH))
    expected = {m.name: distance(m, eth, crowd, blocks, place) for m in metrics_for(blocks)}
    found = score(ETH, crowd)
    assert set(found) == set(expected)
    for name, result in found.items():
        assert (result.distance, result.n) == (expected[name].distance, expected[name].n)


def test_a_recording_has_no_distance_to_itself(eth: Trajectories) -> None:
    assert {r.distance for r in score("eth-v0", eth).values()} == {0.0}


def test_persons_without_areas_are_given_the_likeliest(raw: Trajectories) -> None:
    """Clusters and their Gaussians agree on nearly everyone, those at the edges aside."""
    assert (raw.spawn_area == -1).all()
    found = score("eth-v0", raw)
    assert found["origin_destination"].distance < 0.2
    assert found["inter_spawn_per_area"].distance < 0.2
    assert found["inter_spawn"].distance == 0


def test_written_statistics_are_read_back(tmp_path: Path, plaza: Trajectories) -> None:
    reference = reference_of(plaza, PLAZA)
    shutil.copy(PLAZA.folder / "areas.json", tmp_path)
    place = replace(PLAZA, folder=tmp_path)
    write_reference(reference, place)
    again = read_reference(place)
    assert np.array_equal(again.blocks.frames, reference.blocks.frames)
    assert np.array_equal(again.blocks.since, reference.blocks.since)
    for metric, histograms in reference.statistics.items():
        for name, counts in histograms.items():
            found = again.statistics[metric][name]
            assert np.array_equal(found, counts[:, : found.shape[1]])
            assert counts[:, found.shape[1] :].sum() == 0


@pytest.mark.parametrize(
    ("changed", "name"),
    [
        (
            replace(PLAZA, walking=structs.replace(PLAZA.walking, shifts_s=(15.0,))),
            "shifts_s = (15.0,)",
        ),
        (
            replace(PLAZA, motion=structs.replace(PLAZA.motion, person_radius_m=0.2)),
            "person_radius_m = 0.2",
        ),
    ],
    ids=["walking", "radius"],
)
def test_statistics_of_other_settings_are_refused(changed: Scene, name: str) -> None:
    with pytest.raises(WeightsError) as caught:
        read_reference(changed)
    assert name in caught.value.expected


SEARCHED = "renewal-gmm.json"  # by an optimiser, whose last digits are the processor's own


def remade(scene: Any, crowd: Trajectories, out: Path) -> list[str]:
    """Names of the fitted files that another fit makes otherwise than those shipped."""
    fit_scene(scene, crowd, models=EXACT, out=out)
    return [
        name
        for name in FITTED
        if (out / name).read_bytes() != (scene.folder / name).read_bytes()
        and not (
            name == SEARCHED
            and alike(*(json.loads((f / name).read_bytes()) for f in (out, scene.folder)))
        )
    ]


def alike(a: Any, b: Any) -> bool:
    """Whether two JSON values are the same, but for a millionth of a number."""
    if isinstance(a, dict):
        return a.keys() == b.keys() and all(alike(a[k], b[k]) for k in a)
    if isinstance(a, list):
        return len(a) == len(b) and all(alike(x, y) for x, y in zip(a, b, strict=True))
    if isinstance(a, float):
        return a == pytest.approx(b, rel=1e-6, abs=1e-9)
    return bool(a == b)


@pytest.mark.usefixtures("unadjusted")
def test_the_plazas_shipped_files_are_remade(tmp_path: Path, plaza: Trajectories) -> None:
    assert remade(PLAZA, plaza, tmp_path) == []


@pytest.mark.usefixtures("unadjusted")
def test_eths_shipped_files_are_remade(tmp_path: Path, raw: Trajectories) -> None:
    assert remade(ETH, raw, tmp_path) == []


@pytest.mark.usefixtures("unadjusted")
def test_the_papers_clustering_makes_other_areas(tmp_path: Path, raw: Trajectories) -> None:
    fit_scene(ETH, raw, clustering="paper", models=EXACT, out=tmp_path)
    assert (tmp_path / "areas.json").read_bytes() != (ETH.folder / "areas.json").read_bytes()
    made = load_scene(tmp_path)  # a scene whose default is the paper's
    assert made.clustering["default"] == ETH.clustering["paper"]
    assert made.clustering["paper"] == ETH.clustering["paper"]


def test_an_unknown_clustering_is_refused(tmp_path: Path, plaza: Trajectories) -> None:
    with pytest.raises(SettingError, match=r"clustering of plaza-v0: got 'best'.*default"):
        fit_scene(PLAZA, plaza, clustering="best", out=tmp_path)


@pytest.mark.parametrize("name", ["hotel-v0", "zara1-v0", "plaza-v0"])
def test_places_that_the_paper_did_not_use_have_no_settings_of_its(
    name: str, tmp_path: Path, plaza: Trajectories
) -> None:
    with pytest.raises(
        SettingError, match=r"got 'paper'.*settings exist for eth-v0, gc-v0 and forum-v0"
    ):
        fit_scene(load_scene(name), plaza, clustering="paper", out=tmp_path)


def test_a_fit_with_another_recording_is_refused(tmp_path: Path, plaza: Trajectories) -> None:
    with pytest.raises(SceneError, match=r"recording\.frames = 1934"):
        fit_scene(ETH, plaza, out=tmp_path)


def test_bounds_that_cut_the_recording_are_refused(tmp_path: Path, plaza: Trajectories) -> None:
    narrow = replace(PLAZA, bounds=structs.replace(PLAZA.bounds, y_max_m=10.0))
    with pytest.raises(SceneError, match="recorded positions outside the bounds"):
        fit_scene(narrow, plaza, out=tmp_path)


def test_a_fit_that_cannot_be_written_says_so(tmp_path: Path, plaza: Trajectories) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="a writable location"):
        fit_scene(PLAZA, plaza, out=tmp_path / "file" / "out")


def first_gaps(file: dict[str, Any]) -> list[list[int]]:
    gaps: list[list[int]] = gaps_of(file)[0]
    return gaps


def gaps_of(file: dict[str, Any]) -> list:
    """By block."""
    return file["statistics"]["inter_spawn"]["counts"][1]


BROKEN: dict[str, tuple[Callable[[dict[str, Any]], object], str]] = {
    "another scene's": (lambda f: f.update(scene="plaza-v0"), "scene = plaza-v0; expected"),
    "another schema": (lambda f: f.update(schema=1), "schema = 1; expected schema = 3"),
    "a field too many": (lambda f: f.update(note="mine"), "note"),
    "a field too few": (lambda f: f.pop("opens"), "opens"),
    "without a scored metric": (
        lambda f: f["statistics"].pop("inter_spawn"), "inter_spawn with nothing"
    ),
    "without a histogram": (lambda f: f["statistics"]["dwell"].pop("ended"), "dwell with cens"),
    "without a block": (lambda f: f["blocks"].pop(), "16 blocks in ascending .* with 17"),
    "without any block": (lambda f: f.update(blocks=[], opens=[]), "length"),
    "with a block less": (
        lambda f: gaps_of(f).pop(), r"\[16, 17\] blocks"
    ),
    "with a negative value": (lambda f: first_gaps(f).append([-3, 5]), ">= 0"),
    "with a value out of all proportion": (lambda f: first_gaps(f).append([10**12, 1]), "int"),
    "with half a count": (lambda f: first_gaps(f).append([3, 0.5]), "int"),
    "with blocks in disorder": (lambda f: f["blocks"].reverse(), "in ascending order"),
    "of other areas": (lambda f: f.update(spawn_areas=3), "spawn_areas = 3; expected spawn"),
    "with an empty block": (lambda f: f["blocks"].__setitem__(0, [0, 0]), "in ascending order"),
}  # fmt: skip


@pytest.mark.parametrize("what", BROKEN)
def test_broken_statistics_are_refused(what: str, tmp_path: Path) -> None:
    spoil, message = BROKEN[what]
    file = unpacked(ETH.folder / "reference.json.gz")
    spoil(file)
    write_json(tmp_path / "reference.json.gz", file)
    shutil.copy(ETH.folder / "areas.json", tmp_path)
    with pytest.raises(WeightsError, match=rf"{message}.*Run `crowdbench scene fit "):
        read_reference(replace(ETH, folder=tmp_path))


def test_a_metric_that_is_newer_than_the_statistics_is_left_out(tmp_path: Path) -> None:
    assert "dwell" not in ETH.protocol.scored
    file = unpacked(ETH.folder / "reference.json.gz")
    del file["statistics"]["dwell"]
    write_json(tmp_path / "reference.json.gz", file)
    shutil.copy(ETH.folder / "areas.json", tmp_path)
    reference = read_reference(replace(ETH, folder=tmp_path))
    assert set(reference.statistics) == set(read_reference(ETH).statistics) - {"dwell"}


@pytest.mark.parametrize(("metric", "counts"), [("dwell", False), ("inter_spawn", True)])
def test_anchors_and_entries_depend_on_scored_statistics_alone(
    metric: str, counts: bool, tmp_path: Path
) -> None:
    folder = tmp_path / "eth-v0"
    shutil.copytree(ETH.folder, folder, ignore=shutil.ignore_patterns("policies"))
    file = unpacked(folder / "reference.json.gz")
    columns, rows = next(iter(file["statistics"][metric].values()))
    rows[0].append([columns + 3, 1])
    write_json(folder / "reference.json.gz", file)
    changed = load_scene(folder)
    assert (files_of(changed) != files_of(ETH)) == counts
    if counts:
        with pytest.raises(WeightsError, match="crowdbench scene anchors"):
            read_anchors(changed)
    else:
        assert read_anchors(changed).made_from == read_anchors(ETH).made_from


def test_missing_statistics_say_how_to_make_them(tmp_path: Path) -> None:
    with pytest.raises(WeightsError, match=r"no such file.*Run `crowdbench scene fit "):
        read_reference(replace(ETH, folder=tmp_path))


def test_what_is_no_json_is_refused(tmp_path: Path) -> None:
    (tmp_path / "reference.json.gz").write_bytes(gzip.compress(b"{\xff"))
    with pytest.raises(WeightsError, match="valid JSON"):
        read_reference(replace(ETH, folder=tmp_path))


def test_a_crowd_of_another_time_step_is_refused(crowd: Trajectories) -> None:
    with pytest.raises(RecordingError, match=r"frames of 0\.5 s; expected frames of 0\.4 s"):
        score(ETH, replace(crowd, dt_s=0.5))


def test_a_crowd_that_is_too_short_is_refused() -> None:
    short = rollout(ETH, spawn_model("poisson-gmm", ETH), Straight(), seed=1, horizon_s=100.0)
    with pytest.raises(RecordingError, match=r"250 frames .*expected 1934 frames"):
        score(ETH, short)


def test_what_comes_after_the_recordings_end_does_not_count() -> None:
    model = spawn_model("poisson-gmm", ETH)
    longer = rollout(ETH, model, Straight(), seed=1, horizon_s=ETH.horizon_s + 60)
    observed = np.diff(read_reference(ETH).blocks.frames).sum()
    assert score(ETH, longer)["agents_over_time"].n == observed


def test_an_unknown_scene_is_refused(crowd: Trajectories) -> None:
    with pytest.raises(SceneError, match="moon-v0"):
        score("moon-v0", crowd)
