"""Progress of long work: whoever does it says how far it is, whoever listens shows it.

Work inside several layers of functions reports its steps here, so that no layer has to pass a
function on. Without a listener nothing happens. The command line listens with progress bars.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from functools import partial
from typing import TypeVar

Item = TypeVar("Item")
Listener = Callable[[str, int, int | None], None]
"""Called with the name of a stage, the steps done, and all steps (None: unknown)."""
_listener: ContextVar[Listener | None] = ContextVar("listener", default=None)


@contextmanager
def heard_by(listener: Listener | None) -> Iterator[None]:
    """Report the progress of the work in this block to `listener`; None silences it."""
    before = _listener.set(listener)
    try:
        yield
    finally:
        _listener.reset(before)


def tell(stage: str, done: int, total: int | None) -> None:
    """Report that `done` of `total` steps of a stage are done; None: their number is unknown."""
    listener = _listener.get()
    if listener is not None:
        listener(stage, done, total)


ROLLOUTS: Callable[[int, int], None] = partial(tell, "rollouts")
"""Reports how many of all rollouts are done."""


def steps(stage: str, items: Sequence[Item]) -> Iterator[Item]:
    """Yield the items, and report each as a step of the stage when the next one is asked for."""
    tell(stage, 0, len(items))
    for done, item in enumerate(items, 1):
        yield item
        tell(stage, done, len(items))


@contextmanager
def whole(stage: str) -> Iterator[None]:
    """Report the block as a stage of a single step, whose duration is unknown."""
    tell(stage, 0, None)
    yield
    tell(stage, 1, 1)
