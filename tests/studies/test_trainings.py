"""Studies that train policies or measure trainings: each runs, small, and prints its lines."""

from pathlib import Path

import pytest

from crowdbench.registry import import_recording
from studies import compare_observations, runners, without_reward_parts
from studies.__main__ import main

pytestmark = pytest.mark.nightly

Printed = pytest.CaptureFixture[str]


def test_each_part_of_a_training_is_timed(capsys: Printed) -> None:
    small = "--seconds 0.05 --worlds 2 --max-alive 20 --batch-frames 200 --horizon-s 20"
    assert main(["training-speed", "--scene", "plaza-v0", *small.split()]) == 0
    lines = [line for line in capsys.readouterr().out.splitlines() if "M/s" in line]
    assert [line.rsplit("M/s")[0].strip(" .0123456789") for line in lines] == [
        "simulation: step, observe",
        "environment: rewards, copies",
        "collecting with a network",
        "learning",
        "whole loop",
    ]


def test_a_row_for_the_whole_reward_and_one_for_each_part(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed
) -> None:
    monkeypatch.setattr(without_reward_parts, "PARTS", ("progress",))
    monkeypatch.setattr(without_reward_parts, "WORLDS", 1)
    assert main(["without-reward-parts", "plaza-v0", "--frames", "6400"]) == 0
    rows = capsys.readouterr().out.splitlines()[2:]
    assert [row.split(" | ")[0] for row in rows] == ["| nothing", "| progress"]


def test_who_has_not_learnt_to_walk_is_a_failure(capsys: Printed) -> None:
    with pytest.raises(SystemExit, match="1"):
        main(["runners", "plaza-v0", "--steps", "200"])
    mean, sampled = capsys.readouterr().out.splitlines()
    assert "mean actions: " in mean
    assert "sampled actions: " in sampled
    assert set(runners.ROUTES) == {"plain", "sb3"}


def test_each_observation_has_its_mean_score(
    monkeypatch: pytest.MonkeyPatch, capsys: Printed, tmp_path: Path
) -> None:
    import_recording("plaza")
    monkeypatch.setattr(compare_observations, "OBSERVATIONS", ("lidar-2",))
    asked = ["--seeds", "1", "--frames", "6400", "--out", str(tmp_path)]
    assert main(["compare-observations", "plaza-v0", *asked]) == 0
    first, last = capsys.readouterr().out.splitlines()[-2:]
    assert first.startswith("lidar-2, seed 0: walk ")
    assert last.startswith("lidar-2: mean walk ")
