"""Evaluations that are over before another process has started are made in this one."""

from pathlib import Path

import pytest

from crowdbench.run import executor, rollout_jobs
from crowdbench.run.jobs import plan
from crowdbench.run.rollout_jobs import roll_out as roll_out_jobs
from crowdbench.scene import load_scene
from crowdbench.scoring.reference import read_reference

PLAZA = load_scene("plaza-v0")


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The numbers of processes that were asked for."""
    found: list[int] = []

    def call_each(function: object, tasks: list, workers: int, **options: object) -> object:
        found.append(workers)
        return executor.call_each(function, tasks, 1, **options)  # type: ignore[arg-type]

    monkeypatch.setattr(rollout_jobs, "call_each", call_each)
    monkeypatch.setattr(rollout_jobs, "checked_workers", lambda asked: asked or 7)
    return found


def roll_out(pair: tuple[str, str], seeds: int, out: Path, workers: int | None = None) -> None:
    jobs = plan(PLAZA.id, PLAZA, [pair], "full", seeds, out)
    roll_out_jobs(jobs, read_reference(PLAZA), workers)


def test_few_rollouts_start_no_process(tmp_path: Path, started: list[int]) -> None:
    roll_out(("poisson-gmm", "straight"), 2, tmp_path)
    assert started == [1]


def test_whoever_asks_for_processes_gets_them(tmp_path: Path, started: list[int]) -> None:
    roll_out(("poisson-gmm", "straight"), 2, tmp_path, workers=3)
    assert started == [3]


def test_many_rollouts_do(
    tmp_path: Path, started: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rollout_jobs, "LIGHT_FRAMES", 2 * PLAZA.recording.frames - 1)
    roll_out(("poisson-gmm", "straight"), 1, tmp_path)
    roll_out(("poisson-gmm", "straight"), 2, tmp_path)
    assert started == [1, 7]


def test_so_does_a_class_of_ones_own(tmp_path: Path, started: list[int]) -> None:
    roll_out(("poisson-gmm", "given:Announcing"), 1, tmp_path)
    assert started == [7]
