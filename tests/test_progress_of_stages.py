"""Stages of long work report their progress to whoever listens."""

from pathlib import Path

import pytest

import crowdbench
from crowdbench.cli.printing import progress_bar
from crowdbench.progress import heard_by, steps, tell, whole


def test_steps_are_told_from_the_first_to_the_last() -> None:
    told: list[tuple[str, int, int | None]] = []
    with heard_by(lambda *of: told.append(of)):
        assert list(steps("judging", ["a", "b"])) == ["a", "b"]
        with whole("areas"):
            pass
    assert told == [
        *(("judging", done, 2) for done in range(3)),
        ("areas", 0, None),
        ("areas", 1, 1),
    ]


def test_nobody_needs_to_listen() -> None:
    assert list(steps("judging", [1])) == [1]
    tell("judging", 0, 1)


def test_each_stage_has_a_bar(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("rollouts") as progress:
        progress(2, 2)
        list(steps("judging", range(3)))
    lines = capsys.readouterr().out
    assert "rollouts" in lines
    assert "2/2" in lines
    assert "judging" in lines
    assert "3/3" in lines


@pytest.mark.parametrize("report", [True, False])
def test_an_evaluation_tells_of_judging_and_pictures(tmp_path: Path, report: bool) -> None:
    told: dict[str, list[tuple[int, int | None]]] = {}
    with heard_by(lambda stage, *of: told.setdefault(stage, []).append(of)):
        crowdbench.evaluate(
            "plaza-v0", spawn="poisson-gmm", policy="straight", seeds=1, workers=1, out=tmp_path,
            report=report,
        )  # fmt: skip
    done, total = told["judging"][-1]
    assert done == total
    assert ("pictures" in told) == report == (tmp_path / "report.html").exists()
    assert not list(tmp_path.glob("*.png"))  # pictures are drawn once, for the page


@pytest.mark.parametrize("what", ["a[/red]b", "a{b}", "[bold]{task.total}", "{0}"])
def test_what_progress_is_of_may_be_any_path(what: str, capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar(what) as progress:
        progress(1, 1)
    assert capsys.readouterr().out.startswith(what)
