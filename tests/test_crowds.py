"""Crowds by name, from a file and against each other; how they look when printed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import crowdbench
from crowdbench.data.table import Trajectories
from crowdbench.errors import RecordingError, SceneError, SettingError
from crowdbench.policies import Straight
from crowdbench.registry import spawn_model
from crowdbench.run import rollout as rollouts
from crowdbench.scene import load_scene, scenes_folder

PLAZA = load_scene("plaza-v0")


def walked(seed: int, policy: str = "straight") -> Trajectories:
    return crowdbench.rollout("plaza-v0", "renewal-gmm", policy, seed=seed)


@pytest.fixture(scope="module")
def crowd() -> Trajectories:
    return walked(0)


@pytest.fixture(scope="module")
def other() -> Trajectories:
    return walked(1, "social-force")


@pytest.fixture(scope="module")
def recorded() -> Trajectories:
    return crowdbench.recording_of("plaza-v0")


def test_names_stand_for_what_they_name() -> None:
    model = spawn_model("renewal-gmm", PLAZA)
    plain = rollouts.rollout(PLAZA, model, Straight(), seed=3, horizon_s=30.0)
    for scene in ("plaza-v0", PLAZA, scenes_folder() / "plaza-v0"):
        named = crowdbench.rollout(scene, "renewal-gmm", "straight", seed=3, horizon_s=30.0)
        np.testing.assert_array_equal(named.xy, plain.xy)
    mixed = crowdbench.rollout(PLAZA, model, "straight", seed=3, horizon_s=30.0)
    np.testing.assert_array_equal(mixed.xy, plain.xy)


@pytest.mark.parametrize(
    ("scene", "spawn", "policy", "error", "known"),
    [
        ("plaza", "renewal-gmm", "straight", SceneError, "plaza-v0"),
        ("plaza-v0", "renewal", "straight", SettingError, "renewal-gmm"),
        ("plaza-v0", "renewal-gmm", "strait", SettingError, "straight"),
    ],
)
def test_unknown_names_are_refused_with_those_that_are_known(
    scene: str, spawn: str, policy: str, error: type[Exception], known: str
) -> None:
    with pytest.raises(error, match=known):
        crowdbench.rollout(scene, spawn, policy, seed=0)


def test_an_evaluation_takes_a_scene_and_single_names(tmp_path: Path) -> None:
    for scene in (PLAZA, "plaza-v0"):
        with pytest.raises(SettingError, match="got 'nobody'; expected one of poisson-gmm"):
            crowdbench.evaluate(scene, spawn="nobody", policy="straight", out=str(tmp_path))


@pytest.mark.parametrize("horizon_s", [0.0, -1.0, float("nan"), float("inf")])
def test_a_rollout_takes_some_time(horizon_s: float) -> None:
    with pytest.raises(SettingError, match="a positive number of seconds"):
        crowdbench.rollout("plaza-v0", "poisson-gmm", "straight", seed=0, horizon_s=horizon_s)


def test_a_file_of_crowdbench_s_knows_its_scene(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, crowd: Trajectories
) -> None:
    monkeypatch.chdir(tmp_path)
    crowdbench.write_parquet(crowd, "crowd.parquet")
    for again in (
        crowdbench.read("crowd.parquet"),
        crowdbench.read("crowd.parquet", "plaza-v0"),
        crowdbench.read(Path("crowd.parquet"), PLAZA),
        crowdbench.read_own("crowd.parquet"),
    ):
        np.testing.assert_array_equal(again.xy, crowd.xy)
        assert (again.scene, again.provenance) == (crowd.scene, crowd.provenance)
    with pytest.raises(RecordingError, match="got scene plaza-v0; expected scene eth-v0"):
        crowdbench.read("crowd.parquet", "eth-v0")


def test_of_another_program_s_table_the_scene_is_named(tmp_path: Path) -> None:
    table = tmp_path / "mine.csv"
    table.write_text("person_id,time_s,x,y\n7,0.4,1.0,2.0\n7,0.8,1.5,2.0\n")
    mine = crowdbench.read(str(table), "plaza-v0")
    assert (mine.scene, mine.dt_s, mine.first.tolist()) == ("plaza-v0", PLAZA.dt_s, [1])
    with pytest.raises(RecordingError, match=r'crowdbench\.read\(path, "eth-v0"\)'):
        crowdbench.read(str(table))


def test_a_crowd_is_nothing_away_from_itself(crowd: Trajectories) -> None:
    results = crowdbench.score("plaza-v0", crowd, against=crowd)
    assert {r.distance for r in results.values()} == {0.0}
    assert all(r.recorded == r.simulated for r in results.values() if r.recorded == r.recorded)


def test_against_the_recording_is_what_is_computed_without_it(
    crowd: Trajectories, recorded: Trajectories
) -> None:
    plain = crowdbench.score("plaza-v0", crowd)
    against = crowdbench.score("plaza-v0", crowd, against=recorded)
    assert {n: r.distance for n, r in against.items()} == {n: r.distance for n, r in plain.items()}


def test_the_crowd_that_is_held_against_takes_the_recording_s_place(
    crowd: Trajectories, other: Trajectories
) -> None:
    there, back = (
        crowdbench.score(PLAZA, a, against=b) for a, b in ((crowd, other), (other, crowd))
    )
    assert there["speed"].recorded == back["speed"].simulated
    assert there["speed"].distance > 0
    # Wasserstein-1 is the same both ways, but for what it is divided by.
    assert there["dwell"].distance * there["dwell"].recorded == pytest.approx(
        back["dwell"].distance * back["dwell"].recorded
    )


def test_neither_side_may_be_shorter_than_the_recording(crowd: Trajectories) -> None:
    short = crowdbench.rollout("plaza-v0", "poisson-gmm", "straight", seed=0, horizon_s=60.0)
    for one, against in ((short, crowd), (crowd, short)):
        with pytest.raises(RecordingError, match=r"150 frames \(60\.0 s\)"):
            crowdbench.score("plaza-v0", one, against=against)


def test_a_crowd_of_another_scene_is_nothing_to_hold_against(crowd: Trajectories) -> None:
    with pytest.raises(RecordingError, match="a crowd of eth-v0; expected plaza-v0"):
        crowdbench.score("plaza-v0", crowd, against=replace(crowd, scene="eth-v0"))


def test_crowds_metrics_and_results_are_printed_on_one_line(crowd: Trajectories) -> None:
    length = f"{crowd.frames} frames of 0.4 s"
    assert repr(crowd) == f"Trajectories('plaza-v0', {len(crowd)} persons, {length})"
    assert repr(crowdbench.METRICS[0]) == "<metric inter_spawn, arrivals>"
    result = crowdbench.MetricResult(0.12345, 1.5432, 2.0, "s", 77)
    assert repr(result) == "MetricResult(0.123: recorded 1.54 s, simulated 2 s, n = 77)"
    unitless = replace(result, unit="")
    assert repr(unitless) == "MetricResult(0.123: recorded 1.54, simulated 2, n = 77)"
    valueless = replace(result, recorded=np.nan, simulated=np.nan)
    assert repr(valueless) == "MetricResult(0.123, n = 77)"
