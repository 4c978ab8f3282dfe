"""onnxruntime, without its telemetry, and with a limit on the time of each call of a network."""

import os
import threading
import time
from typing import Any

LONGEST_S = 10.0
"""Limit of one call, which takes milliseconds for a thousand people: an endless loop ends here."""
_LOOK_S = 0.5
_waiting: dict[int, tuple[float, Any]] = {}
"""Since when a thread waits for a call, and the call's options."""
_watcher: tuple[int, threading.Thread] | None = None
"""The thread that watches, and the process that it was started in."""


def runtime() -> Any:
    """The module onnxruntime.

    It may not note what is run in a database of the user's cache, and send it to its makers.
    """
    os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
    import onnxruntime

    return onnxruntime


class CallLimit:
    """Around calls of onnxruntime, which it ends when their time is over.

    `with limit as options: session.run(outputs, inputs, options)` raises the error of onnxruntime
    that it was told to terminate; then `exceeded` is true. One thread of a process watches all.
    """

    def __init__(self) -> None:
        self._options: Any = None

    def __enter__(self) -> Any:
        """The options of the call."""
        if self._options is None or self.exceeded:
            self._options = runtime().RunOptions()
            self._options.log_severity_level = 4
        _waiting[threading.get_ident()] = time.monotonic(), self._options
        _watch_calls()
        return self._options

    def __exit__(self, *raised: object) -> None:
        """The call is over."""
        _waiting.pop(threading.get_ident(), None)

    def __reduce__(self) -> tuple[type["CallLimit"], tuple[()]]:
        return CallLimit, ()

    @property
    def exceeded(self) -> bool:
        """Whether the last call took too long."""
        return self._options is not None and bool(self._options.terminate)


def _watch_calls() -> None:
    """Start the thread that watches, once in each process: a fork does not copy it."""
    global _watcher
    if _watcher is None or _watcher[0] != os.getpid():
        thread = threading.Thread(target=_watch, daemon=True, name="limit of network calls")
        _watcher = os.getpid(), thread
        thread.start()


def _watch() -> None:
    while True:
        time.sleep(_LOOK_S)
        for since, options in list(_waiting.values()):
            if time.monotonic() - since > LONGEST_S:
                options.terminate = True
