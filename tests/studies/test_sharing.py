"""The comparison of a shared network with one for each area."""

import re

import numpy as np
import pytest

from crowdbench.spawn.ntpp import training as ntpp_training
from studies import sharing


@pytest.fixture(autouse=True)
def briefly(monkeypatch: pytest.MonkeyPatch) -> None:
    brief = ntpp_training.Settings(epochs=3, patience=1, calibration_points=2000, step_groups=4000)
    monkeypatch.setattr(ntpp_training, "SETTINGS", brief)


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


def test_no_scene_is_an_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert sharing.main([]) == 2
    assert "expected one or more scenes" in capsys.readouterr().err
