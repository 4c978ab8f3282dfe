"""Evaluations under perturbed arrivals: only policies are compared, beside recorded arrivals."""

from pathlib import Path

import pytest

from crowdbench.cli import main
from crowdbench.evaluation import evaluate
from crowdbench.run.jobs import DRAWS
from crowdbench.scoring.ranking import ranked_by, rows


def test_policies_are_scored_and_ranked_by_walk(tmp_path: Path) -> None:
    card = evaluate(
        "plaza-v0", spawn="perturbed-replay:ab", policy=["straight", "social-force"],
        workers=1, out=tmp_path, report=False,
    )  # fmt: skip
    table = rows(card)
    found = {(row.spawn, row.policy): row for row in table if row.kind == "entry"}
    assert ranked_by(table) == "walk"
    assert {spawn for spawn, _ in found} == {"perturbed-replay:ab", "replay"}
    walked = found["perturbed-replay:ab", "social-force"]
    assert len(walked.entry.seeds) == DRAWS
    assert walked.walk is not None
    assert walked.walk.value > 0.3
    assert found["replay", "straight"].walk is not None
    assert found["replay", "straight"].walk.value == 0
    assert abs(found["perturbed-replay:ab", "straight"].walk.value) > 0.001


def test_the_command_line_shows_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    asked = ["evaluate", "plaza-v0", "--spawn", "perturbed-replay", "--policy", "straight"]
    assert main([*asked, "--seeds", "2", "--out", str(tmp_path)]) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert "perturbed-replay × straight" in printed
    assert "Ranked by walk" in printed
    assert "perturbed-replay" in (tmp_path / "report.html").read_text()
