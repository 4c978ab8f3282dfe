"""A disk that is full: one sentence, and what was there before is still there."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import need

from crowdbench.errors import OutputError
from crowdbench.files import write_json, write_text


@pytest.fixture
def full(tmp_path: Path) -> Path:
    """A folder on a disk of 64 kB, mounted for this test."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mounted = subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=64k", "tmpfs", str(folder)],
        capture_output=True, check=False,
    )  # fmt: skip
    if mounted.returncode:
        pytest.skip("only root can mount a small disk")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mounts as Linux does")
def test_a_full_disk_is_one_sentence_and_loses_nothing(full: Path) -> None:
    kept = full / "kept.json"
    write_json(kept, {"a": 1})
    with pytest.raises(OutputError, match="No space left on device"):
        write_text(kept, "x" * 100_000)
    assert kept.read_text() == '{\n "a": 1\n}\n'
    assert list(full.iterdir()) == [kept]


@pytest.mark.long
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="mounts as Linux does")
def test_an_evaluation_on_a_full_disk_is_one_sentence(full: Path) -> None:
    asked = [
        "evaluate",
        "plaza-v0",
        "--spawn",
        "poisson-gmm",
        "--policy",
        "straight",
        "--seeds",
        "1",
    ]
    done = subprocess.run(
        [sys.executable, "-m", "crowdbench", *asked, "--out", str(full / "out")],
        capture_output=True, text=True, check=False, env=dict(os.environ),
    )  # fmt: skip
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert "No space left on device" in done.stderr


def test_the_device_that_is_always_full_is_not_replaced() -> None:
    device = Path("/dev/full")
    need(device.is_char_device(), "/dev/full")
    with pytest.raises(OutputError, match="got a device"):
        write_text(device, "lost")
    assert device.is_char_device()
