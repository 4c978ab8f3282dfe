"""The comparison of a shared network with one for each area."""

import re

import numpy as np
import pytest

from crowdbench.spawn.ntpp import training as ntpp_training
from studies import sharing
from studies.__main__ import main


@pytest.fixture(autouse=True)
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    brief = ntpp_training.NtppSettings(
        epochs=3, patience=1, calibration_points=2000, step_groups=4000
    )
    monkeypatch.setattr(ntpp_training, "DEFAULT", brief)


def test_both_are_trained_for_each_fold_and_seed() -> None:
    nats = sharing.compare("plaza-v0", seeds=2)
    assert nats.shape == (2, 3, 2)
    assert np.all((nats > -6) & (nats < -2))
    assert len(np.unique(nats)) == nats.size
    _, own, shared, each = sharing.line("plaza-v0", nats)
    assert own == f"{nats[0].mean():.3f}".replace("-", "−")
    assert shared == f"{nats[1].mean():.3f}".replace("-", "−")
    told = [float(x.replace("−", "-")) for x in re.findall(r"([+−]\d\.\d{3}) ±", each)]
    np.testing.assert_allclose(told, (nats[1] - nats[0]).mean(axis=1), atol=6e-4)


def test_the_table_has_a_row_for_each_scene(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    nats = np.zeros((2, 3, 2))
    monkeypatch.setattr(sharing, "compare", lambda scene: nats)
    assert main(["sharing", "eth-v0", "plaza-v0"]) == 0
    rows = capsys.readouterr().out.splitlines()
    assert [row.split(" | ")[0] for row in rows[2:]] == ["| eth-v0", "| plaza-v0"]
