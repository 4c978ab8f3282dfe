"""Progress of a training: figures with the speed and the time left, also for TensorBoard."""

import time
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType

EVERY_S = 10.0
"""Seconds between two printed lines."""


class Progress:
    """Prints figures every ten seconds and logs all of them to TensorBoard, if that is installed.

    Use it as a context manager, which closes the log.
    """

    def __init__(self, total: int, unit: str, counted: str, log: Path) -> None:
        """Begin a training.

        Args:
            total: length of the training.
            unit: unit of that length, such as `epochs`.
            counted: what the speed counts, such as `samples`.
            log: folder of the TensorBoard log.
        """
        self.total = total
        self.unit = unit
        self.counted = counted
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError:
            self._writer = None
        else:
            # What an earlier training wrote to this folder is hidden.
            self._writer = SummaryWriter(log, purge_step=0)
        self._began = self._printed = time.monotonic()
        self._count = 0
        self._first = True

    def __enter__(self) -> "Progress":
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        if self._writer is not None:
            self._writer.close()

    def __call__(self, done: int, count: int, figures: Mapping[str, float]) -> None:
        """Report that `done` of the total is done, the last `count` of what is counted since."""
        if self._writer is not None:
            for name, value in figures.items():
                self._writer.add_scalar(name.replace("/", " per "), value, done)
        self._count += count
        now = time.monotonic()
        if not self._first and done < self.total and now - self._printed < EVERY_S:
            return
        speed = self._count / max(now - self._printed, 1e-9)
        left_s = (now - self._began) * max(0, self.total - done) / done
        print(
            f"{done:9,} of {self.total:,} {self.unit}  "
            + "  ".join(f"{name} {value:,.3g}" for name, value in figures.items())
            + f"  {speed:,.0f} {self.counted}/s  {_span(left_s)} left",
            flush=True,
        )
        self._printed, self._count, self._first = now, 0, False


def _span(seconds: float) -> str:
    """A time in seconds, or in minutes from 100 s on."""
    return f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
