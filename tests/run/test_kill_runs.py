"""Killed evaluations and verifications leave nothing behind; `kill_runs.py` kills many."""

import sys

import kill_runs
import pytest

pytestmark = pytest.mark.nightly


@pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")
def test_killed_runs_leave_nothing_and_end_with_the_same_bytes(
    capsys: pytest.CaptureFixture[str],
) -> None:
    faults = kill_runs.run(kills=2, seeds=2, seed=1)
    assert faults == 0, capsys.readouterr().out
