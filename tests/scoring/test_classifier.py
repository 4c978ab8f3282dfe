"""The classifier that tells simulated from recorded walking."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crowdbench import rollout, write_parquet
from crowdbench.cli import main
from crowdbench.data.recordings.noise import Noise
from crowdbench.registry import recording_of
from crowdbench.run.plaza_recording import record
from crowdbench.run.references import classifier_test_of
from crowdbench.scene import load_scene
from crowdbench.scoring import classifier
from crowdbench.scoring.classifier import FEATURES, ClassifierTest, _features

PLAZA = load_scene("plaza-v0")


@pytest.fixture(scope="module")
def plaza() -> ClassifierTest:
    return classifier_test_of(PLAZA)


def test_features_are_those_of_ways_that_are_known() -> None:
    t = np.arange(13) * 0.4
    ahead = np.stack([1.2 * t, np.zeros(13)], axis=1)
    quarter = 2.0 * np.stack([np.sin(t / 2), 1 - np.cos(t / 2)], axis=1)  # 1 m/s on a circle of 2 m
    slower = np.stack([2.0 * t - 0.1 * t**2, np.zeros(13)], axis=1)
    xy = np.stack([ahead, ahead[:, ::-1], quarter, slower])
    of = dict(zip(FEATURES, _features(xy, 0.4).T, strict=True))
    for name, value in (("net speed", 1.2), ("path per way", 1.0), ("highest speed", 1.2)):
        assert of[name][:2] == pytest.approx(value)
    for name in ("sd of speed", "turning", "standing", "furthest sideways", "acceleration along"):
        assert of[name][:2] == pytest.approx(0.0, abs=1e-9)
    assert of["turn"][2] == pytest.approx(11 * 0.4 / 2)  # between the first and the last step
    assert of["path speed"][2] == pytest.approx(1.0, abs=0.01)
    assert of["acceleration across"][2] > 0.3
    assert of["trend of speed"][3] < -0.4
    assert of["acceleration along"][3] == pytest.approx(0.2)
    assert of["bend sideways"][2] > 0.5 > 1e-9 > of["bend sideways"][3]


def test_another_draw_of_the_same_process_cannot_be_told(plaza: ClassifierTest) -> None:
    same = plaza.auc(record(seed=1))
    assert same is not None
    assert same.control < 0.55
    assert same.value == pytest.approx(0.5, abs=0.06)


def test_who_walks_straight_is_told(plaza: ClassifierTest) -> None:
    told = plaza.auc(rollout(PLAZA, "replay", "straight", seed=0))
    assert told is not None
    assert told.value > 0.8
    assert told.error < 0.05


def test_nothing_is_said_if_the_recording_is_told_from_itself(
    plaza: ClassifierTest, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With little noise added to the recording and much to crowds, the noise shows."""
    monkeypatch.setattr(classifier, "SIMULATED", 20.0)
    noisy = replace(plaza, noise=(Noise(0.05, 2), Noise(0.05, 2)))
    assert noisy.auc(recording_of(PLAZA)) is None


def test_nothing_is_said_of_few_windows(plaza: ClassifierTest) -> None:
    assert plaza.auc(rollout(PLAZA, "replay", "straight", seed=0, horizon_s=20.0)) is None


def test_score_prints_it_beside_its_control(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "crowd.parquet"
    write_parquet(rollout(PLAZA, "replay", "straight", seed=0), path)
    assert main(["score", "plaza-v0", str(path), "--classifier"]) == 0
    printed = capsys.readouterr().out
    assert "AUC of a classifier" in printed
    assert "recording (control)" in printed
