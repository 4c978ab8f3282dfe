"""Five hundred spoilt submissions; `python tests/fuzz_submissions.py` opens ten thousand."""

import sys
from pathlib import Path

import pytest
from fuzz_submissions import fuzz


@pytest.mark.long
@pytest.mark.skipif(sys.platform != "linux", reason="limits memory as Linux does")
def test_spoilt_submissions_are_refused_or_harmless(tmp_path: Path) -> None:
    counts, failures = fuzz(range(500), tmp_path)
    assert failures == []
    assert counts["refused"] > 300
    assert counts["accepted"] > 10
