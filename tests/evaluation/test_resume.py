"""An evaluation that is killed goes on where it stopped, and ends with the same bytes.

CROWDBENCH_KILLS=20 kills it as often as a release does.
"""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO

import numpy as np

KILLS = int(os.environ.get("CROWDBENCH_KILLS", "3"))
ASKED = ["evaluate", "eth-v0", "--spawn", "poisson-gmm", "--policy", "straight", "--seeds", "10"]


def start(out: Path, errors: int | IO[bytes] = subprocess.DEVNULL) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-m", "crowdbench", *ASKED, "--workers", "2", "--out", str(out)]
    return subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=errors, start_new_session=True
    )


def finished(out: Path) -> dict[str, bytes]:
    """Run to the end; all files but the one that tells when and where."""
    with TemporaryFile() as errors:
        process = start(out, errors)
        returned = process.wait()
        errors.seek(0)
        assert returned == 0, errors.read().decode()
    return {
        str(p.relative_to(out)): p.read_bytes()
        for p in sorted(out.rglob("*"))
        if p.is_file() and p.name != "run.json"
    }


def test_killed_evaluations_end_with_the_same_bytes(tmp_path: Path) -> None:
    began = time.monotonic()
    whole = finished(tmp_path / "whole")
    took_s = time.monotonic() - began
    rng = np.random.default_rng(KILLS)
    out = tmp_path / "killed"
    for k in range(KILLS):
        process = start(out)
        time.sleep(rng.uniform(0.2, 1.0) * took_s)
        # Now everyone at once, now the main process alone.
        if k % 2:
            process.kill()
        else:
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert finished(out) == whole
