"""Progress of trainings: what is printed, and what TensorBoard gets if it is installed."""

import sys
from pathlib import Path
from types import ModuleType

import pytest

from crowdbench.baselines import progress as module
from crowdbench.baselines.progress import Progress

LOG = "torch.utils.tensorboard"


class Clock:
    """Time that passes only when told."""

    now = 0.0

    def monotonic(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(module, "time", clock)
    return clock


class Writer:
    """Stands for TensorBoard's writer, with the same calls."""

    def __init__(self, log_dir: Path, *, purge_step: int) -> None:
        self.log_dir, self.purge_step = log_dir, purge_step
        self.scalars: list[tuple[str, float, int]] = []
        self.closed = False
        Writer.last = self

    def add_scalar(self, tag: str, value: float, step: int) -> None:
        assert not self.closed
        self.scalars.append((tag, value, step))

    def close(self) -> None:
        self.closed = True


def test_speed_and_time_left_are_printed(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, LOG, None)  # as if it were not installed
    with Progress(100, "frames", "agent-steps", Path("nowhere")) as progress:
        for done in range(10, 101, 10):
            clock.now += 4.0
            progress(done, 2000, {"reward": done / 100})
    lines = capsys.readouterr().out.splitlines()
    # The first call, one every ten seconds, and the last call.
    assert [line.split()[0] for line in lines] == ["10", "40", "70", "100"]
    assert lines[1].strip().split("  ") == [
        "40 of 100 frames", "reward 0.4", "500 agent-steps/s", "24 s left",
    ]  # fmt: skip
    assert lines[-1].endswith("500 agent-steps/s  0 s left")


def test_the_speed_is_that_since_the_line_before(
    clock: Clock, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, LOG, None)
    progress = Progress(1000, "epochs", "samples", Path("nowhere"))
    for seconds in (100.0, 10.0):  # the first call compiles
        clock.now += seconds
        progress(1, 500, {})
    first, second = capsys.readouterr().out.splitlines()
    assert "5 samples/s" in first
    assert "50 samples/s" in second
    assert first.endswith(" min left")


def test_everything_goes_to_tensorboard(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    fake = ModuleType(LOG)
    fake.SummaryWriter = Writer
    monkeypatch.setitem(sys.modules, LOG, fake)
    with Progress(4, "frames", "agent-steps", Path("here/tensorboard/full")) as progress:
        for done in range(1, 5):  # no time passes: only the first and the last one are printed
            progress(done, 1, {"m/s": 0.5 * done})
    assert Writer.last.log_dir == Path("here/tensorboard/full")
    assert Writer.last.scalars == [("m per s", 0.5 * k, k) for k in range(1, 5)]
    assert Writer.last.closed
    assert Writer.last.purge_step == 0
