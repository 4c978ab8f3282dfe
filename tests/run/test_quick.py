"""A quick look: as few rollouts as scores need, of what is named."""

from pathlib import Path

import pytest

from crowdbench.cli import main
from crowdbench.evaluation import evaluate
from crowdbench.scoring.scorecard import PairResult


def evaluated(out: Path, **asked: object) -> dict[tuple[str, str], PairResult]:
    card = evaluate("plaza-v0", quick=True, report=False, out=out, **asked)  # type: ignore[arg-type]
    return {(entry.spawn, entry.policy): entry for entry in card.entries}


def test_a_policy_walks_under_the_recorded_arrivals_twice(tmp_path: Path) -> None:
    found = evaluated(tmp_path, policy="random")
    assert list(found) == [("replay", "random")]
    assert found["replay", "random"].seeds == [0, 1]
    assert found["replay", "random"].metrics["speed"].energy is not None


@pytest.mark.long
def test_a_spawn_model_has_two_rollouts_of_each_fit_and_straight_walkers(tmp_path: Path) -> None:
    found = evaluated(tmp_path, spawn="poisson-gmm")
    assert list(found) == [("poisson-gmm", "straight"), ("replay", "straight")]
    assert found["poisson-gmm", "straight"].seeds == list(range(10))
    assert found["poisson-gmm", "straight"].metrics["dwell"].energy is not None


def test_only_the_first_trajectories_are_written_unless_all_are_asked_for(tmp_path: Path) -> None:
    asked = {"policy": "random"}
    evaluated(tmp_path / "first", **asked)
    evaluated(tmp_path / "all", **asked, keep_rollouts=True)
    names = {
        name: sorted(path.name for path in (tmp_path / name / "rollouts").iterdir())
        for name in ("first", "all")
    }
    assert names["first"] == ["replay_random_full_0.parquet"]
    assert names["all"] == [f"replay_random_full_{seed}.parquet" for seed in (0, 1)]


def test_the_command_line_has_it_too(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["evaluate", "plaza-v0", "--policy", "straight", "--quick", "--no-report"]
    assert main([*asked, "--out", str(tmp_path)]) == 0
    assert "replay × straight" in capsys.readouterr().out
